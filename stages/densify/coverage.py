"""Which photographs show what the scans missed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.densify.options import DensifyOptions
from workbench.geometry.transforms import apply
from workbench.metrics import Metric
from workbench.pipeline.shape_sources import SCANNED, kept_scan, shape_sources
from workbench.pipeline.stage import Job

if TYPE_CHECKING:
    from workbench.stereo.choice import SeenPoints


@dataclass(frozen=True)
class Coverage:
    """How much of the points that photographs share the scans hold.

    Attributes
    ----------
    shares : by photograph, 0 to 1; None where too few points tell.
    left_out : photographs that show nothing, or too little, that was missed.
    """

    shares: Mapping[str, float | None]
    left_out: tuple[str, ...] = ()

    def metrics(self) -> tuple[Metric, ...]:
        """What it comes to."""
        known = [share for share in self.shares.values() if share is not None]
        metrics = [
            Metric("covered_photographs", len(self.left_out), "",
                   f"Photographs left out for the scans hold what they show, "
                   f"of {len(self.shares)}."),
        ]  # fmt: skip
        if known:
            metrics.append(
                Metric("covered", 100.0 * float(np.mean(known)), "%",
                       "Share of the points of a photograph that the scans hold, mean.")
            )  # fmt: skip
        return tuple(metrics)


def measured_coverage(
    job: Job[DensifyOptions], points: SeenPoints, pairs: Mapping[str, Sequence[str]]
) -> Coverage:
    """Hold the photographs' points against the scans.

    A photograph that shows something missed is matched, and so are its neighbours: a depth
    counts where several depth maps agree on it.
    """
    from workbench.stereo.coverage import ScannedPlaces, held_shares

    with job.progress.step("what the scans hold of the photographs"):
        scanned = ScannedPlaces.of(_scans(job))
        # Points that are no more than a guess tell nothing.
        shares = held_shares(points, scanned if points.measured else None)
    wanted = {
        name for name, share in shares.items() if share is None or share < job.options.covered
    }
    matched = wanted | {other for name in wanted for other in pairs[name]}
    return Coverage(shares, tuple(name for name in shares if name not in matched))


def _scans(job: Job[DensifyOptions]) -> Iterator[Any]:
    """Points (n, 3) of every scan in the project frame, without what was masked."""
    for source in shape_sources(job.products):
        if source.maps == SCANNED and source.project_from_map is not None:
            scan = kept_scan(job.products, source.item)
            yield apply(source.project_from_map, scan.points_in_scan)
