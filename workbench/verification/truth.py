"""How close a surface is to known truth, and whether it says honestly what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.neighbours import nearest
from workbench.geometry.surface_sampling import sample_surface
from workbench.metrics import Metric
from workbench.render.palette import MEASURED
from workbench.verification.distances import (
    DistanceSummary,
    distance_to_surface,
    nearest_corners,
    signed_distances_m,
)
from workbench.verification.quantities import round_up_125, shown_length

# Shares of the truth's bounding-box diagonal at which completeness is told by default.
_DEFAULT_THRESHOLDS = (2e-4, 5e-4, 1e-3, 2e-3)

# In sample distances: the half diagonal of the grid, and beyond the rim of what it covers.
_SEEN_WITHIN = 0.5**0.5
_UNSEEN_BEYOND = 1.5


@dataclass(frozen=True)
class TruthComparison:
    """A surface against known truth; distances in metres, shares in [0, 1].

    Attributes
    ----------
    accuracy_measured : surface → truth, over what the surface says was measured.
    accuracy_all : surface → truth, over the whole surface.
    completeness : truth → surface.
    within : (threshold in metres, share of the truth's area that close to the surface).
    within_measured : the same where the closest surface point was measured.
    hausdorff95_m : the larger 95th percentile of both directions.
    hausdorff_m : the larger maximum of both directions, over the samples.
    deviation_m : (k,) float64 signed surface → truth distances of the surface samples,
        positive outside the truth.
    deviation_measured : (k,) bool, whether that sample lies on measured surface.
    """

    accuracy_measured: DistanceSummary
    accuracy_all: DistanceSummary
    completeness: DistanceSummary
    within: tuple[tuple[float, float], ...]
    within_measured: tuple[tuple[float, float], ...]
    hausdorff95_m: float
    hausdorff_m: float
    deviation_m: NDArray[np.float64]
    deviation_measured: NDArray[np.bool_]

    def metrics(self) -> list[Metric]:
        """The comparison as metrics."""
        found = []
        for key, words, summary in (
            ("accuracy_measured", "of the measured surface from the truth", self.accuracy_measured),
            ("all", "of the whole surface, infilled parts included, from the truth",
             self.accuracy_all),
            ("completeness", "of the truth from the surface", self.completeness),
        ):  # fmt: skip
            found += _distance_metrics(key, words, summary)
        for name, kind, pairs in (
            ("completeness_within", "surface", self.within),
            ("completeness_measured_within", "measured surface", self.within_measured),
        ):
            found += [
                Metric(
                    f"{name}_{threshold * 1e6:.0f}um",
                    100 * share,
                    "%",
                    f"Share of the true area that has {kind} within {shown_length(threshold)}.",
                )
                for threshold, share in pairs
            ]
        found.append(
            Metric(
                "hausdorff95",
                self.hausdorff95_m,
                "m",
                "95 % of either surface is this close to the other.",
            )
        )
        return found


@dataclass(frozen=True)
class InfillFlagging:
    """Whether the measured/infilled flag agrees with what the scans saw; shares of area.

    Attributes
    ----------
    measured_seen, infilled_unseen : flagged rightly.
    measured_unseen : passes for measured and was not: the error that must not happen.
    infilled_seen : flagged as infilled though a scan saw it: caution, not falsehood.
    seen_flagged : of the true surface that was seen, the share flagged as infilled. Counted
        on the truth, where surface that was made up does not enter.
    """

    measured_seen: float
    measured_unseen: float
    infilled_unseen: float
    infilled_seen: float
    seen_flagged: float

    @property
    def recall(self) -> float:
        """Share of the unseen area that is flagged as infilled; 1 when all was seen."""
        unseen = self.infilled_unseen + self.measured_unseen
        return self.infilled_unseen / unseen if unseen else 1.0

    @property
    def precision(self) -> float:
        """Share of the flagged area that truly was not seen; 1 when nothing is flagged."""
        flagged = self.infilled_unseen + self.infilled_seen
        return self.infilled_unseen / flagged if flagged else 1.0

    def metrics(self) -> list[Metric]:
        """The agreement as metrics."""
        return [
            Metric(
                "unseen_passing_for_measured",
                100 * self.measured_unseen,
                "%",
                "Share of the surface that says measured where no scan saw the object.",
            ),
            Metric(
                "seen_flagged_infilled",
                100 * self.seen_flagged,
                "%",
                "Share of the true surface some scan saw whose place is flagged as infilled.",
            ),
            Metric(
                "infill_flag_recall",
                100 * self.recall,
                "%",
                "Share of the unseen surface that is flagged as infilled.",
            ),
            Metric(
                "infill_flag_precision",
                100 * self.precision,
                "%",
                "Share of the flagged surface that no scan saw.",
            ),
        ]


def compare_to_truth(
    surface: TriangleMesh,
    truth: TriangleMesh,
    *,
    thresholds_m: Sequence[float] | None = None,
    samples: int = 200_000,
    seed: int = 0,
) -> TruthComparison:
    """Distances in both directions between a surface and the truth, in one frame.

    Both are sampled evenly by area: vertices would count finely meshed parts more than
    coarse ones. A sample is measured when the nearest corner of its triangle is; without
    a ``provenance`` attribute everything is.

    Parameters
    ----------
    surface, truth
        metres, same frame; the truth closed and oriented for the signs.
    thresholds_m
        distances at which completeness is told; by default about 0.02, 0.05, 0.1
        and 0.2 % of the diagonal of the truth's bounding box, rounded up to 1, 2 or 5 times
        a power of ten.
    samples
        per surface.
    seed
        of the samples.
    """
    if thresholds_m is None:
        extent = truth.vertices.max(axis=0) - truth.vertices.min(axis=0)
        diagonal = float(np.linalg.norm(extent))
        thresholds_m = [round_up_125(share * diagonal) for share in _DEFAULT_THRESHOLDS]
    points, triangle, barycentric = sample_surface(surface, samples, seed)
    measured = measured_vertices(surface)
    sample_measured = measured[nearest_corners(surface, triangle, barycentric)]
    deviation = signed_distances_m(distance_to_surface(points, truth), truth)

    true_points, _, _ = sample_surface(truth, samples, seed + 1)
    back = distance_to_surface(true_points, surface)
    back_measured = measured[back.nearest_vertex(surface)]

    accuracy = DistanceSummary.of(deviation, signed=True)
    completeness = DistanceSummary.of(back.distance_m)
    close = [back.distance_m <= threshold for threshold in thresholds_m]
    return TruthComparison(
        accuracy_measured=DistanceSummary.of(deviation[sample_measured], signed=True),
        accuracy_all=accuracy,
        completeness=completeness,
        within=tuple(
            (float(t), float(near.mean())) for t, near in zip(thresholds_m, close, strict=True)
        ),
        within_measured=tuple(
            (float(t), float((near & back_measured).mean()))
            for t, near in zip(thresholds_m, close, strict=True)
        ),
        hausdorff95_m=max(accuracy.p95, completeness.p95),
        hausdorff_m=max(accuracy.maximum, completeness.maximum),
        deviation_m=deviation,
        deviation_measured=sample_measured,
    )


def infill_flagging(
    surface: TriangleMesh,
    truth: TriangleMesh,
    hits: NDArray[np.float64],
    spacing_m: float,
    *,
    samples: int = 200_000,
    seed: int = 0,
) -> InfillFlagging:
    """Compare the surface's ``provenance`` with what the scans really saw of the truth.

    A place was seen when a true hit lies within half the diagonal of the sample grid of the
    point of the truth closest to it: between four neighbouring samples no place is further.
    It was not seen when no hit lies within one and a half sample distances. What lies between
    is the rim, where either flag is right.

    Parameters
    ----------
    surface
        with a ``provenance`` attribute; without one it claims to be all measured.
    truth
        in the frame of the surface.
    hits
        (k, 3) float64, where beams of the scanner met the truth, free of noise, same frame.
    spacing_m
        distance between neighbouring samples on the surface.
    samples, seed
        of the surface samples.
    """
    points, triangle, barycentric = sample_surface(surface, samples, seed)
    measured = measured_vertices(surface)[nearest_corners(surface, triangle, barycentric)]
    places = points + distance_to_surface(points, truth).offset
    was_seen = _near_hits(places, hits, _SEEN_WITHIN * spacing_m)
    was_unseen = ~_near_hits(places, hits, _UNSEEN_BEYOND * spacing_m)
    true_points, _, _ = sample_surface(truth, samples, seed + 1)
    true_points = true_points[_near_hits(true_points, hits, _SEEN_WITHIN * spacing_m)]
    flagged = 0.0
    if len(true_points):
        back = distance_to_surface(true_points, surface)
        flagged = float((~measured_vertices(surface))[back.nearest_vertex(surface)].mean())
    return InfillFlagging(
        measured_seen=float((measured & was_seen).mean()),
        measured_unseen=float((measured & was_unseen).mean()),
        infilled_unseen=float((~measured & was_unseen).mean()),
        infilled_seen=float((~measured & was_seen).mean()),
        seen_flagged=flagged,
    )


def _near_hits(
    points: NDArray[np.float64], hits: NDArray[np.float64], reach_m: float
) -> NDArray[np.bool_]:
    if not len(hits):
        return np.zeros(len(points), bool)
    distance, _ = nearest(cKDTree(hits), points, reach_m)
    return np.isfinite(distance)


def measured_vertices(mesh: TriangleMesh) -> NDArray[np.bool_]:
    """(n,) bool from the ``provenance`` attribute; all true where there is none."""
    provenance = mesh.vertex_attributes.get("provenance")
    if provenance is None:
        return np.ones(len(mesh.vertices), bool)
    return np.asarray(provenance == MEASURED, bool)


def _distance_metrics(key: str, words: str, summary: DistanceSummary) -> list[Metric]:
    kinds = [
        ("rms", summary.rms, "Root mean square distance"),
        ("mean", summary.mean, "Mean distance"),
        ("median", summary.median, "Median distance"),
        ("p95", summary.p95, "95th percentile of the distance"),
    ]
    if np.isfinite(summary.bias):
        kinds.append(("bias", summary.bias, "Mean signed distance (positive: outside)"))
    return [Metric(f"{key}_{kind}", value, "m", f"{what} {words}.") for kind, value, what in kinds]
