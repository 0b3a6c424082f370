"""Content hashes of files, remembered while a file's inode, size and times stay the same."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.formats.atomic import remove_unfinished, replacing

# A clock tick of a file system: within one, a second edit leaves the times as they were.
_TICK_NS = 50_000_000


def hash_of_value(value: Any) -> str:
    """Hash of plain data (dicts, lists, numbers, strings); key order does not matter."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return _name(hashlib.blake2b(text.encode(), digest_size=20).hexdigest())


def sealed(document: dict[str, Any]) -> dict[str, Any]:
    """Plain data with a hash of all it says under ``seal``."""
    return document | {"seal": hash_of_value(document)}


def is_whole(document: dict[str, Any]) -> bool:
    """Whether data still say what was sealed; those of a version that knew no seals count so."""
    said = {key: value for key, value in document.items() if key != "seal"}
    return document.get("seal", "") in ("", hash_of_value(said))


class FileHashes:
    """BLAKE2b hashes of files with a memory on disk.

    A file is read again when its inode, size, modification or status-change time differs.
    The status-change time cannot be set back by a program, so an edit cannot hide. What was
    written a moment ago is not remembered yet, for it may change within the same clock tick.

    Parameters
    ----------
    memory : the file that remembers; a lost or broken one costs only reading again.
    root : the folder paths are remembered relative to, so that both may move together.
    """

    def __init__(self, memory: Path, root: Path) -> None:
        self._memory_path = memory
        self._root = root
        self._memory = _remembered(memory)
        self._changed = False

    def of_file(self, path: Path) -> str:
        """``blake2b:<hex>`` of the file's content."""
        try:
            status = path.stat()
            if not stat.S_ISREG(status.st_mode):
                raise OSError(errno.EINVAL, "a folder, a pipe or a device, not a file")
            stamp = [status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns]
            key = os.path.relpath(path, self._root)
            known = self._memory.get(key)
            if known is not None and known[:4] == stamp:
                return str(known[4])
            settled = time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _TICK_NS
            with open(path, "rb") as file:
                digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=20))
            content = _name(digest.hexdigest())
        except OSError as error:
            raise InputError(
                "A file cannot be read", file=path, found=error.strerror, fix="restore the file"
            ) from error
        if settled:
            self._memory[key] = [*stamp, content]
            self._changed = True
        return content

    def of_files(self, paths: Iterable[Path]) -> str:
        """One hash over several files: their names and contents, in the order given."""
        return hash_of_value([[path.name, self.of_file(path)] for path in paths])

    def remove_unfinished(self) -> None:
        """Take away what killed runs left of the memory; who holds the project may."""
        remove_unfinished(self._memory_path.parent, self._memory_path.name)

    def save(self) -> None:
        """Write the memory when anything was added, without files that are gone."""
        if not (self._changed and self._memory_path.parent.is_dir()):
            return
        kept = {key: entry for key, entry in self._memory.items() if (self._root / key).exists()}
        try:
            with replacing(self._memory_path) as temporary:
                temporary.write_text(json.dumps(kept), encoding="utf-8")
        except OSError:
            return  # a folder that may only be read, or another process that saves just now
        self._changed = False


def _remembered(memory: Path) -> dict[str, list[Any]]:
    try:
        loaded = json.loads(memory.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(loaded, dict):
        return {}
    return {k: v for k, v in loaded.items() if isinstance(v, list) and len(v) == 5}


def _name(hexadecimal: str) -> str:
    return f"blake2b:{hexadecimal}"
