"""Recovered colours held against a painted truth."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.surface.provenance import INPAINTED, PHOTOGRAPHED, UNCOLORED
from workbench.verification.color_truth import (
    color_difference,
    compared_albedo,
    lab_d65,
    matched_difference,
    true_albedo_of,
)

D65 = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]


def sheet(cells: int, side: float = 1.0) -> TriangleMesh:
    """A square of ``cells`` × ``cells`` quads in z = 0, lower left corner at the origin."""
    at = np.linspace(0.0, side, cells + 1)
    x, y = np.meshgrid(at, at)
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(vertices, triangles.astype(np.int32))


def ramp(points: np.ndarray) -> np.ndarray:
    x, y, _ = points.T
    return np.stack([0.2 + 0.5 * x, 0.6 - 0.4 * y, 0.3 + 0.1 * (x + y)], axis=1)


def gray_difference(one: float, other: float) -> float:
    """CIEDE2000 of two greys by hand: lightness alone, over S_L."""
    low, high = (116.0 * np.cbrt(level) - 16.0 for level in (one, other))
    off = (0.5 * (low + high) - 50.0) ** 2
    return abs(high - low) / (1.0 + 0.015 * off / np.sqrt(20.0 + off))


@pytest.mark.parametrize(
    ("space", "name"), [("rec709", "ITU-R BT.709"), ("prophoto", "ProPhoto RGB")]
)
def test_lab_is_that_of_the_books(rng, space, name):
    rgb = rng.uniform(0.01, 1.0, (50, 3))
    xyz = colour.RGB_to_XYZ(rgb, name, illuminant=D65, chromatic_adaptation_transform="Bradford")
    assert lab_d65(rgb, space) == pytest.approx(colour.XYZ_to_Lab(xyz, D65), abs=0.1)
    assert lab_d65(np.ones((1, 3)), space)[0] == pytest.approx([100.0, 0.0, 0.0], abs=1e-9)


def test_greys_differ_by_lightness_alone():
    levels = np.array([0.05, 0.2, 0.5, 0.9])
    colors = np.repeat(levels[:, None], 3, axis=1)
    which = np.array([True, True, False, True])
    found = color_difference(colors, "rec709", 0.8 * colors, which)
    expected = [gray_difference(level, 0.8 * level) for level in levels]
    assert found.delta_e[which] == pytest.approx(np.array(expected)[which], abs=1e-3)
    assert np.isnan(found.delta_e[2])
    assert found.count == 3
    assert found.mean == pytest.approx(np.mean(np.array(expected)[which]), abs=1e-3)
    nothing = color_difference(colors, "rec709", colors, np.zeros(4, bool))
    assert nothing.count == 0
    assert np.isnan(nothing.mean)
    assert np.isnan(nothing.percentile(95.0))


def test_a_level_is_matched_and_nothing_else(rng):
    truth = rng.uniform(0.05, 0.7, (3000, 3))
    which = rng.random(3000) < 0.8
    for level in (0.01, 0.7, 5.0):
        found = matched_difference(level * truth, "rec709", truth, which)
        assert found.factor == pytest.approx(1.0 / level, rel=1e-3)
        assert found.mean < 0.02
    # A hue no factor takes away, and outliers that are not to pull the level.
    tinted = truth * [1.1, 1.0, 0.9]
    assert matched_difference(tinted, "rec709", truth, which).mean > 2.0
    dark = np.where(rng.random((3000, 1)) < 0.1, 0.3, 1.0) * truth
    found = matched_difference(dark, "rec709", truth, which)
    assert found.factor == pytest.approx(1.0, abs=0.05)
    unmatched = color_difference(dark, "rec709", truth, which)
    assert found.mean <= unmatched.mean + 1e-3


def test_a_vertex_stands_for_what_is_around_it():
    """Paint finer than the vertices: each has the mean, not what happens to lie under it."""
    surface, truth = sheet(6), sheet(120)
    checker = ((truth.vertices[:, :2] * 120).round().astype(int).sum(axis=1) % 2) * 0.4 + 0.2
    albedo = np.repeat(checker[:, None], 3, axis=1).astype(np.float32)
    found = true_albedo_of(surface, truth, albedo)
    assert np.abs(found - 0.4).max() < 0.02
    # Inside, hats are symmetric, and the mean of a ramp is its value in the middle.
    inside = (np.abs(surface.vertices[:, :2] - 0.5) < 0.4).all(axis=1)
    slope = true_albedo_of(surface, truth, ramp(truth.vertices))
    assert slope[inside] == pytest.approx(ramp(surface.vertices)[inside], abs=2e-3)


def test_a_truth_coarser_than_the_surface_is_read_where_it_is_nearest():
    surface, truth = sheet(40), sheet(3)
    lifted = TriangleMesh(surface.vertices + np.array([0.0, 0.0, 2e-3]), surface.triangles)
    found = true_albedo_of(lifted, truth, ramp(truth.vertices))
    assert np.abs(found - ramp(surface.vertices)).max() < 0.02
    assert np.median(np.abs(found - ramp(surface.vertices))) < 1e-6


def test_what_was_masked_away_says_nothing():
    surface, truth = sheet(5), sheet(50)
    beside = truth.vertices + np.array([0.0, 0.0, 1e-3])
    both = TriangleMesh(np.concatenate([truth.vertices, beside]), truth.triangles)
    albedo = np.concatenate([np.full((len(beside), 3), 0.3), np.full((len(beside), 3), 0.9)])
    assert true_albedo_of(surface, both, albedo) == pytest.approx(0.3)
    with pytest.raises(InputError, match="does not belong"):
        true_albedo_of(surface, both, albedo[1:])


def test_all_blends_are_held_against_the_same_vertices(rng):
    n = 4000
    truth = rng.uniform(0.1, 0.6, (n, 3))
    provenance = np.full(n, PHOTOGRAPHED, np.uint8)
    provenance[:500], provenance[500:600] = INPAINTED, UNCOLORED
    colors = 1.02 * truth
    colors[provenance == INPAINTED] = 0.3
    colors[provenance == UNCOLORED] = np.nan
    light = rng.uniform(0.3, 1.0, (n, 1))
    taken, distance = 0.4 * light * truth, 3.0 * np.sqrt(light) * truth
    taken[600:700], distance[650:800] = np.nan, np.nan
    found = compared_albedo(colors, provenance, "rec709", truth, taken, distance)
    ways = (found.corrected, found.corrected_matched, found.uncorrected, found.distance_only)
    same = np.flatnonzero(np.isfinite(found.corrected.delta_e))
    assert same.tolist() == list(range(800, n))
    for way in ways:
        assert way is not None
        assert np.array_equal(np.isfinite(way.delta_e), np.isfinite(found.corrected.delta_e))
    assert found.corrected.factor == 1.0
    assert found.corrected_matched.factor == pytest.approx(1.0 / 1.02, rel=1e-3)
    assert found.corrected_matched.mean < 0.02 < found.corrected.mean < 1.0
    assert found.inpainted.count == 500
    told = {metric.name: metric for metric in found.metrics()}
    assert told["albedo_delta_e_mean"].value == found.corrected.mean
    assert told["albedo_delta_e_inpainted_mean"].value == found.inpainted.mean
    assert (
        told["albedo_delta_e_mean"].value
        < told["albedo_delta_e_distance_only_mean"].value
        < told["albedo_delta_e_uncorrected_mean"].value
    )
    assert {metric.unit for metric in told.values()} == {"ΔE2000"}


def test_without_a_flash_there_is_nothing_to_compare_with(rng):
    truth = rng.uniform(0.1, 0.6, (20, 3))
    found = compared_albedo(truth, np.zeros(20, np.uint8), "rec709", truth)
    assert found.uncorrected is None
    names = {metric.name for metric in found.metrics()}
    assert names == {
        "albedo_delta_e_mean",
        "albedo_delta_e_median",
        "albedo_delta_e_paint_mean",
    }


def test_photographs_answer_for_what_they_can_resolve(rng):
    """Paint finer than pixels is no fault of the colours, but is told."""
    n = 2000
    even = rng.uniform(0.2, 0.5, (n, 3))
    paint = even * rng.uniform(0.8, 1.2, (n, 3))
    even[:100] = np.nan
    colors = np.where(np.isfinite(even), even, 0.3)
    found = compared_albedo(
        colors, np.zeros(n, np.uint8), "rec709", paint, 2.0 * colors, None, even
    )
    assert found.corrected.count == found.of_paint.count == n - 100
    assert found.corrected.mean < 1e-6
    assert found.of_paint.mean > 3.0
    assert found.uncorrected is not None
    assert found.uncorrected.factor == pytest.approx(0.5, rel=1e-3)
    assert found.truth is paint
