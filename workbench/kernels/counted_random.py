"""Random numbers told by what they are for, so that no order of work changes them."""

from __future__ import annotations

import numpy as np
from numba import njit

_LOW = np.uint64(0xFFFFFFFF)


@njit(cache=True, nogil=True)
def uniform(seed: int, place: int, draw: int) -> float:
    """A number in [0, 1) for a draw at a place, from 32 mixed bits.

    Source of the mixing: the finaliser of MurmurHash3 (Appleby, public domain).
    """
    h = np.uint64(seed) * np.uint64(0x9E3779B1)
    h ^= np.uint64(place) * np.uint64(0x85EBCA77)
    h ^= np.uint64(draw) * np.uint64(0xC2B2AE3D)
    h &= _LOW
    h ^= h >> np.uint64(16)
    h = (h * np.uint64(0x85EBCA6B)) & _LOW
    h ^= h >> np.uint64(13)
    h = (h * np.uint64(0xC2B2AE35)) & _LOW
    h ^= h >> np.uint64(16)
    return float(h) / 4294967296.0
