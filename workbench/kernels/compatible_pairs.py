"""Which pairs of correspondences of oriented points one rigid motion can explain."""

from __future__ import annotations

from math import acos

import numpy as np
from numba import njit
from numpy.typing import NDArray


def compatible_pairs(
    source_points: NDArray[np.float64],
    source_normals: NDArray[np.float64],
    target_points: NDArray[np.float64],
    target_normals: NDArray[np.float64],
    tolerance_m: float,
    least_apart_m: float,
    angle_rad: float,
) -> NDArray[np.float32]:
    """Compatibility of all pairs of correspondences (pair features of Drost et al. 2010).

    Parameters
    ----------
    source_points, source_normals, target_points, target_normals : (m, 3) float64, row by row
        the same place; normals unit.
    tolerance_m : how much the distance between two places may differ.
    least_apart_m : places closer together on either side are compatible with nothing.
    angle_rad : how much the angle between the normals, and of either to the line between
        the places, may differ.

    Returns
    -------
    (m, m) float32 of 0 and 1, symmetric, 0 on the diagonal.
    """
    return np.asarray(
        _compatible(
            np.ascontiguousarray(source_points, np.float64),
            np.ascontiguousarray(source_normals, np.float64),
            np.ascontiguousarray(target_points, np.float64),
            np.ascontiguousarray(target_normals, np.float64),
            tolerance_m,
            least_apart_m,
            angle_rad,
        )
    )


@njit(cache=True, nogil=True)
def _angle(cosine: float) -> float:
    return acos(min(max(cosine, -1.0), 1.0))


@njit(cache=True, nogil=True)
def _compatible(
    p: NDArray[np.float64],
    n: NDArray[np.float64],
    q: NDArray[np.float64],
    m: NDArray[np.float64],
    tolerance: float,
    least: float,
    angle: float,
) -> NDArray[np.float32]:
    count = len(p)
    result = np.zeros((count, count), np.float32)
    for i in range(count):
        for j in range(i + 1, count):
            ax, ay, az = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
            bx, by, bz = q[j, 0] - q[i, 0], q[j, 1] - q[i, 1], q[j, 2] - q[i, 2]
            a = np.sqrt(ax * ax + ay * ay + az * az)
            b = np.sqrt(bx * bx + by * by + bz * bz)
            if abs(a - b) >= tolerance or min(a, b) <= least:
                continue
            there = _angle(n[i, 0] * n[j, 0] + n[i, 1] * n[j, 1] + n[i, 2] * n[j, 2])
            here = _angle(m[i, 0] * m[j, 0] + m[i, 1] * m[j, 1] + m[i, 2] * m[j, 2])
            if abs(there - here) >= angle:
                continue
            fits = True
            for k in (i, j):
                there = _angle((n[k, 0] * ax + n[k, 1] * ay + n[k, 2] * az) / a)
                here = _angle((m[k, 0] * bx + m[k, 1] * by + m[k, 2] * bz) / b)
                fits = fits and abs(there - here) < angle
            if fits:
                result[i, j] = np.float32(1.0)
                result[j, i] = np.float32(1.0)
    return result
