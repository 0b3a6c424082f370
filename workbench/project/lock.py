"""One writer per project."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from workbench.errors import InputError, ProjectLockedError


@contextmanager
def project_lock(root: Path) -> Iterator[None]:
    """Hold the project for writing.

    The lock is the operating system's, so a killed run never leaves one behind; the note
    beside it only tells who holds it.

    Raises
    ------
    ProjectLockedError
        When another process holds it, naming that process.
    InputError
        When the project folder cannot be written.
    """
    folder = root / "work"
    note = folder / "lock.json"
    lock = FileLock(folder / ".lock")
    try:
        folder.mkdir(exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        raise ProjectLockedError(
            "Another run is writing this project",
            file=root,
            found=_holder(note),
            fix="wait for it to end, or stop it",
        ) from None
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        started = datetime.now(UTC).isoformat(timespec="seconds")
        held = {"pid": os.getpid(), "host": socket.gethostname(), "started": started}
        try:
            note.write_text(json.dumps(held), encoding="utf-8")
        except OSError as error:
            raise _unwritable(folder, error) from error
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def _unwritable(folder: Path, error: OSError) -> InputError:
    return InputError(
        "The project folder cannot be written",
        file=folder,
        found=error.strerror,
        fix="check its permissions and the room on its disk, or copy the project elsewhere",
    )


def _holder(note: Path) -> str:
    try:
        held = json.loads(note.read_text(encoding="utf-8"))
        return f"process {held['pid']} on {held['host']}, since {held['started']}"
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return "a process that left no note"
