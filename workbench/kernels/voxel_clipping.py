"""Triangles cut by the planes of a voxel grid, so that mirrored input is cut mirrored.

Coordinates are in voxels with zero at a corner of voxels in the middle of the grid: planes
are the integers, and a change of sign commutes with every step of the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

# A triangle cut by six planes has at most nine corners.
MOST_CORNERS = 9
# Neighbours that meet where a line through voxels ends on their common face must not both
# miss it for a rounding error.
_TIP = 1e-9


@njit(cache=True, nogil=True)
def _crossing(
    polygon: NDArray[np.float64], a: int, b: int, axis: int, plane: float,
    out: NDArray[np.float64], row: int,
) -> None:  # fmt: skip
    """Where the edge from corner a to b meets a plane: the same bits from b to a.

    Corners go by row and not as views: counting references to views would cost more than
    the arithmetic.
    """
    to_a, to_b = abs(polygon[a, axis] - plane), abs(polygon[b, axis] - plane)
    if to_a == to_b:
        for k in range(3):
            out[row, k] = 0.5 * (polygon[a, k] + polygon[b, k])
    else:
        # From the nearer end.
        near, far = (a, b) if to_a < to_b else (b, a)
        t = min(to_a, to_b) / (to_a + to_b)
        for k in range(3):
            out[row, k] = polygon[near, k] + t * (polygon[far, k] - polygon[near, k])
    out[row, axis] = plane


@njit(cache=True, nogil=True)
def slab_polygon(
    polygon: NDArray[np.float64], corners: int, axis: int, low: float, high: float,
    out: NDArray[np.float64],
) -> int:  # fmt: skip
    """The part of a convex polygon between two planes, planes included.

    Both planes are served in one walk along the edges, so that exchanging them, as a mirror
    does, leaves the order of the corners.

    Parameters
    ----------
    polygon : (≥ corners, 3) its corners in order; points and segments are polygons too.
    axis, low, high : the slab ``low <= p[axis] <= high``.
    out : (≥ corners + 2, 3) receives the corners of the part.

    Returns
    -------
    Number of corners of the part, 0 where none is left.
    """
    count = 0
    for a in range(corners):
        b = a + 1 if a + 1 < corners else 0
        from_, to = polygon[a, axis], polygon[b, axis]
        if low <= from_ <= high:
            for k in range(3):
                out[count, k] = polygon[a, k]
            count += 1
        if from_ < to:
            if from_ < low < to:
                _crossing(polygon, a, b, axis, low, out, count)
                count += 1
            if from_ < high < to:
                _crossing(polygon, a, b, axis, high, out, count)
                count += 1
        else:
            if to < high < from_:
                _crossing(polygon, a, b, axis, high, out, count)
                count += 1
            if to < low < from_:
                _crossing(polygon, a, b, axis, low, out, count)
                count += 1
    return count


@njit(cache=True, nogil=True)
def touched_range(polygon: NDArray[np.float64], corners: int, axis: int) -> tuple[int, int]:
    """First and last cell along an axis whose closed interval the polygon touches."""
    low = high = polygon[0, axis]
    for i in range(1, corners):
        low = min(low, polygon[i, axis])
        high = max(high, polygon[i, axis])
    return math.ceil(low) - 1, math.floor(high)


@njit(cache=True, nogil=True)
def projected_centroid(
    polygon: NDArray[np.float64], corners: int, u: int, v: int
) -> tuple[float, float, float]:
    """Signed area of a polygon seen along the third axis, and its centroid in (u, v).

    Without area the centroid is the mean of the corners.
    """
    u0, v0 = polygon[0, u], polygon[0, v]
    twice = moment_u = moment_v = 0.0
    for i in range(1, corners - 1):
        bu, bv = polygon[i, u] - u0, polygon[i, v] - v0
        cu, cv = polygon[i + 1, u] - u0, polygon[i + 1, v] - v0
        part = bu * cv - bv * cu
        twice += part
        moment_u += part * (bu + cu)
        moment_v += part * (bv + cv)
    if twice != 0.0:
        return 0.5 * twice, u0 + moment_u / (3.0 * twice), v0 + moment_v / (3.0 * twice)
    mean_u = mean_v = 0.0
    for i in range(corners):
        mean_u += polygon[i, u] - u0
        mean_v += polygon[i, v] - v0
    return 0.0, u0 + mean_u / corners, v0 + mean_v / corners


@njit(cache=True, nogil=True)
def separates(corners: NDArray[np.float64], x: float, y: float, z: float) -> bool:
    """Whether a triangle (3, 3) meets the cross of three axes through a voxel around (x, y, z).

    The target of the 6-separating voxelisation (Laine 2013): the segments of unit length
    through the middle. A line on the edge of two triangles belongs to both.
    """
    ax, ay, az = corners[0, 0] - x, corners[0, 1] - y, corners[0, 2] - z
    bx, by, bz = corners[1, 0] - x, corners[1, 1] - y, corners[1, 2] - z
    cx, cy, cz = corners[2, 0] - x, corners[2, 1] - y, corners[2, 2] - z
    return bool(
        _meets_axis(ax, ay, az, bx, by, bz, cx, cy, cz)
        or _meets_axis(ay, az, ax, by, bz, bx, cy, cz, cx)
        or _meets_axis(az, ax, ay, bz, bx, by, cz, cx, cy)
    )


@njit(cache=True, nogil=True)
def _meets_axis(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float,
) -> bool:  # fmt: skip
    """Whether a triangle meets the segment from −½ to ½ on the third axis."""
    # Each term changes its sign, and nothing else, when an edge is walked the other way:
    # of two triangles on an edge one has the point, or both.
    on_bc = bx * cy - by * cx
    on_ca = cx * ay - cy * ax
    on_ab = ax * by - ay * bx
    if min(on_bc, on_ca, on_ab) < 0.0 < max(on_bc, on_ca, on_ab):
        return False
    total = on_bc + on_ca + on_ab
    if total == 0.0:
        return False
    return abs((on_bc * az + on_ca * bz + on_ab * cz) / total) <= 0.5 + _TIP
