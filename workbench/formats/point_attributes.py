"""Normals and colours of point files as a `PointSet` holds them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_UNIT_ENOUGH = 1e-5


def unit_normals(values: NDArray[np.generic]) -> NDArray[np.float32]:
    """Normals (n, 3) of any float type as unit float32; those without a direction are zero.

    What is unit to 10⁻⁵ keeps its bits.
    """
    normals = values.astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        wide = values.astype(np.float64)
        length = np.linalg.norm(wide, axis=1)
        off = ~(np.abs(length - 1) <= _UNIT_ENOUGH)
        if off.any():
            usable = np.isfinite(length) & (length > 0)
            turned = wide[off] / np.where(usable, length, 1)[off, None]
            normals[off] = np.where(usable[off, None], turned, 0)
    return normals


def eight_bits(values: NDArray[np.generic], white: int) -> NDArray[np.uint8]:
    """Bytes of whole numbers from 0 to ``white``, rounded to the nearest; larger ones are 255."""
    wide = values.astype(np.uint32)
    if white != 255:
        wide = (wide * 255 + white // 2) // white
    return np.minimum(wide, 255).astype(np.uint8)
