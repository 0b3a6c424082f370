"""What each stage did: the record that makes it done, and the note that it is under way."""

from __future__ import annotations

import json
import os
import platform
import secrets
import socket
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]

from workbench.formats.atomic import remove_unfinished, replacing
from workbench.project.hashing import is_whole, sealed
from workbench.project.project import Project


@dataclass(frozen=True)
class RecordFolder:
    """Records of one stage, below ``work/<stage>/``."""

    project: Project
    stage: str

    @property
    def _running(self) -> Path:
        return _running_note(self.project.root, self.stage)

    @property
    def items_folder(self) -> Path:
        """Where the notes of finished items lie."""
        return self.project.root / "work" / self.stage / "items"

    def read(self) -> dict[str, Any] | None:
        """The last record; None where there is none, or it is damaged."""
        try:
            record = json.loads(self.project.store.path("records", self.stage).read_text("utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return record if isinstance(record, dict) and is_whole(record) else None

    def damaged(self) -> bool:
        """Whether there is a record that is not as it was written."""
        return self.project.store.exists("records", self.stage) and self.read() is None

    def write(self, record: dict[str, Any]) -> None:
        """Store the record, which ends the run of this stage."""
        self.project.store.save("records", sealed(record), self.stage)
        self._running.unlink(missing_ok=True)

    def remove(self) -> None:
        """Forget that the stage was done."""
        self.project.store.path("records", self.stage).unlink(missing_ok=True)

    def start(self) -> str:
        """Note that this process works on the stage; the old record no longer holds.

        Returns
        -------
        The run's name, by which its items find out whether they are still wanted.
        """
        process, run = psutil.Process(), secrets.token_hex(8)
        note = {
            "run": run,
            "pid": process.pid,
            "process_started": _seconds_since_boot(process),
            "host": socket.gethostname(),
            "started": utc_now(),
        }
        self._running.parent.mkdir(parents=True, exist_ok=True)
        for folder in (self._running.parent, *self.items_folder.glob("*")):
            remove_unfinished(folder, "*.json")
        with replacing(self._running) as temporary:
            temporary.write_text(json.dumps(note), encoding="utf-8")
        self.remove()
        return run

    def interrupted(self) -> str | None:
        """Where a run of this stage began and did not end: since when, else None.

        A note of a process that still lives is not an interruption; ask `running`.
        """
        note = self._note()
        if note is None or _alive(note):
            return None
        # Killed between its record and the end of its note, a run is as good as ended.
        ended = "run" in note and (self.read() or {}).get("run") == note["run"]
        return None if ended else str(note.get("started", "unknown time"))

    def running(self) -> str | None:
        """The process that works on this stage now, in words."""
        note = self._note()
        if note is None or not _alive(note):
            return None
        told = f"process {note['pid']} on {note['host']}, since {note.get('started')}"
        here = note["host"] == socket.gethostname()
        return told if here else f"{told}, unless it was stopped: that cannot be seen from here"

    def _note(self) -> dict[str, Any] | None:
        return _read_note(self._running)


def still_at_work(root: Path, stage: str, run: str) -> bool:
    """Whether the run of this name is the one that works on a stage, as its note says."""
    return (_read_note(_running_note(root, stage)) or {}).get("run") == run


def _running_note(root: Path, stage: str) -> Path:
    return root / "work" / stage / "running.json"


def _read_note(path: Path) -> dict[str, Any] | None:
    """What a note says; nothing where it is damaged, None where it is not there."""
    try:
        note = json.loads(path.read_text(encoding="utf-8"))
    except OSError:
        return None
    except (ValueError, RecursionError):
        return {}
    return note if isinstance(note, dict) else {}


def _alive(note: dict[str, Any]) -> bool:
    try:
        if note["host"] != socket.gethostname():
            return isinstance(note["pid"], int)  # nobody can tell from another machine
        process = psutil.Process(note["pid"])
        # The start tells a process from a later one that was given the same number.
        same: bool = abs(_seconds_since_boot(process) - note["process_started"]) < 1.5
        return same and bool(process.status() != psutil.STATUS_ZOMBIE)
    except (KeyError, TypeError, ValueError, OverflowError, psutil.Error):
        return False


def _seconds_since_boot(process: psutil.Process) -> float:
    """When a process began; both times move with a clock that is set, their difference does not."""
    booted: float = psutil.boot_time()
    return float(psutil.Process(process.pid).create_time() - booted)


def utc_now() -> str:
    """ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def library_versions(distributions: tuple[str, ...]) -> dict[str, str]:
    """Installed versions, the workbench's own first."""
    return {name: _version(name) for name in ("scan-workbench", *sorted(distributions))}


@cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"


def host_facts() -> dict[str, Any]:
    """The machine, as far as it explains run times."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "cores": os.cpu_count() or 1,
        "memory_bytes": psutil.virtual_memory().total,
    }
