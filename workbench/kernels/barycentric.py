"""How much of each corner a place on a triangle has."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def corner_shares(
    places: NDArray[np.float64],
    i: int,
    vertices: NDArray[np.float64],
    a: int,
    b: int,
    c: int,
) -> tuple[float, float, float]:
    """Shares of vertices a, b and c in place i, which lies on their triangle or near its plane.

    They add up to 1 and are a third each where the triangle has no area.
    """
    bb, bc, cc, bp, cp = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v = vertices[b, k] - vertices[a, k], vertices[c, k] - vertices[a, k]
        p = places[i, k] - vertices[a, k]
        bb += u * u
        bc += u * v
        cc += v * v
        bp += u * p
        cp += v * p
    area = bb * cc - bc * bc
    wb, wc = 1.0 / 3.0, 1.0 / 3.0
    if area > 0.0:
        wb = min(max((cc * bp - bc * cp) / area, 0.0), 1.0)
        wc = min(max((bb * cp - bc * bp) / area, 0.0), 1.0 - wb)
    return 1.0 - wb - wc, wb, wc


@njit(cache=True, nogil=True)
def shares_of_corners(
    places: NDArray[np.float64],
    vertices: NDArray[np.float64],
    corners: NDArray[np.int32],
) -> NDArray[np.float64]:
    """`corner_shares` (n, 3) of places (n, 3), each in its triangle's corners (n, 3)."""
    shares = np.empty((len(places), 3))
    for i in range(len(places)):
        shares[i] = corner_shares(places, i, vertices, corners[i, 0], corners[i, 1], corners[i, 2])
    return shares
