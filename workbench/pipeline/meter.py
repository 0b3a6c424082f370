"""Wall time, processor time and peak memory of a piece of work, workers included."""

from __future__ import annotations

import itertools
import os
import threading
import time
from types import TracebackType

import psutil  # type: ignore[import-untyped]

_SECONDS_BETWEEN_SAMPLES = 0.05
# Looking for children reads the state of every process of the machine.
_SAMPLES_BETWEEN_LOOKS = 10


class Meter:
    """A context that measures what happens inside it.

    Attributes
    ----------
    seconds : wall time.
    cpu_seconds : user and system time of this process and of ended children.
    peak_rss_bytes : largest sum of resident memory of this process and its children, sampled
        twenty times a second; pages shared between them count for each.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.cpu_seconds = 0.0
        self.peak_rss_bytes = 0
        self._process = psutil.Process()
        self._stop = threading.Event()
        self._sampler = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Meter:
        self._wall, self._cpu = time.perf_counter(), _cpu_seconds()
        self._sampler.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._sampler.join()
        self.seconds = time.perf_counter() - self._wall
        self.cpu_seconds = _cpu_seconds() - self._cpu

    def _sample(self) -> None:
        children: list[psutil.Process] = []
        for sample in itertools.count():
            if sample % _SAMPLES_BETWEEN_LOOKS == 0:
                children = self._process.children(recursive=True)
            resident = self._process.memory_info().rss
            for child in children:
                try:
                    resident += child.memory_info().rss
                except psutil.Error:
                    continue  # it ended since it was listed
            self.peak_rss_bytes = max(self.peak_rss_bytes, resident)
            if self._stop.wait(_SECONDS_BETWEEN_SAMPLES):
                return


def _cpu_seconds() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
