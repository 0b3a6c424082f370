"""What is fuzzed: a reader, files it reads, and the bounds it keeps to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SEPARATOR = b"\n=====another=file=====\n"
MIB = 1 << 20

Reader = Callable[[Path], object]
"""From the folder with the files to whatever is read."""
Seeds = Callable[[Path], list[tuple[bytes, ...]]]
"""From an empty folder to contents of good files."""


@dataclass(frozen=True)
class Target:
    """One reader, or several that take the same files.

    Attributes
    ----------
    name : of the row in the table.
    files : names of the files, relative to a folder.
    seeds : from an empty folder to good contents, one tuple of bytes for the files each.
    readers : every one is given the folder; they take turns.
    repair : puts check sums right after damage to the first file, so that it gets past them.
    memory_multiple, memory_bytes : reading may take so many times the files' size, and so
        much besides.
    seconds : of one processor that reading may take.
    names_elsewhere : the files tell of others, which errors may name.
    before : makes what stands around the files.
    """

    name: str
    files: tuple[str, ...]
    seeds: Seeds
    readers: tuple[Reader, ...]
    repair: Callable[[bytes], bytes] | None = None
    memory_multiple: float = 64.0
    memory_bytes: int = 24 * MIB
    seconds: float = 2.0
    names_elsewhere: bool = False
    before: Callable[[Path], None] | None = None

    def place(self, folder: Path, packed: bytes) -> int:
        """Write files and return their size; files beyond those that are packed are empty."""
        parts = packed.split(SEPARATOR)
        parts += [b""] * (len(self.files) - len(parts))
        for name, content in zip(self.files, parts, strict=False):
            if "/" in name:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with open(f"{folder}/{name}", "wb") as file:
                file.write(content)
        return len(packed)


def packed(parts: tuple[bytes, ...]) -> bytes:
    """Contents of several files as one, as the corpus keeps them."""
    return SEPARATOR.join(parts)


def of_files(folder: Path, *names: str) -> tuple[bytes, ...]:
    """Contents of files of a folder."""
    return tuple((folder / name).read_bytes() for name in names)
