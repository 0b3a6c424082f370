"""A process that has everything loaded forks runs of the workbench, each in a moment.

A process with threads cannot be forked safely, so it keeps to one core: then no library that
asks how many there are starts a second thread.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from stages.main import PIPELINE
from workbench.cli import run_cli


def require_one_thread() -> None:
    """Raise RuntimeError where this process could not be forked safely."""
    names = [
        Path(f"/proc/self/task/{task}/comm").read_text().strip()
        for task in os.listdir("/proc/self/task")
    ]
    if len(names) > 1:
        raise RuntimeError(f"a process to fork has threads: {', '.join(names)}")


@dataclass(frozen=True)
class Run:
    """A run of the workbench in a forked process, the leader of a group of its own."""

    pid: int
    log: Path

    def wait(self, seconds: float = 300.0) -> int | None:
        """Its exit code, negative for a signal; None where it goes on after so many seconds."""
        end = time.monotonic() + seconds
        while True:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() > end:
                return None
            time.sleep(0.002)

    def kill(self, *, group: bool = True) -> None:
        """SIGKILL, to all its processes or to the first alone."""
        with suppress(ProcessLookupError):
            (os.killpg if group else os.kill)(self.pid, signal.SIGKILL)

    def workers(self) -> list[psutil.Process]:
        """The processes that work for it."""
        with suppress(psutil.Error):
            below = psutil.Process(self.pid).children(recursive=True)
            return [p for p in below if "spawn_main" in " ".join(p.cmdline())]
        return []

    def ends(self, seconds: float) -> bool:
        """Whether all its processes are gone within so many seconds."""
        end = time.monotonic() + seconds
        while _members(self.pid):
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    @property
    def told(self) -> str:
        """What it wrote."""
        return self.log.read_text("utf-8", errors="replace")


def start(arguments: Sequence[str], log: Path, before: Callable[[], None] | None = None) -> Run:
    """Fork a run of ``workbench``; ``before`` is called in the forked process."""
    require_one_thread()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        code = 70
        try:
            os.setpgid(0, 0)
            descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(descriptor, 1)
            os.dup2(descriptor, 2)
            if before is not None:
                before()
            code = run_cli(PIPELINE, list(arguments))
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    with suppress(OSError):
        os.setpgid(pid, pid)
    return Run(pid, log)


def _members(group: int) -> list[int]:
    found = []
    for pid in psutil.pids():
        with suppress(OSError, psutil.Error):
            if os.getpgid(pid) == group and psutil.Process(pid).status() != "zombie":
                found.append(pid)
    return found
