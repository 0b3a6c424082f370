"""What the depth maps of other views say of each pixel's depth."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.patch_cost import Pairs


@njit(cache=True, nogil=True, error_model="numpy")
def agreement(
    planes: NDArray[np.float32],
    sigma: NDArray[np.float32],
    pairs: Pairs,
    other_planes: NDArray[np.float32],
    other_sigma: NDArray[np.float32],
    sizes: NDArray[np.int64],
    most_px: float,
    most_share: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """The mean of a pixel's depth and of what other views say of it, how sure it is, how many.

    A view says something where its depth map leads back to within ``most_px`` pixels of where
    one came from, at a depth that differs by a share of ``most_share`` at most; it is taken
    where its plane meets the pixel's own ray, and weighs by its certainty.

    Parameters
    ----------
    planes, sigma : (h, w, 3), (h, w) of the view; an infinite sigma is no depth.
    pairs : see `workbench.kernels.patch_match`.
    other_planes, other_sigma : (v, h, w, 3), (v, h, w) of the others.
    sizes : (v, 2) widths and heights of the others.

    Returns
    -------
    Nearness (h, w), its standard deviation (h, w) and the number (h, w) of other views that
    agree. The deviation is what views differ by where that is more than they claim.
    """
    height, width = sigma.shape
    A, e, back_A, back_e = pairs
    nearness = np.zeros((height, width))
    deviation = np.full((height, width), np.inf)
    count = np.zeros((height, width), np.int64)
    for y in range(height):
        for x in range(width):
            if not np.isfinite(sigma[y, x]):
                continue
            w, a, b = float(planes[y, x, 0]), float(planes[y, x, 1]), float(planes[y, x, 2])
            total = 1.0 / float(sigma[y, x]) ** 2
            mean, squares = total * w, total * w * w
            for v in range(len(e)):
                qz = A[v, 2, 0] * x + A[v, 2, 1] * y + A[v, 2, 2] + w * e[v, 2]
                if qz <= 0.0:
                    continue
                u = (A[v, 0, 0] * x + A[v, 0, 1] * y + A[v, 0, 2] + w * e[v, 0]) / qz
                t = (A[v, 1, 0] * x + A[v, 1, 1] * y + A[v, 1, 2] + w * e[v, 1]) / qz
                if not (0.0 <= u < sizes[v, 0] - 1 and 0.0 <= t < sizes[v, 1] - 1):
                    continue
                i, j = int(u + 0.5), int(t + 0.5)
                if not np.isfinite(other_sigma[v, j, i]):
                    continue
                other = other_planes[v, j, i]
                near = other[0] + other[1] * (u - i) + other[2] * (t - j)
                if near <= 0.0:
                    continue
                pz = (
                    back_A[v, 2, 0] * u
                    + back_A[v, 2, 1] * t
                    + back_A[v, 2, 2]
                    + near * back_e[v, 2]
                )
                if pz <= 0.0:
                    continue
                px = (
                    back_A[v, 0, 0] * u
                    + back_A[v, 0, 1] * t
                    + back_A[v, 0, 2]
                    + near * back_e[v, 0]
                )
                py = (
                    back_A[v, 1, 0] * u
                    + back_A[v, 1, 1] * t
                    + back_A[v, 1, 2]
                    + near * back_e[v, 1]
                )
                dx, dy = px / pz - x, py / pz - y
                there = near / pz
                if math.hypot(dx, dy) > most_px or abs(there - w) > most_share * w:
                    continue
                # Depths' deviations are alike on both rays; nearness is one over depth.
                unsure = other_sigma[v, j, i] / (near * near) * w * w
                weight = 1.0 / (unsure * unsure)
                said = there - a * dx - b * dy
                total += weight
                mean += weight * said
                squares += weight * said * said
                count[y, x] += 1
            mean /= total
            nearness[y, x] = mean
            scatter = max(squares / total - mean * mean, 0.0) / max(count[y, x], 1)
            deviation[y, x] = math.sqrt(max(1.0 / total, scatter))
    return nearness, deviation, count
