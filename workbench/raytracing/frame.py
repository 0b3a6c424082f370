"""The cube of side 2 about zero that rays and surfaces are brought into, for float32."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError


@dataclass(frozen=True)
class LocalFrame:
    """Where a surface's local coordinates begin and how long their unit is.

    Attributes
    ----------
    middle : (3,) float64 of the surface's bounds, in its own frame.
    unit : a power of two in the surface's unit of length, so that dividing by it is exact; local
        coordinates lie between −1 and 1.
    """

    middle: NDArray[np.float64]
    unit: float

    @classmethod
    def of_bounds(cls, low: NDArray[np.float64], high: NDArray[np.float64]) -> LocalFrame:
        """The frame of a surface between two corners (3,).

        Raises
        ------
        InputError
            The corners are not finite or too far from one another for float64.
        """
        half = float(np.max(0.5 * high - 0.5 * low))
        if not math.isfinite(half):
            raise InputError(
                "the surface has vertices that are not finite",
                found=f"bounds {low} to {high}",
                fix="check the file it came from",
            )
        return cls(low + 0.5 * (high - low), 2.0 ** math.ceil(math.log2(half)) if half else 1.0)

    def local(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, 3) local coordinates of points of the surface's frame."""
        return np.asarray((points - self.middle) / self.unit, np.float32)
