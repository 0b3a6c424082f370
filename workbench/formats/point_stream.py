"""Points that need not be in memory at once: read some at a time, as often as needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.point_set import PointSet

BATCH_POINTS = 1 << 18

Batches = Callable[[], Iterator[PointSet]]


@dataclass(frozen=True)
class PointStream:
    """Points in batches, and what a pass over them told.

    Attributes
    ----------
    batches : starts the points over; the same ones in the same order every time.
    count : how many points there are, at least one.
    low, high : (3,) float64, corners of their box.
    attributes : what every point has besides its place: ``normals``, ``color``, ``radius``.
    """

    batches: Batches
    count: int
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    attributes: frozenset[str]

    def moved(self, by: NDArray[np.float64]) -> PointStream:
        """The same points with ``by`` (3,) added to each."""

        def batches() -> Iterator[PointSet]:
            for batch in self.batches():
                yield replace(batch, points=batch.points + by)

        return PointStream(batches, self.count, self.low + by, self.high + by, self.attributes)


def slices_of(points: PointSet) -> Batches:
    """Points in memory as batches of at most ``BATCH_POINTS``."""

    def batches() -> Iterator[PointSet]:
        for start in range(0, len(points), BATCH_POINTS):
            yield points.chosen(slice(start, start + BATCH_POINTS))

    return batches


def surveyed(batches: Batches, source: Path | str = "the points") -> PointStream:
    """What one pass over all points tells of them.

    An attribute that only some batches have is left out of ``attributes``.

    Raises
    ------
    InputError
        There are no points, or some have coordinates that are not finite (their number is
        told); ``source`` is named.
    """
    count, lost = 0, 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    attributes: frozenset[str] | None = None
    for batch in batches():
        if not len(batch):
            continue
        finite = np.isfinite(batch.points).all(axis=1)
        lost += len(batch) - int(finite.sum())
        count += len(batch)
        low = np.fmin(low, batch.points.min(axis=0))
        high = np.fmax(high, batch.points.max(axis=0))
        known = frozenset(batch.arrays()) - {"points"}
        attributes = known if attributes is None else attributes & known
    if attributes is None:
        raise InputError(
            "There are no points.", file=source, fix="Check what the cloud was made of."
        )
    if lost:
        raise InputError(
            "Some points have coordinates that are not finite.",
            file=source,
            found=f"{lost} of {count} points",
            fix="Remove these points, or export the cloud again.",
        )
    return PointStream(batches, count, low, high, attributes)
