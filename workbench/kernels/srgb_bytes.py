"""sRGB bytes and linear light, one value at a time, for kernels that average colours."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


def _linear(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


LINEAR_OF_BYTE = _linear(np.arange(256) / 255)
# Where rounding goes from one byte to the next; no byte lies below the first or above the last.
_LEAST = np.append(_linear((np.arange(256) - 0.5) / 255), np.inf)
_LEAST[0] = -np.inf
# The square root runs almost as the encoding does: a guess from it is off by a few bytes.
_GUESS = np.searchsorted(_LEAST, (np.arange(1024) / 1023) ** 2, side="right").astype(np.int64) - 1


@njit(cache=True, nogil=True)
def srgb_byte(linear: float) -> int:
    """The sRGB byte nearest to a linear value; values outside 0…1 are clipped."""
    byte = int(_GUESS[int(math.sqrt(min(max(linear, 0.0), 1.0)) * 1023)])
    while linear >= _LEAST[byte + 1]:
        byte += 1
    while linear < _LEAST[byte]:
        byte -= 1
    return byte
