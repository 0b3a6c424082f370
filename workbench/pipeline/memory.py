"""Memory that a process holds for nothing."""

from __future__ import annotations

import ctypes
import gc
import sys


def give_back() -> None:
    """Give memory that nothing uses any more back to the system.

    glibc keeps what was freed in pieces for later. After a stage that may be gibibytes, which
    the next would be measured with and which its workers would lack.
    """
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # which other libraries have not
        if trim is not None:
            trim(0)
