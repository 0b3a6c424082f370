"""Matrices from charts whose camera is known."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from tests.color.conftest import CAMERA
from workbench.color.calibration import ColorMatrix, calibrated, checked_on, described
from workbench.color.chart import in_chart, patch_middles, reference_xyz_d50
from workbench.color.chart_finding import chart_at
from workbench.color.patches import ChartPatches, UnfitChart, fitness, measured_patches
from workbench.color.spaces import delta_e2000, lab_from_xyz_d50, working_space
from workbench.synthetic.chart import PATCH_ALBEDO

SPACE = working_space("rec709")


def _patches(means: np.ndarray, clipped=()) -> ChartPatches:
    share = np.zeros(24)
    share[list(clipped)] = 0.5
    return ChartPatches(means, np.full(24, 1e-3), share, 100 * patch_middles())


def test_charts_that_tell_no_colours_are_refused_and_the_condition_is_told() -> None:
    sound = _seen()
    assert fitness(_patches(sound)) is None
    weight = 1.0 / np.sqrt(reference_xyz_d50("after_2014")[:, 1:2] + 0.01)
    found = calibrated(_patches(sound), working_space("rec709"), edition="after_2014")
    balanced = weight * sound * found.color.white_balance
    assert found.condition == pytest.approx(np.linalg.cond(balanced))
    gray = np.repeat(sound[:, 1:2], 3, axis=1)
    assert "no colours" in fitness(_patches(gray)).reason
    broken = sound.copy()
    broken[3, 2] = np.nan
    assert "without a number" in fitness(_patches(broken)).reason


def _seen(edition: str = "after_2014") -> np.ndarray:
    return reference_xyz_d50(edition) @ CAMERA.T


def test_the_published_colours_are_those_of_an_independent_list() -> None:
    linear = reference_xyz_d50("after_2014") @ SPACE.rgb_from_xyz_d50.T
    np.testing.assert_allclose(linear, PATCH_ALBEDO, atol=5e-4)


def test_lab_and_differences_are_those_of_the_standard() -> None:
    rng = np.random.default_rng(0)
    xyz = rng.random((50, 3))
    lab = colour.XYZ_to_Lab(
        xyz, colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D50"]
    )
    np.testing.assert_allclose(lab_from_xyz_d50(xyz), lab, atol=1e-6)
    # Sharma et al. 2005, table 1, pairs 1 and 7.
    one = np.array([[50.0, 2.6772, -79.7751], [50.0, 0.0, 0.0]])
    other = np.array([[50.0, 0.0, -82.7485], [50.0, -1.0, 2.0]])
    np.testing.assert_allclose(delta_e2000(one, other), [2.0425, 2.3669], atol=1e-4)


@pytest.mark.parametrize("kind", ["linear", "root_polynomial"])
@pytest.mark.parametrize("space", ["rec709", "prophoto"])
def test_a_linear_camera_is_undone(kind: str, space: str) -> None:
    working = working_space(space)
    found = calibrated(_patches(_seen()), working, kind)
    assert found.mean < 0.02
    assert found.left_out_mean < 0.05
    rgb = found.color.applied(_seen().astype(np.float32))
    expected = reference_xyz_d50("after_2014") @ working.rgb_from_xyz_d50.T
    np.testing.assert_allclose(rgb, expected, atol=2e-3)
    greys = _seen()[18:23] * found.color.white_balance
    assert np.ptp(greys / greys[:, 1:2], axis=1).max() < 0.06


def test_a_slope_of_light_is_no_colour() -> None:
    x, y = in_chart(patch_middles()).T
    light = np.exp(0.12 * x - 0.2 * y)
    found = calibrated(_patches(_seen() * light[:, None]), SPACE)
    assert found.shading == pytest.approx((0.12, -0.2), abs=0.005)
    assert found.mean < 0.05
    even = calibrated(_patches(_seen()), SPACE)
    np.testing.assert_allclose(found.color.matrix, even.color.matrix, atol=5e-3)


@pytest.mark.parametrize("edition", ["after_2014", "before_2014"])
def test_the_charts_age_is_told_from_its_colours(edition: str) -> None:
    assert calibrated(_patches(_seen(edition)), SPACE).edition == edition


def test_roots_help_a_camera_that_is_not_linear_in_colour() -> None:
    """And do not change with exposure, which powers would (Finlayson et al. 2015)."""
    seen = _seen()
    # A channel whose filter leaks: more where colours are pure.
    spread = seen.std(axis=1, keepdims=True)
    odd = seen + 0.15 * spread * np.array([1.0, -0.4, 0.6])
    plain = calibrated(_patches(odd), SPACE, "linear")
    rooted = calibrated(_patches(odd), SPACE, "root_polynomial")
    assert rooted.mean < 0.6 * plain.mean
    once = rooted.color.applied(odd.astype(np.float32))
    thrice = rooted.color.applied(3.0 * odd.astype(np.float32))
    np.testing.assert_allclose(thrice, 3.0 * once, rtol=1e-4, atol=1e-5)


def test_root_terms_are_those_of_colour_science() -> None:
    rng = np.random.default_rng(5)
    camera = rng.random((40, 3))
    matrix = rng.standard_normal((3, 6))
    ours = ColorMatrix(np.ones(3), "root_polynomial", matrix).applied(camera.astype(np.float32))
    theirs = colour.characterisation.apply_matrix_colour_correction_Finlayson2015(
        camera, matrix, 2, True
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_clipped_patches_are_left_out_of_fit_and_mean() -> None:
    seen = _seen()
    seen[15] *= [0.6, 1.0, 1.0]  # yellow, red clipped
    with_it = calibrated(_patches(seen), SPACE)
    without = calibrated(_patches(seen, clipped=[15]), SPACE)
    assert with_it.mean > 0.5
    assert without.mean < 0.03
    assert not without.used[15]
    assert not described(without)[15]["fitted"]


def test_leaving_out_is_harder_than_fitting() -> None:
    rng = np.random.default_rng(1)
    noisy = _seen() * (1 + 0.02 * rng.standard_normal((24, 3)))
    for kind in ("linear", "root_polynomial"):
        found = calibrated(_patches(noisy), SPACE, kind)
        assert 0.3 < found.mean < 2.0
        assert found.left_out_mean > 1.1 * found.mean


def test_another_photograph_checks_colours_and_not_light() -> None:
    found = calibrated(_patches(_seen()), SPACE)
    x, _ = in_chart(patch_middles()).T
    dimmer = 0.6 * _seen() * np.exp(0.1 * x)[:, None]
    assert checked_on(found, _patches(dimmer), SPACE).mean < 0.05
    redder = _seen() * [1.1, 1.0, 0.95]
    assert checked_on(found, _patches(redder), SPACE).mean > 2.0


def test_nothing_a_camera_can_tell_exceeds_the_bound() -> None:
    rng = np.random.default_rng(2)
    camera = np.concatenate([rng.random((5000, 3)), np.eye(3), np.ones((1, 3))])
    for kind in ("linear", "root_polynomial"):
        color = calibrated(_patches(_seen()), SPACE, kind).color
        highest = color.applied(camera.astype(np.float32)).max()
        assert highest <= color.largest * 1.000001
        assert ColorMatrix.from_dict(color.as_dict()).largest == color.largest


def test_patches_are_measured_where_the_chart_lies(draw_chart) -> None:
    drawn = draw_chart(noise=0.004)
    usable = np.full(drawn.values.shape[:2], 255, np.uint8)
    patches = measured_patches(drawn.values, usable, chart_at(drawn.values, drawn.corners))
    assert isinstance(patches, ChartPatches)
    np.testing.assert_allclose(patches.means, _seen(), atol=0.0015)
    assert fitness(patches) is None
    assert 0.0 < patches.uncertain[18] < 0.002
    again = ChartPatches.from_dict(patches.as_dict())
    np.testing.assert_array_equal(again.means, patches.means)


def test_unfit_charts_are_refused_with_the_reason(draw_chart) -> None:
    bright = draw_chart(level=1.6)
    usable = np.where(bright.values.max(axis=2) >= 1.0, 0, 255).astype(np.uint8)
    chart = chart_at(bright.values, bright.corners)
    clipped = fitness(measured_patches(bright.values, usable, chart))
    assert clipped is not None
    assert "clipped" in clipped.reason
    assert "white 9.5" in clipped.reason
    glaring = draw_chart(level=6.0)
    usable = np.where(glaring.values.max(axis=2) >= 1.0, 0, 255).astype(np.uint8)
    chart = chart_at(glaring.values, glaring.corners)
    told = fitness(measured_patches(glaring.values, usable, chart))
    assert told is not None
    assert "clipped" in told.reason
    dark = draw_chart(level=0.01, noise=0.0001)
    open_ = np.full(dark.values.shape[:2], 255, np.uint8)
    told = fitness(measured_patches(dark.values, open_, chart_at(dark.values, dark.corners)))
    assert told is not None
    assert "too dark" in told.reason
    far = draw_chart((200, 300), [[100, 60], [136, 61], [135, 84], [101, 83]], noise=0.0)
    small = measured_patches(
        far.values, np.full((200, 300), 255, np.uint8), chart_at(far.values, far.corners)
    )
    assert isinstance(small, UnfitChart)
    assert "too small" in small.reason
    noisy = fitness(ChartPatches(_seen(), np.full(24, 0.1), np.zeros(24), patch_middles()))
    assert noisy is not None
    assert "noisy" in noisy.reason


@pytest.mark.parametrize(
    ("file", "corners", "bound"),
    [
        ("canon/CRW_0304.CRW", [[143, 139], [2165, 111], [2199, 1490], [158, 1473]], 2.5),
        ("canon/CRW_0101.CRW", [[168, 179], [2077, 128], [2090, 1383], [199, 1438]], 2.9),
    ],
)
def test_real_charts_are_calibrated(shared_data, file: str, corners, bound: float) -> None:
    from workbench.photos.decoding import read_linear

    photo = read_linear(shared_data("raw", *file.split("/")), half_size=True)
    chart = chart_at(photo.values, np.array(corners) / 2)
    patches = measured_patches(photo.values, photo.usable, chart)
    assert fitness(patches) is None
    plain = calibrated(patches, SPACE, "linear")
    rooted = calibrated(patches, SPACE, "root_polynomial")
    assert plain.mean <= bound
    assert rooted.mean < plain.mean
    assert plain.left_out_mean <= bound + 0.3


def test_an_overexposed_real_chart_is_refused(shared_data) -> None:
    from workbench.photos.decoding import read_linear

    photo = read_linear(shared_data("raw", "olympus-c5050", "PB180004.JPG"), half_size=True)
    corners = np.array([[239, 293], [2271, 299], [2277, 1696], [209, 1663]]) / 2
    refusal = fitness(measured_patches(photo.values, photo.usable, chart_at(photo.values, corners)))
    assert refusal is not None
    assert "clipped" in refusal.reason
