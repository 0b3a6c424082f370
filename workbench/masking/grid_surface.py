"""The surface that a scanner's grid samples: incidence and roughness per sample, depth steps.

Planes are fitted to the nine samples around each sample, and every sample then takes the
plane, its own or a neighbour's, that explains the samples best and itself lies on: so an edge
or a concave corner keeps its two orientations apart.

Source: Kuwahara et al. 1976 for the choice of the best window.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.rangemap import RangeMap
from workbench.kernels.plane_fit import grid_planes, grid_spacing

# A grazing surface is stretched along the sight; only what is this many times as far as the
# closest sample is across a depth step for certain.
_REACH = 12.0
# A plane is worth little to a sample that lies off it.
_OFF_PLANE = 4.0
_LEAST_SAMPLES = 4

# Half of the eight neighbours: right, down, and both diagonals.
HALF_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True)
class GridSurface:
    """What the neighbourhood tells of every sample of a range map.

    Attributes
    ----------
    spacing_m : (n,) float64, distance to the closest neighbour on the grid, never below half
        the median, which also stands in where there is none.
    normals : (n, 3) float64, unit, towards the scanner where its place is known; NaN for
        samples without a surface around.
    incidence_cos : (n,) float64 in [0, 1], cosine between normal and line of sight; NaN
        where the scanner's place or the normal is unknown.
    roughness : (n,) float64, RMS distance to the plane in sample spacings; NaN likewise.
    """

    spacing_m: NDArray[np.float64]
    normals: NDArray[np.float64]
    incidence_cos: NDArray[np.float64]
    roughness: NDArray[np.float64]


def grid_of(scan: RangeMap) -> NDArray[np.int32]:
    """The scanner's grid, (rows, cols) int32 of sample indices, −1 for none.

    Raises
    ------
    InputError : the scan has none.
    """
    if scan.grid is None:
        raise InputError(
            f"the scan {scan.name} has no grid, so it can have no mask",
            fix="export the scan with the scanner's own grid",
        )
    return scan.grid


def grid_image(scan: RangeMap, values: NDArray[np.generic], hole: float) -> NDArray[np.generic]:
    """Values (n, …) of the samples laid out on the grid, (rows, cols, …); ``hole`` elsewhere."""
    grid = grid_of(scan)
    image = np.full((*grid.shape, *values.shape[1:]), hole, values.dtype)
    image[grid >= 0] = values[grid[grid >= 0]]
    return image


def grid_surface(scan: RangeMap) -> GridSurface:
    """Spacing, orientation and roughness of every sample.

    Raises
    ------
    InputError : the scan has no grid.
    """
    points, grid = scan.points_in_scan, grid_of(scan)
    nearest, _ = grid_spacing(points, grid)
    finite = nearest[np.isfinite(nearest)]
    typical = float(np.median(finite)) if len(finite) else 1.0
    spacing = np.where(np.isfinite(nearest), np.maximum(nearest, 0.5 * typical), typical)
    normals, residual = _best_planes(points, grid, _REACH * spacing)
    unknown = ~np.isfinite(residual)
    normals[unknown] = np.nan
    if scan.viewpoint_in_scan is None:
        cosine = np.full(len(scan), np.nan)
    else:
        sight = scan.viewpoint_in_scan - points
        length = np.linalg.norm(sight, axis=1)
        cosine = np.einsum("ni,ni->n", normals, sight) / np.where(length > 0, length, 1.0)
        normals = np.where(cosine[:, None] < 0, -normals, normals)
        cosine = np.minimum(np.abs(cosine), 1.0)
    roughness = np.where(unknown, np.nan, residual / spacing)
    return GridSurface(spacing, normals, cosine, roughness)


def neighbour_pairs(
    grid: NDArray[np.int32], offset: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Samples at each cell and at the cell ``offset`` (rows, columns) from it: two (m,) int32.

    In the grid's order; pairs with a hole or beyond the frame are left out.
    """
    (rows, cols), (down, right) = grid.shape, offset
    here = grid[max(0, -down) : rows - max(0, down), max(0, -right) : cols - max(0, right)]
    there = grid[max(0, down) : rows + min(0, down), max(0, right) : cols + min(0, right)]
    both = (here >= 0) & (there >= 0)
    return here[both], there[both]


def stretch(
    scan: RangeMap, surface: GridSurface, a: NDArray[np.int32], b: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Distances (m,) of pairs of samples in spacings: 1 to 1.5 on a surface, more across a step."""
    gap = np.linalg.norm(scan.points_in_scan[a] - scan.points_in_scan[b], axis=1)
    return np.asarray(gap / np.minimum(surface.spacing_m[a], surface.spacing_m[b]), np.float64)


def _best_planes(
    points: NDArray[np.float64], grid: NDArray[np.int32], reach_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals (n, 3) and residuals (n,) of the best plane around; inf where there is none."""
    normals, residual, used, _ = grid_planes(points, grid, 1, reach_m)
    fitted = (used >= _LEAST_SAMPLES) & (normals != 0).any(axis=1)
    cost = np.full(len(points), np.inf)
    chosen = np.zeros(points.shape)
    spread = np.full(len(points), np.inf)
    for i, j in _windows(grid):
        away = points[i] - points[j]
        off = np.einsum("mk,mk->m", away, normals[j])
        near = np.einsum("mk,mk->m", away, away) <= reach_m[j] ** 2
        worth = np.where(fitted[j] & near, residual[j] ** 2 + _OFF_PLANE * np.square(off), np.inf)
        better = worth < cost[i]
        to, source = i[better], j[better]
        cost[to], chosen[to], spread[to] = worth[better], normals[source], residual[source]
    return chosen, spread


def _windows(grid: NDArray[np.int32]) -> Iterator[tuple[NDArray[np.int32], NDArray[np.int32]]]:
    """Every sample with each centre of a window it is in, its own first."""
    steps = sorted(
        ((r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)), key=lambda s: abs(s[0]) + abs(s[1])
    )
    for step in steps:
        yield neighbour_pairs(grid, step)
