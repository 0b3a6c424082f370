"""Points as occupied cells of a grid: one point for each cell, at its middle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.geometry.point_set import PointSet
from workbench.kernels.morton import BITS_PER_AXIS, morton_cells, morton_codes
from workbench.kernels.point_merging import merge_colors, merge_normals

_MARGIN = 1e-7


@dataclass(frozen=True)
class CellFrame:
    """A grid of cubic cells, aligned with the axes.

    Attributes
    ----------
    origin : (3,) float64, its corner with the lowest coordinates, in the points' frame.
    cell_size : side of a cell, in the unit of the points.
    level : 1…21; cells have coordinates in [0, 2**level).
    """

    origin: NDArray[np.float64]
    cell_size: float
    level: int

    def centers(self, cells: NDArray[np.int32]) -> NDArray[np.float64]:
        """(n, 3) middles of cells (n, 3), in the points' frame."""
        return np.asarray(self.origin + (cells + 0.5) * self.cell_size)


@dataclass(frozen=True)
class PointCells:
    """Occupied cells, each once, and what is known of the points in them.

    Attributes
    ----------
    frame : the grid.
    cells : (n, 3) int32.
    normals : (n, 3) float32 unit normals, zero where those of a cell cancel, or None.
    color : (n, 3) uint8 sRGB, or None.
    merged : points that fell into a cell which another one has already.
    """

    frame: CellFrame
    cells: NDArray[np.int32]
    normals: NDArray[np.float32] | None = None
    color: NDArray[np.uint8] | None = None
    merged: int = 0

    def __len__(self) -> int:
        return len(self.cells)

    def chosen(self, which: NDArray[np.generic]) -> PointCells:
        """The rows ``which`` picks, in its order."""
        return PointCells(
            self.frame,
            self.cells[which],
            None if self.normals is None else self.normals[which],
            None if self.color is None else self.color[which],
            self.merged,
        )

    def point_set(self) -> PointSet:
        """Middles of the cells, with a radius that lets discs of them close a surface."""
        # Half the diagonal of a cell: discs of neighbours then overlap however they lie.
        radius = np.full(len(self), 0.5 * math.sqrt(3) * self.frame.cell_size, np.float32)
        return PointSet(self.frame.centers(self.cells), self.normals, self.color, radius)


def frame_of_resolution(points: NDArray[np.float64], resolution: int) -> CellFrame:
    """The grid whose cube of ``resolution`` cells a side just holds points (n, 3).

    Raises
    ------
    SettingsError
        A resolution out of bounds.
    InputError
        No points, points that are not finite, or all in one place.
    """
    if not 2 <= resolution <= 1 << BITS_PER_AXIS:
        raise SettingsError(
            "The resolution is out of bounds.",
            expected=f"2 to {1 << BITS_PER_AXIS} cells a side",
            found=str(resolution),
            fix="choose a resolution within them",
        )
    low, high = _bounds(points)
    extent = float((high - low).max())
    if not extent > 0 or not math.isfinite(extent):
        raise InputError(
            "All points lie in one place, or farther apart than numbers reach.",
            found=f"an extent of {extent}",
            fix="Check the file, or give the size of a cell instead of the resolution.",
        )
    size = extent * (1 + _MARGIN)
    origin = 0.5 * low + 0.5 * high - 0.5 * size
    return CellFrame(origin, size / resolution, (resolution - 1).bit_length())


def frame_of_cell_size(points: NDArray[np.float64], cell_size: float) -> CellFrame:
    """The grid of cells of one size whose corner lies half a cell before points (n, 3).

    Raises
    ------
    SettingsError
        A size that is not above zero, or so small that there would be more than 2²¹ cells a
        side.
    InputError
        No points, or points that are not finite.
    """
    if not cell_size > 0 or not math.isfinite(cell_size):
        raise SettingsError(
            "The size of a cell must be above zero.",
            found=str(cell_size),
            fix="give it in the unit of the points",
        )
    low, high = _bounds(points)
    across = float((high - low).max()) / cell_size + 1.5
    if across >= 1 << BITS_PER_AXIS:
        raise SettingsError(
            "The cells are too small for these points.",
            expected=f"{1 << BITS_PER_AXIS} cells a side at most",
            found=f"{across:.0f}",
            fix="choose larger cells, or split the cloud",
        )
    return CellFrame(low - 0.5 * cell_size, float(cell_size), max(int(across).bit_length(), 1))


def cells_of_points(points: PointSet, frame: CellFrame) -> PointCells:
    """The cells that points occupy, in Morton order.

    Points that share a cell become one: colours are averaged in linear light, normals added
    up and made unit again. The most a point moves is half the diagonal of a cell.

    Parameters
    ----------
    points
        At least one, all inside the frame; their radii are left behind.
    frame
        Such as `frame_of_resolution` or `frame_of_cell_size` gives.

    Raises
    ------
    InputError
        No points, or points that are not finite or lie outside the frame.
    """
    _bounds(points.points)
    places = np.floor((points.points - frame.origin) / frame.cell_size)
    if places.min() < 0 or places.max() >= 1 << frame.level:
        outside = int(((places < 0) | (places >= 1 << frame.level)).any(axis=1).sum())
        raise InputError(
            "Points lie outside the grid of cells.",
            expected=f"points within {1 << frame.level} cells of {frame.origin}",
            found=f"{outside} of {len(points)} outside",
            fix="Make the grid of these points.",
        )
    codes = morton_codes(places.astype(np.int32))
    order = np.argsort(codes, kind="stable")
    codes = codes[order]
    firsts = np.flatnonzero(np.concatenate([[True], codes[1:] != codes[:-1]]))
    starts = np.append(firsts, len(codes))
    normals = color = None
    if points.normals is not None:
        normals = np.empty((len(firsts), 3), np.float32)
        merge_normals(order, starts, points.normals, normals)
    if points.color is not None:
        color = np.empty((len(firsts), 3), np.uint8)
        merge_colors(order, starts, points.color, color)
    cells = morton_cells(codes[firsts])
    return PointCells(frame, cells, normals, color, len(codes) - len(firsts))


def _bounds(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest coordinates (3,) of points that have some."""
    wrong = int((~np.isfinite(points)).any(axis=1).sum())
    if not len(points) or wrong:
        raise InputError(
            "A cloud without points, or with points that are not finite, has no cells.",
            expected="finite coordinates",
            found=f"{wrong} of {len(points)} not finite" if len(points) else "no points",
            fix="Remove these points first.",
        )
    return points.min(axis=0), points.max(axis=0)
