"""Brown's radial and tangential distortion and its inverse."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_NEWTON_STEPS = 20


@njit(cache=True, nogil=True)
def distorted_point(
    x: float, y: float, k1: float, k2: float, p1: float, p2: float
) -> tuple[float, float]:
    """Where an ideal point of the image plane at depth 1 is imaged (COLMAP's OPENCV model)."""
    r2 = x * x + y * y
    radial = r2 * (k1 + k2 * r2)
    return (
        x + x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y + y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
    )


@njit(cache=True, nogil=True)
def undistorted_point(
    u: float, v: float, k1: float, k2: float, p1: float, p2: float
) -> tuple[float, float]:
    """The ideal point that is imaged at (u, v), by Newton's method from (u, v) itself.

    NaN where there is none, or none on this side of the circle at which the lens folds the
    image plane over.
    """
    x, y = u, v
    for _ in range(_NEWTON_STEPS):
        r2 = x * x + y * y
        radial = r2 * (k1 + k2 * r2)
        slope = k1 + 2.0 * k2 * r2
        ex = x + x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - u
        ey = y + y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y) - v
        xx = 1.0 + radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
        yy = 1.0 + radial + 2.0 * y * y * slope + 2.0 * p2 * x + 6.0 * p1 * y
        xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        det = xx * yy - xy * xy
        dx = (yy * ex - xy * ey) / det
        dy = (xx * ey - xy * ex) / det
        x -= dx
        y -= dy
        # Convergence is quadratic: what is left is of the order of this step squared.
        if math.fabs(dx) + math.fabs(dy) < 1e-9:
            if det > 0.0 and xx > 0.0:
                return x, y
            break
    return math.nan, math.nan


@njit(cache=True, nogil=True)
def distorted_points(
    points: NDArray[np.float64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Imaged points (n, 2) of ideal points (n, 2); coefficients are k1, k2, p1, p2."""
    k1, k2, p1, p2 = coefficients
    out = np.empty_like(points)
    for i in range(len(points)):
        out[i, 0], out[i, 1] = distorted_point(points[i, 0], points[i, 1], k1, k2, p1, p2)
    return out


@njit(cache=True, nogil=True)
def undistorted_points(
    points: NDArray[np.float64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Ideal points (n, 2) of imaged points (n, 2); coefficients are k1, k2, p1, p2."""
    k1, k2, p1, p2 = coefficients
    out = np.empty_like(points)
    for i in range(len(points)):
        out[i, 0], out[i, 1] = undistorted_point(points[i, 0], points[i, 1], k1, k2, p1, p2)
    return out
