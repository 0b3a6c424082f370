"""Colours of voxels beside a graph (Dado 2016: attributes in depth-first order).

A graph shares subtrees that differ in colour, so that colours cannot stand in its nodes. They
stand in an array of their own, one for each voxel in the order of Morton codes, and the
number of a voxel is found on the way down to it from how many stand below each node passed by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.dag_colors import mean_of_ranges

_MOST_IN_PALETTE = 1 << 16


@dataclass(frozen=True)
class VoxelColors:
    """Colours of voxels, with or without a palette.

    Attributes
    ----------
    palette : (k, 3) uint8 sRGB, ascending; empty where colours stand for themselves.
    values : (n,) uint8 or uint16 places in the palette, or (n, 3) uint8 sRGB without one.
    """

    palette: NDArray[np.uint8]
    values: NDArray[np.uint8] | NDArray[np.uint16]

    def __len__(self) -> int:
        return len(self.values)

    @property
    def nbytes(self) -> int:
        return self.palette.nbytes + self.values.nbytes

    def all(self) -> NDArray[np.uint8]:
        """(n, 3) uint8 sRGB, voxel by voxel."""
        return np.asarray(self.palette[self.values] if len(self.palette) else self.values, np.uint8)

    def mean(self, first: NDArray[np.int64], count: NDArray[np.int64]) -> NDArray[np.uint8]:
        """(m, 3) uint8 sRGB, the mean in linear light of ``count`` voxels from ``first`` on.

        Ranges of no voxels are black.
        """
        out = np.zeros((len(first), 3), np.uint8)
        mean_of_ranges(self.all(), first, count, out)
        return out


def packed_colors(colors: NDArray[np.uint8]) -> VoxelColors:
    """Colours (n, 3) uint8 sRGB in the smallest of the ways to keep them; none is lost.

    Raises
    ------
    InputError : the colours are not (n, 3) uint8.
    """
    if colors.dtype != np.uint8 or colors.ndim != 2 or colors.shape[1] != 3:
        raise InputError(
            "Colours of voxels come as three bytes each.",
            expected="(n, 3) uint8",
            found=f"{colors.shape} {colors.dtype}",
        )
    wide = colors.astype(np.uint32)
    keys, places = np.unique(wide[:, 0] << 16 | wide[:, 1] << 8 | wide[:, 2], return_inverse=True)
    if len(keys) > _MOST_IN_PALETTE or not len(keys):
        return VoxelColors(np.empty((0, 3), np.uint8), np.ascontiguousarray(colors))
    kind = np.uint8 if len(keys) <= 256 else np.uint16
    palette = np.stack([keys >> 16, keys >> 8 & 255, keys & 255], axis=1).astype(np.uint8)
    packed = VoxelColors(palette, places.astype(kind))
    return (
        packed
        if packed.nbytes < colors.nbytes
        else VoxelColors(np.empty((0, 3), np.uint8), np.ascontiguousarray(colors))
    )
