"""What each stage did: the record that makes it done, and the note that it is under way."""

from __future__ import annotations

import json
import os
import platform
import socket
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]

from workbench.formats.atomic import replacing
from workbench.project.project import Project


@dataclass(frozen=True)
class RecordFolder:
    """Records of one stage, below ``work/<stage>/``."""

    project: Project
    stage: str

    @property
    def _running(self) -> Path:
        return self.project.root / "work" / self.stage / "running.json"

    @property
    def items_folder(self) -> Path:
        """Where the notes of finished items lie."""
        return self.project.root / "work" / self.stage / "items"

    def read(self) -> dict[str, Any] | None:
        """The last record; None where there is none or it cannot be read."""
        try:
            record = json.loads(self.project.store.path("records", self.stage).read_text("utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return record if isinstance(record, dict) else None

    def write(self, record: dict[str, Any]) -> None:
        """Store the record, which ends the run of this stage."""
        self.project.store.save("records", record, self.stage)
        self._running.unlink(missing_ok=True)

    def remove(self) -> None:
        """Forget that the stage was done."""
        self.project.store.path("records", self.stage).unlink(missing_ok=True)

    def start(self) -> None:
        """Note that this process works on the stage; the old record no longer holds."""
        process = psutil.Process()
        note = {
            "pid": process.pid,
            "process_started": process.create_time(),
            "host": socket.gethostname(),
            "started": utc_now(),
        }
        self._running.parent.mkdir(parents=True, exist_ok=True)
        with replacing(self._running) as temporary:
            temporary.write_text(json.dumps(note), encoding="utf-8")
        self.remove()

    def interrupted(self) -> str | None:
        """Where a run of this stage began and did not end: since when, else None.

        A note of a process that still lives is not an interruption; ask `running`.
        """
        note = self._note()
        return None if note is None or _alive(note) else str(note.get("started", "unknown time"))

    def running(self) -> str | None:
        """The process that works on this stage now, in words."""
        note = self._note()
        if note is None or not _alive(note):
            return None
        told = f"process {note['pid']} on {note['host']}, since {note.get('started')}"
        here = note["host"] == socket.gethostname()
        return told if here else f"{told}, unless it was stopped: that cannot be seen from here"

    def _note(self) -> dict[str, Any] | None:
        try:
            note = json.loads(self._running.read_text(encoding="utf-8"))
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
        same: bool = abs(process.create_time() - note["process_started"]) < 1.0
        return same and bool(process.status() != psutil.STATUS_ZOMBIE)
    except (KeyError, TypeError, ValueError, OverflowError, psutil.Error):
        return False


def utc_now() -> str:
    """ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def library_versions(distributions: tuple[str, ...]) -> dict[str, str]:
    """Installed versions, the workbench's own first."""
    versions = {}
    for name in ("scan-workbench", *sorted(distributions)):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def host_facts() -> dict[str, Any]:
    """The machine, as far as it explains run times."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "cores": os.cpu_count() or 1,
        "memory_bytes": psutil.virtual_memory().total,
    }
