"""What rays of one direction see of triangles: places, normals and sides."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def seen_places(
    corners: NDArray[np.float64],
    corner_normals: NDArray[np.float32],
    hits: NDArray[np.int64],
    numbers: NDArray[np.int64],
    shares: NDArray[np.float32],
    forward: NDArray[np.float64],
    grazing: float,
    leak: float,
    points: NDArray[np.float64],
    normals: NDArray[np.float32],
    weights: NDArray[np.float64],
    triangles: NDArray[np.int64],
) -> int:
    """Fill the places that rays meet; how many there are.

    Parameters
    ----------
    corners : (m, 3, 3) of the triangles.
    corner_normals : (k, 3, 3) of all triangles there are, unit, on either side.
    hits : (n,) the triangle of each ray that meets one, a row of ``corners``.
    numbers : (m,) rows of the triangles in ``corner_normals``.
    shares : (n, 2) of its second and third corner.
    forward : (3,) unit direction of all rays.
    grazing : least cosine between ray and triangle: places that are seen more aslant are left out,
        for it is not known from which side they are seen.
    leak : triangles seen from behind as near to one of their edges as this are left out, in the
        unit of the corners: a ray may have slipped past the edge of the triangle before it.
    points : (n, 3) on the triangles.
    normals : (n, 3) unit, smooth, on the side that is seen.
    weights : (n, 3) of the corners.
    triangles : (n,) of ``numbers``.
    """
    count = 0
    for i in range(len(hits)):
        t = hits[i]
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = math.sqrt(nx * nx + ny * ny + nz * nz)
        if not area > 0.0:
            continue
        facing = (nx * forward[0] + ny * forward[1] + nz * forward[2]) / area
        if abs(facing) < grazing:
            continue
        second, third = float(shares[i, 0]), float(shares[i, 1])
        first = 1.0 - second - third
        if facing > 0.0:
            wx, wy, wz = vx - ux, vy - uy, vz - uz
            longest = max(
                ux * ux + uy * uy + uz * uz,
                max(vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz),
            )
            if min(first, min(second, third)) * math.sqrt(longest) < leak:
                continue
        side = -1.0 / area if facing > 0.0 else 1.0 / area
        nx, ny, nz = nx * side, ny * side, nz * side
        p = corner_normals[numbers[t]]
        sx = first * p[0, 0] + second * p[1, 0] + third * p[2, 0]
        sy = first * p[0, 1] + second * p[1, 1] + third * p[2, 1]
        sz = first * p[0, 2] + second * p[1, 2] + third * p[2, 2]
        length = math.sqrt(sx * sx + sy * sy + sz * sz)
        # Corners may cancel each other out: then the triangle's own normal is all there is.
        if length > 1e-6:
            turn = -1.0 if sx * nx + sy * ny + sz * nz < 0.0 else 1.0
            nx, ny, nz = sx * turn / length, sy * turn / length, sz * turn / length
        points[count, 0] = a[0] + second * ux + third * vx
        points[count, 1] = a[1] + second * uy + third * vy
        points[count, 2] = a[2] + second * uz + third * vz
        normals[count, 0], normals[count, 1], normals[count, 2] = nx, ny, nz
        weights[count, 0], weights[count, 1], weights[count, 2] = first, second, third
        triangles[count] = numbers[t]
        count += 1
    return count
