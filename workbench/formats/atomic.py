"""Files that are either whole or not there."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file beside its place and move it there when it is complete.

    The body of the ``with`` writes to the path it is given, ``.<name>.<random>.partial`` in the
    same folder. At its end that file is flushed to disk and renamed over ``path`` in one step,
    so a reader sees the old file or the new one and never a half. When the body raises,
    the partial file is removed and ``path`` stays as it was. Two that write one file at once
    never mix; what killed ones leave behind `remove_unfinished` finds.

    Parameters
    ----------
    path
        the file to replace or to make; its folder must exist.

    Yields
    ------
    The temporary path to write. It ends in ``.partial``: a library that goes by the
    suffix has to be told the format.

    Raises
    ------
    OSError
        Of the disk; it names ``path``.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        _flush_to_disk(partial)
        os.replace(partial, path)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in (None, str(partial)):
            error.filename = str(path)
        raise
    _flush_folder_to_disk(path.parent)


def remove_unfinished(folder: Path, name: str) -> None:
    """Take away what killed writers of a file left beside it.

    Parameters
    ----------
    name : of the file, or a pattern with ``*`` for several.
    """
    # A partial file may have been written by way of another; folders are what was sorted or cut
    # on the way to the file.
    partial = f"{name}.{8 * '[0-9a-f]'}.partial*"
    for path in folder.iterdir():
        if not path.name.startswith(".") or not fnmatchcase(path.name.lstrip("."), partial):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


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
