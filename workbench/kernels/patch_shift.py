"""How far a small patch of one image lies from where it was expected in another."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def _cubic(u: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Catmull and Rom's weights of four neighbours at u in [0, 1), and their derivatives."""
    return (
        0.5 * u * (u * (2.0 - u) - 1.0),
        0.5 * (u * u * (3.0 * u - 5.0) + 2.0),
        0.5 * u * (u * (4.0 - 3.0 * u) + 1.0),
        0.5 * u * u * (u - 1.0),
        0.5 * (u * (4.0 - 3.0 * u) - 1.0),
        0.5 * u * (9.0 * u - 10.0),
        0.5 * (u * (8.0 - 9.0 * u) + 1.0),
        0.5 * u * (3.0 * u - 2.0),
    )


@numba.njit(cache=True, nogil=True)
def _sampled(image: NDArray[np.float32], x: float, y: float) -> tuple[float, float, float]:
    """Cubic value and slopes at (x, y), pixels' middles at whole numbers; NaN outside.

    Linear interpolation blurs between pixels and not on them, which shifts patches by some
    hundredths of a pixel.
    """
    column, row = int(np.floor(x)), int(np.floor(y))
    if column < 1 or row < 1 or column + 2 >= image.shape[1] or row + 2 >= image.shape[0]:
        return np.nan, np.nan, np.nan
    a = _cubic(x - column)
    b = _cubic(y - row)
    value, across, down = 0.0, 0.0, 0.0
    for j in range(4):
        line, slope = 0.0, 0.0
        for i in range(4):
            sample = image[row - 1 + j, column - 1 + i]
            line += a[i] * sample
            slope += a[4 + i] * sample
        value += b[j] * line
        across += b[j] * slope
        down += b[4 + j] * line
    return value, across, down


@numba.njit(cache=True, nogil=True)
def patch_shifts(
    reference: NDArray[np.float32],
    target: NDArray[np.float32],
    reference_xy: NDArray[np.float64],
    target_xy: NDArray[np.float64],
    half: int,
    rounds: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Shifts that bring the target under the reference's patches, by Gauss and Newton.

    Brightness and contrast of the two patches are free. Source: Lucas and Kanade 1981; Baker
    and Matthews 2004, "Lucas-Kanade 20 years on", with gain and bias.

    Parameters
    ----------
    reference, target : (h, w) float32, smooth at the scale of a pixel; NaN is not to be used.
    reference_xy : (n, 2) middles of the patches, pixels' middles at whole numbers.
    target_xy : (n, s, 2) where each of a patch's pixels is expected, row by row.
    half : patches are (2 half + 1)² pixels of the reference.
    rounds : at most.

    Returns
    -------
    (n, 2) shifts to add to where the target was expected, and (n,) correlation in [−1, 1];
    both NaN where a patch leaves an image, is flat, or the shift does not settle.
    """
    count, size = len(reference_xy), (2 * half + 1) ** 2
    shifts = np.full((count, 2), np.nan)
    information = np.full((count, 3), np.nan)
    correlation = np.full(count, np.nan)
    template = np.empty(size)
    value = np.empty(size)
    slope = np.empty((size, 2))
    for n in range(count):
        known = True
        k = 0
        for j in range(-half, half + 1):
            for i in range(-half, half + 1):
                sample, _, _ = _sampled(reference, reference_xy[n, 0] + i, reference_xy[n, 1] + j)
                template[k] = sample
                known = known and not np.isnan(sample)
                k += 1
        if not known:
            continue
        template -= template.mean()
        power = np.sqrt((template**2).mean())
        if power < 1e-12:
            continue
        template /= power
        x, y = 0.0, 0.0
        settled = False
        agreement = np.nan
        xx, xy, yy, left = 0.0, 0.0, 0.0, 0.0
        for _ in range(rounds):
            for k in range(size):
                value[k], slope[k, 0], slope[k, 1] = _sampled(
                    target, target_xy[n, k, 0] + x, target_xy[n, k, 1] + y
                )
                known = known and not np.isnan(value[k])
            if not known:
                break
            value -= value.mean()
            contrast = np.sqrt((value**2).mean())
            if contrast < 1e-12:
                break
            agreement = (value * template).mean() / contrast
            for c in range(2):
                slope[:, c] -= slope[:, c].mean()
                # What a change of contrast explains is no shift.
                slope[:, c] -= template * (slope[:, c] * template).mean()
            xx = (slope[:, 0] ** 2).sum()
            yy = (slope[:, 1] ** 2).sum()
            xy = (slope[:, 0] * slope[:, 1]).sum()
            determinant = xx * yy - xy * xy
            # Along an edge nothing holds the patch.
            if determinant <= 1e-3 * (xx + yy) ** 2:
                break
            gain = (value * template).mean()
            left = ((value - gain * template) ** 2).sum() / (size - 4)
            rx = (slope[:, 0] * (gain * template - value)).sum()
            ry = (slope[:, 1] * (gain * template - value)).sum()
            dx = (yy * rx - xy * ry) / determinant
            dy = (xx * ry - xy * rx) / determinant
            x += dx
            y += dy
            if dx * dx + dy * dy < 1e-6:
                settled = True
                break
        if settled:
            shifts[n, 0] = x
            shifts[n, 1] = y
            correlation[n] = agreement
            scale = 1.0 / max(left, 1e-24)
            information[n, 0] = scale * xx
            information[n, 1] = scale * xy
            information[n, 2] = scale * yy
    return shifts, correlation, information
