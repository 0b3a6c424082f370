"""Normal equations of cameras and points: observations added to them, points eliminated.

A product of sparse matrices looks for the place of every number anew. Here the unknowns of the
cameras that a point depends on are listed once, and every observation knows its places there.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def add_observations(
    camera_hessian: NDArray[np.float64],
    camera_gradient: NDArray[np.float64],
    point_hessian: NDArray[np.float64],
    point_gradient: NDArray[np.float64],
    blocks: NDArray[np.float64],
    unknowns: NDArray[np.int64],
    places: NDArray[np.int64],
    points: NDArray[np.int64],
    by_camera: NDArray[np.float64],
    by_point: NDArray[np.float64],
    residuals: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> None:
    """Add weighted observations of two residuals each, in place and in their order.

    Parameters
    ----------
    camera_hessian, camera_gradient : (c, c), of which the lower half is added to, and (c,).
    point_hessian, point_gradient : (p, 3, 3) and (p, 3).
    blocks : (n, 3) derivatives by an unknown of a camera and a point.
    unknowns : (n,) that ``blocks`` are of, rising in each point.
    places : (m, u) of each observation the blocks of its unknowns, rising; −1 where it has fewer.
    points : (m,) rows of the points.
    by_camera, by_point : (m, 2, u) and (m, 2, 3) derivatives of the residuals.
    residuals, weights : (m, 2) and (m,).
    """
    for m in range(len(weights)):
        weight, point = weights[m], points[m]
        first, second = residuals[m, 0], residuals[m, 1]
        for i in range(3):
            x, y = weight * by_point[m, 0, i], weight * by_point[m, 1, i]
            point_gradient[point, i] += x * first + y * second
            for j in range(3):
                point_hessian[point, i, j] += x * by_point[m, 0, j] + y * by_point[m, 1, j]
        for i in range(places.shape[1]):
            place = places[m, i]
            if place < 0:
                break
            row = unknowns[place]
            x, y = weight * by_camera[m, 0, i], weight * by_camera[m, 1, i]
            camera_gradient[row] += x * first + y * second
            for j in range(3):
                blocks[place, j] += x * by_point[m, 0, j] + y * by_point[m, 1, j]
            for j in range(i + 1):
                column = unknowns[places[m, j]]
                camera_hessian[row, column] += x * by_camera[m, 0, j] + y * by_camera[m, 1, j]


@numba.njit(cache=True, nogil=True)
def eliminate_points(
    reduced: NDArray[np.float64],
    right: NDArray[np.float64],
    starts: NDArray[np.int64],
    unknowns: NDArray[np.int64],
    blocks: NDArray[np.float64],
    inverse: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> None:
    """Take W V⁻¹ Wᵀ from a symmetric matrix and add W V⁻¹ g to its right side, in place.

    Parameters
    ----------
    reduced, right : (c, c) and (c,), of the cameras alone.
    starts : (p + 1,) where each point's unknowns begin.
    unknowns : (n,) rows of ``reduced``, rising in each point.
    blocks : (n, 3) of W, of each point and unknown.
    inverse : (p, 3, 3) V⁻¹, symmetric.
    gradient : (p, 3) g, of the points.
    """
    for point in range(len(starts) - 1):
        v, g = inverse[point], gradient[point]
        for a in range(starts[point], starts[point + 1]):
            row = reduced[unknowns[a]]
            x = blocks[a, 0] * v[0, 0] + blocks[a, 1] * v[1, 0] + blocks[a, 2] * v[2, 0]
            y = blocks[a, 0] * v[0, 1] + blocks[a, 1] * v[1, 1] + blocks[a, 2] * v[2, 1]
            z = blocks[a, 0] * v[0, 2] + blocks[a, 1] * v[1, 2] + blocks[a, 2] * v[2, 2]
            right[unknowns[a]] += x * g[0] + y * g[1] + z * g[2]
            for b in range(starts[point], a + 1):
                row[unknowns[b]] -= x * blocks[b, 0] + y * blocks[b, 1] + z * blocks[b, 2]
    for i in range(len(reduced)):
        for j in range(i):
            reduced[j, i] = reduced[i, j]
