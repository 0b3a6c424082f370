"""Which range an instrument reports when its beam meets several surfaces at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _footprint_echoes(
    ranges: NDArray[np.float64],
    energies: NDArray[np.float64],
    slope_spreads: NDArray[np.float64],
    step_min: float,
    step_max: float,
    reported: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    chosen: NDArray[np.int64],
    mixed: NDArray[np.bool_],
) -> None:
    rays = ranges.shape[1]
    for n in range(len(ranges)):
        order = np.argsort(ranges[n])
        best_first, best_last, best_energy = 0, -1, -1.0
        first = 0
        energy = 0.0
        for place in range(rays):
            current = ranges[n, order[place]]
            if not np.isfinite(current):
                break
            if place > first and current - ranges[n, order[place - 1]] > step_max:
                first, energy = place, 0.0
            energy += energies[n, order[place]]
            if energy > best_energy:
                best_first, best_last, best_energy = first, place, energy
        if best_last < 0:
            continue
        near[n] = ranges[n, order[best_first]]
        far[n] = ranges[n, order[best_last]]
        strongest = order[best_first]
        widest = 0.0
        weighted = 0.0
        for place in range(best_first, best_last + 1):
            ray = order[place]
            weighted += energies[n, ray] * ranges[n, ray]
            if place > best_first:
                widest = max(widest, ranges[n, ray] - ranges[n, order[place - 1]])
            if ray == 0 or (strongest != 0 and energies[n, ray] > energies[n, strongest]):
                strongest = ray
        chosen[n] = strongest
        # A single slanting surface spreads the ranges too, but mixes nothing.
        spread = far[n] - near[n] - slope_spreads[n, strongest]
        if widest > step_min and spread > step_min and best_energy > 0.0:
            mixed[n] = True
            reported[n] = weighted / best_energy
        else:
            reported[n] = ranges[n, strongest]


def footprint_echoes(
    ranges: NDArray[np.float64],
    energies: NDArray[np.float64],
    slope_spreads: NDArray[np.float64],
    step_min: float,
    step_max: float,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int64],
    NDArray[np.bool_],
]:
    """The echo of every beam from the sub-rays that sample its footprint.

    Parameters
    ----------
    ranges : (n, k) float64 range of each sub-ray, infinite where it meets nothing; sub-ray 0
        is the beam's axis.
    energies : (n, k) float64 returned energy of each sub-ray, not negative.
    slope_spreads : (n, k) float64 how far the ranges would spread if the whole footprint lay
        on the plane that the sub-ray meets, metres.
    step_min : a range step above this within one echo, and a spread above what the slope
        explains, make a mixed pixel, metres.
    step_max : a range step above this separates echoes; the strongest one counts, metres.

    Returns
    -------
    reported : (n,) float64 the energy-weighted mean range of a mixed pixel, else the range
        of the chosen sub-ray; NaN without echo.
    near, far : (n,) float64 ends of the echo; NaN without echo.
    chosen : (n,) int64 the axis where it belongs to the echo, else the strongest sub-ray;
        −1 without echo.
    mixed : (n,) bool.
    """
    n = len(ranges)
    reported, near, far = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    chosen = np.full(n, -1, np.int64)
    mixed = np.zeros(n, bool)
    _footprint_echoes(
        ranges, energies, slope_spreads, step_min, step_max, reported, near, far, chosen, mixed
    )
    return reported, near, far, chosen, mixed
