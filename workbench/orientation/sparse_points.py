"""The points of a sparse model that can be believed, and from where they were seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import ColmapModel
from workbench.geometry.transforms import inverse

_LEAST_VIEWS = 3
_LEAST_ANGLE_DEG = 3.0
_WORST_OF_MEDIAN_ERROR = 3.0


@dataclass(frozen=True)
class SparsePoints:
    """Points of a sparse model.

    Attributes
    ----------
    ids : (n,) int64 of the model, ascending.
    points : (n, 3) float64 in the model's frame.
    outward : (n, 3) unit, the mean direction to the cameras that saw each: its surface faces
        that way.
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    outward: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.ids)

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.integer]) -> SparsePoints:
        """Some of them, by mask or by index."""
        return SparsePoints(self.ids[which], self.points[which], self.outward[which])


def well_seen(model: ColmapModel) -> SparsePoints:
    """Points seen by three photographs or more, from directions that differ, without gross error.

    Three degrees between two of the views at least; a reprojection error of at most three
    times the median.
    """
    centers = {n: inverse(image.camera_from_world)[:3, 3] for n, image in model.images.items()}
    numbers = sorted(model.points)
    worst = _WORST_OF_MEDIAN_ERROR * _median([model.points[n].error for n in numbers])
    ids, points, outward = [], [], []
    least = np.cos(np.radians(_LEAST_ANGLE_DEG))
    for number in numbers:
        point = model.points[number]
        seen_by = sorted(set(point.track[:, 0].tolist()))
        if len(seen_by) < _LEAST_VIEWS or point.error > worst:
            continue
        towards = np.array([centers[n] for n in seen_by]) - point.xyz
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        if (towards @ towards.T).min() > least:
            continue
        mean = towards.sum(axis=0)
        ids.append(number)
        points.append(point.xyz)
        outward.append(mean / max(float(np.linalg.norm(mean)), 1e-12))
    return SparsePoints(
        np.array(ids, np.int64),
        np.array(points, float).reshape(-1, 3),
        np.array(outward, float).reshape(-1, 3),
    )


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else 0.0
