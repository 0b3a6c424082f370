"""One reading of damaged files, judged: a value, a refusal that helps, or a finding."""

from __future__ import annotations

import os
import resource
import signal
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.target import Target
from workbench.errors import SettingsError, WorkbenchError

# By the kernel, whatever native code does: so long of a processor, or of the clock.
_KILLED_AFTER_CPU_S, _KILLED_AFTER_S = 20.0, 120.0


@dataclass
class Outcome:
    """What came of one reading.

    Attributes
    ----------
    kind : ``value``, ``refused``, or what is wrong: ``exception``, ``unhelpful``, ``slow``,
        ``memory``.
    where : the line of code it came from; alike for alike findings.
    told : for people.
    seconds, grown : of a processor, and bytes of memory.
    """

    kind: str
    where: str = ""
    told: str = ""
    seconds: float = 0.0
    grown: int = 0
    size: int = field(default=0)

    @property
    def is_finding(self) -> bool:
        """Whether the reader has to be mended."""
        return self.kind not in ("value", "refused")


def read_once(target: Target, folder: Path, packed: bytes, turn: int) -> Outcome:
    """Place files and let one of the readers have them.

    The process is killed where native code does not end.
    """
    size = target.place(folder, packed)
    if target.before is not None:
        target.before(folder)
    reader = target.readers[turn % len(target.readers)]
    _forget_peak()
    before = _peak()
    signal.setitimer(signal.ITIMER_PROF, _KILLED_AFTER_CPU_S)
    signal.setitimer(signal.ITIMER_REAL, _KILLED_AFTER_S)
    start = time.process_time()
    try:
        value = reader(folder)
        outcome = Outcome("value")
        del value
    except WorkbenchError as error:
        outcome = _judged(error, target, folder)
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # panics of libraries are no Exceptions
        told = "".join(traceback.format_exception(error))
        outcome = Outcome("exception", f"{type(error).__name__} {_place_of(error)}", told)
    outcome.seconds = time.process_time() - start
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.setitimer(signal.ITIMER_REAL, 0)
    outcome.grown, outcome.size = _peak() - before, size
    if not outcome.is_finding:
        if outcome.seconds > target.seconds:
            outcome.told = f"{outcome.seconds:.1f} s; {outcome.kind} {outcome.where}"
            outcome.kind = "slow"
        elif outcome.grown > target.memory_multiple * size + target.memory_bytes:
            outcome.told = (
                f"{outcome.grown / 2**20:.0f} MiB for {size} bytes; {outcome.kind} {outcome.where}"
            )
            outcome.kind = "memory"
    return outcome


def _judged(error: WorkbenchError, target: Target, folder: Path) -> Outcome:
    where = _place_of(error)
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return Outcome("memory", where, "".join(traceback.format_exception(error)))
        cause = cause.__cause__ or cause.__context__
    # Settings come from three places, of which the option's name tells enough.
    needed = ("fix",) if isinstance(error, SettingsError) else ("file", "fix")
    lacks = [name for name in needed if not getattr(error, name)]
    named = os.fspath(error.file or folder)
    if not (target.names_elsewhere or named.startswith(f"{folder.parent}/")):
        lacks = ["a file that was given"]
    if lacks:
        told = "".join(traceback.format_exception(error))
        return Outcome("unhelpful", where, f"without {' and '.join(lacks)}\n{told}")
    return Outcome("refused", where)


def _place_of(error: BaseException) -> str:
    """The two innermost lines of the workbench, and that of a library it called."""
    ours = ["", ""]
    innermost = ""
    step = error.__traceback__
    while step is not None:
        file = step.tb_frame.f_code.co_filename
        innermost = f"{file.rpartition('/')[2]}:{step.tb_lineno}"
        if "/workbench/" in file:
            ours = [ours[1], innermost]
        step = step.tb_next
    return " < ".join(filter(None, (*ours, innermost if innermost != ours[1] else "")))


def _forget_peak() -> None:
    # Unbuffered: it is done before every reading.
    file = os.open("/proc/self/clear_refs", os.O_WRONLY)
    os.write(file, b"5")
    os.close(file)


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
