"""How far a small patch of one image lies from where it was expected in another."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

# Of a mean of squares: differences of such means are no smaller, they are rounding.
_ROUNDING = 1e-14


@numba.njit(cache=True, nogil=True)
def _cubic(u: float) -> tuple[float, float, float, float]:
    """Catmull and Rom's weights of four neighbours at u in [0, 1)."""
    return (
        0.5 * u * (u * (2.0 - u) - 1.0),
        0.5 * (u * u * (3.0 * u - 5.0) + 2.0),
        0.5 * u * (u * (4.0 - 3.0 * u) + 1.0),
        0.5 * u * u * (u - 1.0),
    )


@numba.njit(cache=True, nogil=True)
def _cubic_slope(u: float) -> tuple[float, float, float, float]:
    """The weights' derivatives."""
    return (
        0.5 * (u * (4.0 - 3.0 * u) - 1.0),
        0.5 * u * (9.0 * u - 10.0),
        0.5 * (u * (8.0 - 9.0 * u) + 1.0),
        0.5 * u * (3.0 * u - 2.0),
    )


@numba.njit(cache=True, nogil=True)
def _along(
    image: NDArray[np.float32], row: int, column: int, w: tuple[float, float, float, float]
) -> float:
    """Four neighbours of a row, weighted; in pairs, which do not wait for each other."""
    first = w[0] * image[row, column - 1] + w[1] * image[row, column]
    return float(first + (w[2] * image[row, column + 1] + w[3] * image[row, column + 2]))


@numba.njit(cache=True, nogil=True)
def _sampled(image: NDArray[np.float32], x: float, y: float) -> tuple[float, float, float]:
    """Cubic value and slopes at (x, y), pixels' middles at whole numbers; NaN outside.

    Linear interpolation blurs between pixels and not on them, which shifts patches by some
    hundredths of a pixel.
    """
    column, row = int(np.floor(x)), int(np.floor(y))
    if column < 1 or row < 1 or column + 2 >= image.shape[1] or row + 2 >= image.shape[0]:
        return np.nan, np.nan, np.nan
    a, across = _cubic(x - column), _cubic_slope(x - column)
    b, down = _cubic(y - row), _cubic_slope(y - row)
    above, here = _along(image, row - 1, column, a), _along(image, row, column, a)
    below, last = _along(image, row + 1, column, a), _along(image, row + 2, column, a)
    value = (b[0] * above + b[1] * here) + (b[2] * below + b[3] * last)
    slope_y = (down[0] * above + down[1] * here) + (down[2] * below + down[3] * last)
    above, here = _along(image, row - 1, column, across), _along(image, row, column, across)
    below, last = _along(image, row + 1, column, across), _along(image, row + 2, column, across)
    slope_x = (b[0] * above + b[1] * here) + (b[2] * below + b[3] * last)
    return value, slope_x, slope_y


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
    for n in range(count):
        k, total = 0, 0.0
        for j in range(-half, half + 1):
            for i in range(-half, half + 1):
                sample, _, _ = _sampled(reference, reference_xy[n, 0] + i, reference_xy[n, 1] + j)
                template[k] = sample
                total += sample
                k += 1
        if np.isnan(total):
            continue
        power = 0.0
        for k in range(size):
            template[k] -= total / size
            power += template[k] ** 2
        power = np.sqrt(power / size)
        if power < 1e-12:
            continue
        for k in range(size):
            template[k] /= power
        x, y = 0.0, 0.0
        for _ in range(rounds):
            # Means of the target's value v and slopes p and q, and of their products with each
            # other and with the template t: one pass tells all that a step takes.
            v, p, q, vv, pp, qq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            pq, pv, qv, vt, pt, qt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(size):
                value, across, down = _sampled(
                    target, target_xy[n, k, 0] + x, target_xy[n, k, 1] + y
                )
                t = template[k]
                v += value
                p += across
                q += down
                vv += value * value
                pp += across * across
                qq += down * down
                pq += across * down
                pv += across * value
                qv += down * value
                vt += value * t
                pt += across * t
                qt += down * t
            if np.isnan(v):
                break
            v, p, q, vt, pt, qt = v / size, p / size, q / size, vt / size, pt / size, qt / size
            variance = vv / size - v * v
            if variance <= max(_ROUNDING * vv / size, 1e-24):
                break
            # Slopes less their mean and less what a change of contrast explains, which is no shift.
            xx = pp - size * (p * p + pt * pt)
            xy = pq - size * (p * q + pt * qt)
            yy = qq - size * (q * q + qt * qt)
            determinant = xx * yy - xy * xy
            # Along an edge nothing holds the patch.
            if determinant <= 1e-3 * (xx + yy) ** 2:
                break
            rx = size * (p * v + pt * vt) - pv
            ry = size * (q * v + qt * vt) - qv
            dx = (yy * rx - xy * ry) / determinant
            dy = (xx * ry - xy * rx) / determinant
            x += dx
            y += dy
            if dx * dx + dy * dy < 1e-6:
                # Of equal patches rounding alone is left, which may be below zero.
                left = size * max(variance - vt * vt, _ROUNDING * variance) / (size - 4)
                scale = 1.0 / max(left, 1e-24)
                shifts[n, 0], shifts[n, 1] = x, y
                correlation[n] = vt / np.sqrt(variance)
                information[n, 0] = scale * xx
                information[n, 1] = scale * xy
                information[n, 2] = scale * yy
                break
    return shifts, correlation, information
