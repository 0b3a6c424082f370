"""Memory that a process holds for nothing."""

from __future__ import annotations

import ctypes
import gc
import sys

# Numbers of glibc's parameters, of its malloc.h.
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8
_OWN_PLACE_BYTES, _MOST_ARENAS = 1 << 20, 4


def keep_little() -> None:
    """Let what is freed go back to the system at once, where it is a mebibyte or more.

    glibc places up to 32 mebibytes among small pieces once something so large was freed: the
    masks and pictures of one photograph after another then leave gibibytes behind that no trimming
    reaches. Each in a place of its own takes a few per cent of a stage's time.
    """
    mallopt = _of_glibc("mallopt")
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _OWN_PLACE_BYTES)
        mallopt(_ARENA_MAX, _MOST_ARENAS)


def give_back() -> None:
    """Give memory that nothing uses any more back to the system.

    Of small pieces, too, which after a stage may be gibibytes, that the next would be measured
    with and its workers would lack.
    """
    gc.collect()
    trim = _of_glibc("malloc_trim")
    if trim is not None:
        trim(0)


def _of_glibc(name: str) -> ctypes._NamedFuncPointer | None:
    """A function that other C libraries have not."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
