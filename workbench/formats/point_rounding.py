"""Coordinates as whole multiples of a step, as LAS, COPC and Potree keep them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError

LARGEST_WHOLE = 2**31 - 2
"""Of 32-bit integers; one is left over for rounding."""

_COARSEST_DEFAULT = 1e-4
_STEPS_OF_EXTENT = 1e5


@dataclass(frozen=True)
class Rounding:
    """How coordinates become integers: ``coordinate = origin + step · integer``.

    Attributes
    ----------
    step : in the unit of the points; coordinates are off by half of it at most.
    origin : (3,) float64.
    """

    step: float
    origin: NDArray[np.float64]

    def whole(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Integers (n, 3) of points (n, 3) inside the box the rounding was made for."""
        return np.rint((points - self.origin) / self.step).astype(np.int32)

    def coordinates(self, whole: NDArray[np.int32]) -> NDArray[np.float64]:
        """Points (n, 3) float64 of integers (n, 3)."""
        return whole * self.step + self.origin


def rounding_of(
    low: NDArray[np.float64], high: NDArray[np.float64], precision: float | None = None
) -> Rounding:
    """A rounding for points in the box from ``low`` to ``high``, both (3,).

    Parameters
    ----------
    low, high
        Corners of the box.
    precision
        The step. By default a power of ten: 10⁻⁴, less where the box is smaller than
        ten units, more where 32 bits or the coordinates themselves (float64) cannot
        tell such steps apart.

    Raises
    ------
    SettingsError
        The precision is not positive, or too fine for the box and 32-bit integers.
    """
    extent = float((high - low).max())
    if not np.isfinite(extent):
        raise SettingsError(
            "The box of the points is too large for a file of whole numbers.",
            found=f"a side of {extent}",
            fix="Remove the points that lie far off.",
        )
    if precision is None:
        step = _default_step(extent, float(max(np.abs(low).max(), np.abs(high).max())))
    elif not (precision > 0 and np.isfinite(precision)):
        raise SettingsError(
            "The precision of coordinates is out of its bounds.",
            expected="a positive number",
            found=str(precision),
        )
    elif extent > LARGEST_WHOLE * precision:
        raise SettingsError(
            "The precision is too fine for a cloud of this size and whole numbers of 32 bits.",
            expected=f"at least {extent / LARGEST_WHOLE:.3g} for a side of {extent:.6g}",
            found=str(precision),
            fix="Choose a coarser precision.",
        )
    else:
        step = float(precision)
    origin = np.floor(low)
    if (high - origin > LARGEST_WHOLE * step).any():
        origin = low.copy()
    return Rounding(step, origin)


def _default_step(extent: float, farthest: float) -> float:
    wanted = _COARSEST_DEFAULT
    if extent > 0:
        wanted = min(wanted, extent / _STEPS_OF_EXTENT)
    least = max(extent / LARGEST_WHOLE, 4 * float(np.spacing(farthest)), 1e-300)
    exponent = max(math.floor(math.log10(wanted) + 1e-9), math.ceil(math.log10(least) - 1e-9))
    # From text, so that 1e-5 is the nearest float to it and files tell the short number.
    return float(f"1e{exponent}")
