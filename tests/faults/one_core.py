"""Keeps this process, and what it forks, to one core: imported before any library is loaded."""

from __future__ import annotations

import os

_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

#: The cores this process had.
CORES = frozenset(os.sched_getaffinity(0))

os.environ.update(dict.fromkeys(_THREADS, "1"))
os.sched_setaffinity(0, {max(CORES)})


def all_cores() -> None:
    """Give a forked process back what this one had."""
    os.sched_setaffinity(0, CORES)
