"""Bits in bytes, the highest bit of a byte first."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def put_bits(data: NDArray[np.uint8], place: int, value: int, width: int) -> int:
    """Write the ``width`` low bits of ``value`` at bit ``place`` of zeros; the place after."""
    for k in range(width - 1, -1, -1):
        if value >> k & 1:
            data[place >> 3] |= np.uint8(128 >> (place & 7))
        place += 1
    return place


@njit(cache=True, nogil=True)
def bits_at(data: NDArray[np.uint8], place: int, width: int) -> int:
    """The ``width`` ≤ 17 bits at bit ``place``; three bytes from there on must be in ``data``."""
    byte = place >> 3
    high, middle, low = np.int64(data[byte]), np.int64(data[byte + 1]), np.int64(data[byte + 2])
    three = int(high << 16 | middle << 8 | low)
    return three >> (24 - width - (place & 7)) & ((1 << width) - 1)


@njit(cache=True, nogil=True)
def only_padding(data: NDArray[np.uint8], place: int, end: int) -> bool:
    """Whether fewer than eight bits, all 0, lie between ``place`` and the bit ``end``."""
    left = end - place
    return 0 <= left < 8 and bits_at(data, place, left) == 0
