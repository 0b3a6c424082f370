"""The consolidated samples of all scans: what fusion makes and surfaces are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Samples:
    """Consolidated samples in the project frame.

    Attributes
    ----------
    points : (n, 3) float64, metres.
    normals : (n, 3) float64, unit, outwards.
    radius_m : (n,) float64, how far the surface around a sample counts as measured by it.
    confidence : (n,) float64 > 0, number of observations that agree, each weighted by the
        cosine of its incidence.
    scan : (n,) int32, the scan with the largest say in each sample.
    color : (n, 3) uint8 sRGB, or None where no scan had colour.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    confidence: NDArray[np.float64]
    scan: NDArray[np.int32]
    color: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (3,), (3,) of the box of the points, metres."""
        return self.points.min(axis=0), self.points.max(axis=0)

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.integer]) -> Samples:
        """Some of them, by mask (n,) or by indices, in that order."""
        return Samples(**{name: values[which] for name, values in self.arrays().items()})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored: one array per attribute that is there."""
        names = self.__dataclass_fields__
        return {k: getattr(self, k) for k in names if getattr(self, k) is not None}
