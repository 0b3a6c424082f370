"""Points of a surface in memory, with whatever else is known of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_KINDS = {"points": (np.float64, (3,)), "normals": (np.float32, (3,)),
          "color": (np.uint8, (3,)), "radius": (np.float32, ())}  # fmt: skip


@dataclass(frozen=True)
class PointSet:
    """Points and their attributes; what nothing is known of is None.

    Attributes
    ----------
    points : (n, 3) float64, in the units and coordinates of where they come from.
    normals : (n, 3) float32, unit.
    color : (n, 3) uint8, sRGB.
    radius : (n,) float32, how far the surface around a point counts as told by it.

    Raises
    ------
    ValueError : an array has another shape or type.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float32] | None = None
    color: NDArray[np.uint8] | None = None
    radius: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        for name, values in self.arrays().items():
            dtype, row = _KINDS[name]
            if values.dtype != dtype or values.shape != (n, *row):
                raise ValueError(
                    f"{name} of points must be {(n, *row)} {np.dtype(dtype).name}, "
                    f"not {values.shape} {values.dtype.name}"
                )

    def __len__(self) -> int:
        return len(self.points)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (3,), (3,) of the box of the points; there must be some."""
        return self.points.min(axis=0), self.points.max(axis=0)

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.integer] | slice) -> PointSet:
        """Some of them, by mask (n,), by indices or by a slice, in that order."""
        return PointSet(**{name: values[which] for name, values in self.arrays().items()})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """One array per attribute that is there."""
        return {name: getattr(self, name) for name in _KINDS if getattr(self, name) is not None}


def joined(parts: Sequence[PointSet]) -> PointSet:
    """All points one after another, with the attributes that every part has.

    Raises
    ------
    ValueError : there are no parts.
    """
    common = set.intersection(*(set(part.arrays()) for part in parts)) if parts else set()
    if not common:
        raise ValueError("there are no points to join")
    return PointSet(
        **{
            name: np.concatenate([part.arrays()[name] for part in parts])
            for name in _KINDS
            if name in common
        }
    )
