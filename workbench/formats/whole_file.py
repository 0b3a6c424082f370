"""The bytes of an input file, or a plain word on why they cannot be had."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from workbench.errors import InputError


def require_regular(path: Path) -> None:
    """Refuse pipes and devices, which may never end, before they are opened.

    What is not there, or is a folder, is left to whoever opens it.

    Raises
    ------
    InputError
        It is such a thing.
    """
    try:
        kind = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise InputError(
            "This is a pipe or a device, not a file.",
            file=path,
            fix="Copy what it gives into a file, and name that.",
        )


def whole_file(path: Path) -> bytes:
    """All bytes of ``path``.

    Raises
    ------
    InputError
        The file is absent, is a folder or a device, may not be read, is empty, or is larger
        than the memory.
    """
    require_regular(path)
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise InputError("The file does not exist.", file=path, fix="Check the path.") from None
    except IsADirectoryError:
        raise InputError(
            "A file was expected, this is a folder.", file=path, fix="Name a file inside it."
        ) from None
    except MemoryError:
        raise InputError(
            "The file is larger than the memory.",
            file=path,
            fix="Split it into one file per scan, or use a machine with more memory.",
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(
            "The file cannot be read.",
            file=path,
            found=str(error),
            fix="Check its permissions and the disk.",
        ) from error
    if not data:
        raise InputError(
            "The file is empty.", file=path, fix="Copy or export it again; the transfer failed."
        )
    return data
