"""Content hashes of files, remembered while a file's inode, size and times stay the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.formats.atomic import replacing


def hash_of_value(value: Any) -> str:
    """Hash of plain data (dicts, lists, numbers, strings); key order does not matter."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return _name(hashlib.blake2b(text.encode(), digest_size=20))


class FileHashes:
    """BLAKE2b hashes of files with a memory on disk.

    A file is read again when its inode, size, modification or status-change time differs.
    The status-change time cannot be set back by a program, so an edit cannot hide.
    """

    def __init__(self, memory: Path, root: Path) -> None:
        self._memory_path = memory
        self._root = root
        self._memory: dict[str, list[Any]] = {}
        self._changed = False
        try:
            loaded = json.loads(memory.read_text(encoding="utf-8"))
            self._memory = loaded if isinstance(loaded, dict) else {}
        except (OSError, ValueError):
            pass  # a lost memory costs only the time to read the files again

    def of_file(self, path: Path) -> str:
        """``blake2b:<hex>`` of the file's content."""
        try:
            status = path.stat()
            stamp = [status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns]
            key = str(path.resolve())
            known = self._memory.get(key)
            if known is not None and known[:4] == stamp:
                return str(known[4])
            with open(path, "rb") as file:
                digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=20))
        except OSError as error:
            raise InputError(
                "A file cannot be read", file=path, found=error.strerror, fix="restore the file"
            ) from error
        self._memory[key] = [*stamp, _name(digest)]
        self._changed = True
        return _name(digest)

    def of_files(self, paths: Iterable[Path]) -> str:
        """One hash over several files: their names and contents, in the order given."""
        return hash_of_value([[path.name, self.of_file(path)] for path in paths])

    def save(self) -> None:
        """Write the memory when anything was added, without files that are gone."""
        if self._changed and self._memory_path.parent.is_dir():
            kept = {path: entry for path, entry in self._memory.items() if Path(path).exists()}
            with replacing(self._memory_path) as temporary:
                temporary.write_text(json.dumps(kept), encoding="utf-8")
            self._changed = False


def _name(digest: hashlib._Hash) -> str:
    return f"blake2b:{digest.hexdigest()}"
