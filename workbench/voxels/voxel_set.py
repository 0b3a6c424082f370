"""Cubes of voxels around a surface, and the voxels that it touches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.morton import BITS_PER_AXIS, morton_cells

# Centre and half side are whole multiples of size / 2**26 or so: corner and centre are then
# exact in float64, and the grid of a mirrored mesh is the mirrored grid to the last bit.
_SNAP_BITS = 26
_MARGIN = 1e-6


@dataclass(frozen=True)
class VoxelGrid:
    """A cube of 2**level voxels a side, aligned with the axes.

    Attributes
    ----------
    origin : (3,) float64, its corner with the lowest coordinates, in the mesh's frame.
    size : its side, in the unit of the mesh.
    level : 0…21; 0 is one voxel.
    """

    origin: NDArray[np.float64]
    size: float
    level: int

    @property
    def resolution(self) -> int:
        """Voxels along a side."""
        return 1 << self.level

    @property
    def voxel_size(self) -> float:
        """Side of a voxel."""
        return math.ldexp(self.size, -self.level)

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) the middle of the cube."""
        return self.origin + 0.5 * self.size

    def at_level(self, level: int) -> VoxelGrid:
        """The same cube cut into 2**level voxels a side."""
        return VoxelGrid(self.origin, self.size, level)


def grid_of_mesh(vertices: NDArray[np.float64], level: int) -> VoxelGrid:
    """The smallest cube around vertices (n, 3), centred on their bounds, with a tiny margin.

    The mirror image of the vertices has the mirror image of the cube, exactly.

    Raises
    ------
    InputError
        No vertices, vertices that are not finite or all in one place, or a level that no
        code can hold.
    """
    if not 0 <= level <= BITS_PER_AXIS:
        raise InputError(
            "The resolution of a voxel grid is out of bounds.",
            expected=f"a level from 0 to {BITS_PER_AXIS}",
            found=str(level),
            fix="Choose a resolution of 2**level voxels a side within them.",
        )
    wrong = int((~np.isfinite(vertices)).any(axis=-1).sum())
    if not len(vertices) or wrong:
        raise InputError(
            "A mesh without vertices, or with vertices that are not finite, has no bounds.",
            expected="finite coordinates",
            found=f"{wrong} of {len(vertices)} not finite",
            fix="Repair the mesh: remove or move these vertices.",
        )
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = float((high - low).max())
    if not extent > 0 or not math.isfinite(extent):
        raise InputError(
            "All vertices of the mesh lie in one place, or it is larger than numbers reach.",
            found=f"an extent of {extent}",
            fix="Check the file; there is no surface to cut into voxels.",
        )
    step = math.ldexp(1.0, math.frexp(extent)[1] - 1 - _SNAP_BITS)
    half = math.ceil(0.5 * extent * (1 + _MARGIN) / step) * step
    center = np.rint((0.5 * low + 0.5 * high) / step) * step
    return VoxelGrid(center - half, 2 * half, level)


@dataclass(frozen=True)
class SidedVoxels:
    """Attributes face by face, for the voxels whose faces do not look alike.

    Faces are in the order −x, +x, −y, +y, −z, +z; those that are not set in the voxel's
    mask hold the voxel's own attributes.

    Attributes
    ----------
    index : (k,) int64, rows of the voxel set, ascending.
    normal : (k, 6, 3) float32 unit normals.
    color : (k, 6, 3) uint8 sRGB, or None where the mesh has no colour.
    """

    index: NDArray[np.int64]
    normal: NDArray[np.float32]
    color: NDArray[np.uint8] | None


@dataclass(frozen=True)
class VoxelSet:
    """The voxels of a grid that a surface touches, in Morton order.

    Attributes
    ----------
    grid : the cube they are cells of.
    codes : (n,) uint64 Morton codes, strictly ascending.
    area : (n,) float64, surface inside each voxel, in squared units of the mesh.
    normal : (n, 3) float32, area-weighted unit normals; zero where both sides cancel.
    color : (n, 3) uint8 sRGB, averaged by area in linear light, or None without colour.
    faces : (n,) uint8, bits 0…5 for the faces −x, +x, −y, +y, −z, +z that look outward.
    separating : (n,) bool, true for the 6-separating subset, which is the thinnest that no
        path through faces of voxels crosses (Laine 2013, "A topological approach to
        voxelization").
    sided : attributes of single faces, for voxels whose faces differ.
    """

    grid: VoxelGrid
    codes: NDArray[np.uint64]
    area: NDArray[np.float64]
    normal: NDArray[np.float32]
    color: NDArray[np.uint8] | None
    faces: NDArray[np.uint8]
    separating: NDArray[np.bool_]
    sided: SidedVoxels

    def __len__(self) -> int:
        return len(self.codes)

    @property
    def cells(self) -> NDArray[np.int32]:
        """(n, 3) integer coordinates in the grid."""
        return morton_cells(self.codes)

    @property
    def centers(self) -> NDArray[np.float64]:
        """(n, 3) middles of the voxels, in the mesh's frame."""
        return self.grid.origin + (self.cells + 0.5) * self.grid.voxel_size

    def subset(self, keep: NDArray[np.bool_]) -> VoxelSet:
        """The voxels where ``keep`` (n,) is true."""
        kept_sides = keep[self.sided.index]
        new_index = np.cumsum(keep, dtype=np.int64) - 1
        colors = self.sided.color
        return VoxelSet(
            self.grid,
            self.codes[keep],
            self.area[keep],
            self.normal[keep],
            None if self.color is None else self.color[keep],
            self.faces[keep],
            self.separating[keep],
            SidedVoxels(
                new_index[self.sided.index[kept_sides]],
                self.sided.normal[kept_sides],
                None if colors is None else colors[kept_sides],
            ),
        )


def joined_voxels(parts: Sequence[VoxelSet]) -> VoxelSet:
    """One set of several that follow one another in Morton order.

    Raises
    ------
    ValueError
        No parts, parts of different grids, or parts out of order.
    """
    grids = {(*part.grid.origin, part.grid.size, part.grid.level) for part in parts}
    if len(grids) != 1:
        raise ValueError("voxels of one grid, at least one part, can be joined")
    codes = np.concatenate([part.codes for part in parts])
    if (codes[1:] <= codes[:-1]).any():
        raise ValueError("parts must follow one another in Morton order")
    starts = np.cumsum([0, *(len(part) for part in parts)])
    colors = [part.color for part in parts if part.color is not None]
    side_colors = [part.sided.color for part in parts if part.sided.color is not None]
    return VoxelSet(
        parts[0].grid,
        codes,
        np.concatenate([part.area for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate(colors) if len(colors) == len(parts) else None,
        np.concatenate([part.faces for part in parts]),
        np.concatenate([part.separating for part in parts]),
        SidedVoxels(
            np.concatenate(
                [part.sided.index + start for part, start in zip(parts, starts, strict=False)]
            ),
            np.concatenate([part.sided.normal for part in parts]),
            np.concatenate(side_colors) if len(side_colors) == len(parts) else None,
        ),
    )
