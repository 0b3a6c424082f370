"""Files that are either whole or not there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file beside its place and move it there when it is complete.

    The body of the ``with`` writes to the path it is given, ``.<name>.partial`` in the same
    folder. At its end that file is flushed to disk and renamed over ``path`` in one step,
    so a reader sees the old file or the new one and never a half. When the body raises,
    the partial file is removed and ``path`` stays as it was.

    Parameters
    ----------
    path
        the file to replace or to make; its folder must exist.

    Yields
    ------
    The temporary path to write. It ends in ``.partial``: a library that goes by the
    suffix has to be told the format.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        _flush_to_disk(partial)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _flush_folder_to_disk(path.parent)


def _flush_to_disk(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _flush_folder_to_disk(folder: Path) -> None:
    """Make the rename itself survive a power cut, where the system lets a folder be opened."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        # Some network file systems refuse to sync a folder; the file itself is safe.
        pass
    finally:
        os.close(descriptor)
