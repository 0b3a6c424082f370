from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.mesh import TriangleMesh
from workbench.verification.truth import compare_to_truth, infill_flagging


def plane(z: float, size: float = 1.0, cells: int = 10) -> TriangleMesh:
    """A square at height z that faces +z."""
    steps = np.linspace(-size / 2, size / 2, cells + 1)
    x, y = np.meshgrid(steps, steps)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    right, above = corner + 1, corner + cells + 1
    triangles = np.concatenate(
        [np.stack([corner, right, above + 1], 1), np.stack([corner, above + 1, above], 1)]
    )
    return TriangleMesh(vertices, triangles.astype(np.int32))


def test_a_shifted_plane_is_off_by_its_shift_exactly():
    # The search for the triangle is in float32: across an edge, 1e-7 aside is 5e-12 more.
    found = compare_to_truth(plane(0.003), plane(0.0), thresholds_m=[0.002, 0.004], samples=5000)
    for summary in (found.accuracy_measured, found.accuracy_all, found.completeness):
        for value in (summary.rms, summary.mean, summary.median, summary.p95, summary.maximum):
            assert value == pytest.approx(0.003, abs=1e-10)
    assert found.accuracy_all.bias == pytest.approx(0.003, abs=1e-10)
    assert found.hausdorff95_m == pytest.approx(0.003, abs=1e-10)
    assert found.hausdorff_m == pytest.approx(0.003, abs=1e-10)
    assert found.within == ((0.002, 0.0), (0.004, 1.0))


def test_a_plane_below_has_negative_bias():
    assert compare_to_truth(plane(-0.01), plane(0), samples=500).accuracy_all.bias == pytest.approx(
        -0.01, abs=1e-10
    )


def test_a_missing_half_lowers_completeness_but_not_accuracy():
    truth = plane(0.0)
    centers = truth.vertices[truth.triangles].mean(axis=1)
    half = truth.keep_triangles(centers[:, 0] < 0)
    found = compare_to_truth(half, truth, thresholds_m=[1e-6, 0.25], samples=20_000)
    assert found.accuracy_all.maximum < 1e-12
    shares = [share for _, share in found.within]
    assert shares == pytest.approx([0.5, 0.75], abs=0.005)
    # The far border lies 0.5 away and distances are uniform there: 95 % is at 0.45.
    assert found.hausdorff95_m == pytest.approx(0.45, abs=0.005)


def test_accuracy_is_told_apart_for_measured_and_infilled_surface():
    truth = plane(0.0)
    off = plane(0.0).vertices + np.where(plane(0).vertices[:, :1] > 0.01, [[0, 0, 0.02]], 0.0)
    provenance = (truth.vertices[:, 0] > 0.01).astype(np.uint8)
    surface = TriangleMesh(off, truth.triangles, {"provenance": provenance})
    found = compare_to_truth(surface, truth, thresholds_m=[0.001], samples=20_000)
    # The step between the halves is half measured: its slope reaches half the height.
    assert found.accuracy_measured.maximum <= 0.5 * 0.02 * 1.35
    assert found.accuracy_measured.median < 1e-12
    assert found.accuracy_all.maximum == pytest.approx(0.02, abs=1e-9)
    infilled = found.deviation_m[~found.deviation_measured]
    assert np.median(infilled) == pytest.approx(0.02)


def test_completeness_by_measured_surface_leaves_infill_out():
    truth = plane(0.0)
    provenance = (truth.vertices[:, 0] > 0.01).astype(np.uint8)
    found = compare_to_truth(
        truth.with_attributes(provenance=provenance), truth, thresholds_m=[1e-6], samples=20_000
    )
    assert found.within[0][1] == 1.0
    assert found.within_measured[0][1] == pytest.approx(0.55, abs=0.01)


def test_a_larger_sphere_is_off_by_the_difference_of_radii(sphere):
    found = compare_to_truth(sphere(1.01), sphere(1.0), samples=20_000)
    # Facets of both spheres lie up to 3e-4 inside; the difference of the radii is 1e-2.
    assert found.accuracy_all.bias == pytest.approx(0.01, abs=3e-4)
    assert found.completeness.median == pytest.approx(0.01, abs=3e-4)


def test_metrics_have_unique_names_and_the_numbers_of_the_result():
    found = compare_to_truth(plane(0.003), plane(0.0), samples=500)
    metrics = {metric.name: metric for metric in found.metrics()}
    assert len(metrics) == len(found.metrics())
    assert metrics["accuracy_measured_rms"].value == pytest.approx(0.003)
    assert metrics["hausdorff95"].unit == "m"
    # The default thresholds of a square of 1 m: 0.02 % of 1.41 m, rounded up, and so on.
    assert {name for name in metrics if name.startswith("completeness_within")} == {
        "completeness_within_500um",
        "completeness_within_1000um",
        "completeness_within_2000um",
        "completeness_within_5000um",
    }


def test_flags_are_weighed_against_what_was_seen():
    truth = plane(0.0, cells=40)
    x = truth.vertices[:, 0]
    hits = truth.vertices[x < 0.2]  # 70 % of the area
    surface = truth.with_attributes(provenance=(x > 0.3).astype(np.uint8))  # flags 20 %
    flags = infill_flagging(surface, truth, hits, 0.02, samples=40_000)
    # Vertices own half a cell (0.0125) beyond them; a rim of 1.5 spacings is left undecided.
    assert flags.infilled_unseen == pytest.approx(0.2, abs=0.015)
    assert flags.measured_unseen == pytest.approx(0.1 + 0.0125 - 0.03, abs=0.01)
    assert flags.infilled_seen == 0
    assert flags.seen_flagged == 0
    cautious = truth.with_attributes(provenance=(x > 0).astype(np.uint8))  # flags half
    shy = infill_flagging(cautious, truth, hits, 0.02, samples=40_000)
    assert shy.seen_flagged == pytest.approx((0.2 - 0.0125) / (0.7 + 0.0141), abs=0.03)
    assert flags.precision == 1
    assert flags.recall == pytest.approx(0.1875 / 0.27, abs=0.05)
    names = {metric.name: metric.value for metric in flags.metrics()}
    assert names["unseen_passing_for_measured"] == pytest.approx(100 * flags.measured_unseen)


def test_a_surface_without_provenance_claims_all_was_measured():
    truth = plane(0.0)
    flags = infill_flagging(truth, truth, np.zeros((0, 3)), 0.02, samples=200)
    assert flags.measured_unseen == 1
    assert flags.recall == 0
