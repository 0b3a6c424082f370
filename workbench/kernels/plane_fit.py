"""Local planes over a range grid, one per sample.

For every sample the window of grid neighbours is gathered, neighbours across a depth step
are left out, and a plane is fitted by the smallest eigenvector of their covariance.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray


@nb.njit(cache=True, nogil=True)
def smallest_eigenvector(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[float, float, float, float, float, float]:
    """Smallest eigenpair and the two other eigenvalues of a symmetric 3×3 matrix.

    Cyclic Jacobi rotations: unlike the closed form it keeps its relative accuracy when
    two eigenvalues nearly coincide, and a handful of sweeps reach machine precision.

    Returns
    -------
    (smallest, middle, largest, x, y, z) with (x, y, z) the unit vector of the smallest.
    """
    a = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    v = np.eye(3)
    scale = abs(xx) + abs(yy) + abs(zz)
    for _ in range(12):
        off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
        if off <= 1e-17 * scale:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    akp, akq = a[k, p], a[k, q]
                    a[k, p] = c * akp - s * akq
                    a[k, q] = s * akp + c * akq
                for k in range(3):
                    apk, aqk = a[p, k], a[q, k]
                    a[p, k] = c * apk - s * aqk
                    a[q, k] = s * apk + c * aqk
                for k in range(3):
                    vkp, vkq = v[k, p], v[k, q]
                    v[k, p] = c * vkp - s * vkq
                    v[k, q] = s * vkp + c * vkq
    low = 0
    for k in range(1, 3):
        if a[k, k] < a[low, low]:
            low = k
    first, second = a[(low + 1) % 3, (low + 1) % 3], a[(low + 2) % 3, (low + 2) % 3]
    return (
        a[low, low],
        min(first, second),
        max(first, second),
        v[0, low],
        v[1, low],
        v[2, low],
    )


@nb.njit(cache=True, nogil=True)
def grid_planes(
    points: NDArray[np.float64],
    grid: NDArray[np.int32],
    half_window: int,
    step_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Plane, spread and neighbour counts of every sample on a range grid.

    Parameters
    ----------
    points : (n, 3) float64.
    grid : (rows, cols) int32 indices into the points, −1 for none.
    half_window : the window is 2·half_window + 1 cells wide.
    step_m : (n,) float64: neighbours further than this per cell of grid distance lie across
        a depth step and do not count.

    Returns
    -------
    normals : (n, 3) float64 unit, sign arbitrary; zero where fewer than three neighbours
        or all on a line.
    residual : (n,) float64, root mean square distance of the neighbours to the plane.
    neighbours : (n,) int32, samples used, itself included.
    missing : (n,) int32, of the eight direct grid neighbours those absent or across a step.
    """
    n = len(points)
    rows, cols = grid.shape
    normals = np.zeros((n, 3))
    residual = np.zeros(n)
    neighbours = np.zeros(n, np.int32)
    missing = np.full(n, 8, np.int32)
    for r in range(rows):
        for c in range(cols):
            i = grid[r, c]
            if i < 0:
                continue
            sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = 0.0
            count, ring = 0, 0
            for dr in range(-half_window, half_window + 1):
                rr = r + dr
                if rr < 0 or rr >= rows:
                    continue
                for dc in range(-half_window, half_window + 1):
                    cc = c + dc
                    if cc < 0 or cc >= cols:
                        continue
                    j = grid[rr, cc]
                    if j < 0:
                        continue
                    # Offsets from the centre keep the moments accurate far from the origin.
                    x = points[j, 0] - points[i, 0]
                    y = points[j, 1] - points[i, 1]
                    z = points[j, 2] - points[i, 2]
                    limit = step_m[i] * max(abs(dr), abs(dc))
                    if x * x + y * y + z * z > limit * limit and j != i:
                        continue
                    if abs(dr) <= 1 and abs(dc) <= 1 and j != i:
                        ring += 1
                    count += 1
                    sx += x
                    sy += y
                    sz += z
                    sxx += x * x
                    sxy += x * y
                    sxz += x * z
                    syy += y * y
                    syz += y * z
                    szz += z * z
            neighbours[i] = count
            missing[i] = 8 - ring
            if count < 3:
                continue
            mx, my, mz = sx / count, sy / count, sz / count
            low, middle, high, nx, ny, nz = smallest_eigenvector(
                sxx / count - mx * mx,
                sxy / count - mx * my,
                sxz / count - mx * mz,
                syy / count - my * my,
                syz / count - my * mz,
                szz / count - mz * mz,
            )
            if middle <= 1e-12 * high:
                continue
            normals[i, 0], normals[i, 1], normals[i, 2] = nx, ny, nz
            residual[i] = np.sqrt(max(low, 0.0))
    return normals, residual, neighbours, missing


@nb.njit(cache=True, nogil=True)
def grid_spacing(
    points: NDArray[np.float64], grid: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances of every sample to its closest and fourth-closest direct grid neighbour.

    The closest of eight lies on the same surface unless the sample is alone there; the
    fourth closest is the coarser of the two grid directions on a surface seen obliquely.
    Both are inf where there are too few neighbours.
    """
    rows, cols = grid.shape
    closest = np.full(len(points), np.inf)
    fourth = np.full(len(points), np.inf)
    for r in range(rows):
        for c in range(cols):
            i = grid[r, c]
            if i < 0:
                continue
            d0 = d1 = d2 = d3 = np.inf
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    rr, cc = r + dr, c + dc
                    if (dr == 0 and dc == 0) or rr < 0 or cc < 0 or rr >= rows or cc >= cols:
                        continue
                    j = grid[rr, cc]
                    if j < 0:
                        continue
                    x = points[j, 0] - points[i, 0]
                    y = points[j, 1] - points[i, 1]
                    z = points[j, 2] - points[i, 2]
                    d = np.sqrt(x * x + y * y + z * z)
                    if d < d0:
                        d0, d1, d2, d3 = d, d0, d1, d2
                    elif d < d1:
                        d1, d2, d3 = d, d1, d2
                    elif d < d2:
                        d2, d3 = d, d2
                    elif d < d3:
                        d3 = d
            closest[i], fourth[i] = d0, d3
    return closest, fourth
