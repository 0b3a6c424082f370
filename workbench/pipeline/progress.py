"""Progress for people: what is being done, how far it is, and an honest time to go."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TextIO

# An estimate from fewer finished items or less time than this would be a guess.
_ITEMS_BEFORE_ETA = 3
_SECONDS_BEFORE_ETA = 2.0
_SECONDS_BETWEEN_LINES = 2.0


class Step:
    """One counted piece of work."""

    def __init__(self, progress: Progress, label: str, total: int | None) -> None:
        self._progress = progress
        self._label = label
        self._total = total
        self._done = 0
        self._skipped = 0
        self._started = time.monotonic()
        self._last_line = self._started

    def advance(self, count: int = 1, *, reused: bool = False) -> None:
        """``count`` items are done; ``reused`` ones cost no time and do not enter the ETA."""
        self._done += count
        self._skipped += count if reused else 0
        now = time.monotonic()
        if now - self._last_line >= _SECONDS_BETWEEN_LINES:
            self._last_line = now
            self._progress.line(self.text(now), transient=True)

    def eta_seconds(self, now: float) -> float | None:
        """Seconds to go at the mean pace so far; None while that is unknown."""
        worked, elapsed = self._done - self._skipped, now - self._started
        if self._total is None or worked < _ITEMS_BEFORE_ETA or elapsed < _SECONDS_BEFORE_ETA:
            return None
        return (self._total - self._done) * elapsed / worked

    def text(self, now: float) -> str:
        """``label 3/10, about 12 s to go``."""
        count = f" {self._done}/{self._total}" if self._total else f" {self._done}"
        eta = self.eta_seconds(now)
        return f"{self._label}{count}" + (f", about {format_seconds(eta)} to go" if eta else "")


class Progress:
    """Lines on standard error; on a terminal the counting line is rewritten in place.

    Parameters
    ----------
    stream : where to write.
    quiet : write nothing but warnings.
    """

    def __init__(self, stream: TextIO | None = None, *, quiet: bool = False) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self._terminal = self._stream.isatty()
        self._quiet = quiet
        self._open_line = False

    def line(self, text: str, *, transient: bool = False) -> None:
        """One line; a transient one is overwritten by the next where that is possible."""
        if self._quiet:
            return
        self._close()
        self._open_line = transient and self._terminal
        self._stream.write(text if self._open_line else text + "\n")
        self._stream.flush()

    def warning(self, text: str) -> None:
        """A line that is written even when quiet."""
        quiet, self._quiet = self._quiet, False
        self.line(f"warning: {text}")
        self._quiet = quiet

    @contextmanager
    def step(self, label: str, total: int | None = None) -> Iterator[Step]:
        """A piece of work of ``total`` items (None: unknown)."""
        self.line(f"  {label} …", transient=True)
        try:
            yield Step(self, f"  {label}", total)
        finally:
            self._close()

    @contextmanager
    def shares(self) -> Iterator[Callable[[str, float], None]]:
        """A function that is told what is under way and its share done; every name is a step."""
        label, percent, step = "", 0, Step(self, "", None)
        with ExitStack() as under_way:

            def told(now: str, share: float) -> None:
                nonlocal label, percent, step
                if now != label:
                    under_way.close()
                    label, percent, step = now, 0, under_way.enter_context(self.step(now, 100))
                step.advance(int(100 * share) - percent)
                percent = int(100 * share)

            yield told

    def _close(self) -> None:
        """Take a line back that the next would have overwritten, before others write."""
        if self._open_line:
            self._stream.write("\r\x1b[2K")
            self._stream.flush()
            self._open_line = False


def format_seconds(seconds: float) -> str:
    """``0.4 s``, ``12 s``, ``3 min 20 s``, ``2 h 05 min``."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
