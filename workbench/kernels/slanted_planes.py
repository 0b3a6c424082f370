"""Slanted planes of pixels: at random, turned a little, further off (Bleyer et al. 2011)."""

from __future__ import annotations

import math

from numba import njit

from workbench.kernels.borrowing import borrowing
from workbench.kernels.counted_random import uniform
from workbench.kernels.patch_cost import Doubles, Floats, Masks, Pixel, Plane

# Cosine of 85°: a plane seen more obliquely is no hypothesis.
_LEAST_COSINE = 0.087
_STEEPEST_AT_RANDOM = 0.7
_DRAWS_OF_SWEEP, _DRAWS_OF_TRIAL = 16, 4


@borrowing
def faces_camera(plane: Plane, at: Pixel, lens: Doubles) -> bool:
    """Whether a plane is in front of the camera and seen at less than 85°."""
    w, _, _ = plane
    mx, my, mz = _normal(plane, at, lens)
    rx, ry = (at[0] - lens[2]) / lens[0], (at[1] - lens[3]) / lens[1]
    # The plane is m · X = 1, so m · r is one over depth.
    return w > _LEAST_COSINE * math.sqrt((mx * mx + my * my + mz * mz) * (rx * rx + ry * ry + 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def random_planes(
    usable: Masks, lens: Doubles, span: tuple[float, float], seed: int, planes: Floats
) -> None:
    """Fill ``planes`` (h, w, 3) with planes at random within a span of one over depth."""
    height, width = usable.shape
    steep = 2.0 * _STEEPEST_AT_RANDOM
    for y in range(height):
        for x in range(width):
            place = y * width + x
            w = span[0] + (span[1] - span[0]) * uniform(seed, place, 0)
            nx = steep * (uniform(seed, place, 1) - 0.5) + (x - lens[2]) / lens[0]
            ny = steep * (uniform(seed, place, 2) - 0.5) + (y - lens[3]) / lens[1]
            a, b = _slopes(w, nx, ny, 1.0, (x, y), lens)
            planes[y, x, 0], planes[y, x, 1], planes[y, x, 2] = w, a, b


@borrowing
def changed(
    plane: Plane, at: Pixel, lens: Doubles, change: float, tilt: float, number: int,
    draws: tuple[int, int, int],
) -> Plane:  # fmt: skip
    """A plane changed by chance: in depth, in its normal, or in both, by number.

    Parameters
    ----------
    change, tilt : of one over depth, and of the normal by its length, at most.
    draws : seed, place and sweep.
    """
    seed, place, turn = draws
    w, a, b = plane
    draw = (turn + 1) * _DRAWS_OF_SWEEP + _DRAWS_OF_TRIAL * number
    if number % 3 != 1:
        moved = w + change * (2.0 * uniform(seed, place, draw) - 1.0)
        # The same normal further off: slopes go with nearness.
        w, a, b = moved, a * moved / w, b * moved / w
    if number % 3 != 0:
        mx, my, mz = _normal((w, a, b), at, lens)
        length = math.sqrt(mx * mx + my * my + mz * mz)
        nx = mx / length + tilt * (2.0 * uniform(seed, place, draw + 1) - 1.0)
        ny = my / length + tilt * (2.0 * uniform(seed, place, draw + 2) - 1.0)
        nz = mz / length + tilt * (2.0 * uniform(seed, place, draw + 3) - 1.0)
        a, b = _slopes(w, nx, ny, nz, at, lens)
    return w, a, b


@borrowing
def _normal(plane: Plane, at: Pixel, lens: Doubles) -> tuple[float, float, float]:
    """The normal m of the plane m · X = 1."""
    w, a, b = plane
    mx, my = a * lens[0], b * lens[1]
    mz = w - mx * (at[0] - lens[2]) / lens[0] - my * (at[1] - lens[3]) / lens[1]
    return mx, my, mz


@borrowing
def _slopes(
    w: float, nx: float, ny: float, nz: float, at: Pixel, lens: Doubles
) -> tuple[float, float]:
    """Change of one over depth for a pixel right and down, of a plane with a normal there."""
    rx, ry = (at[0] - lens[2]) / lens[0], (at[1] - lens[3]) / lens[1]
    share = w / (nx * rx + ny * ry + nz)
    return nx * share / lens[0], ny * share / lens[1]
