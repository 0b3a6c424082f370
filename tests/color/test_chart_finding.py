"""Charts whose place is known are found there, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.color.chart import patch_middles
from workbench.color.chart_finding import FoundChart, chart_at, found_chart

PITCH = 48.0


def _off(found: FoundChart, corners: np.ndarray) -> float:
    """Largest distance of the corners from where they are, in cells."""
    assert isinstance(found, FoundChart)
    return float(np.linalg.norm(found.corners - corners, axis=1).max() / PITCH)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_chart_is_found_however_it_is_held(draw_chart, turns: int) -> None:
    size = (480, 640)
    quad = [[180, 150], [470, 170], [455, 360], [190, 350]]
    if turns % 2:
        quad = [[200, 60], [400, 70], [395, 365], [210, 350]]
    drawn = draw_chart(size, quad, turns)
    found = found_chart(drawn.values)
    assert found
    assert found.by == "detector"
    assert _off(found, drawn.corners) < 0.08


def test_a_chart_before_a_white_wall_and_one_far_away(draw_chart) -> None:
    wall = draw_chart(background=0.7)
    assert _off(found_chart(wall.values), wall.corners) < 0.08
    far = draw_chart((900, 1300), [[600, 400], [760, 405], [755, 515], [602, 508]])
    found = found_chart(far.values)
    assert np.linalg.norm(found.corners - far.corners, axis=1).max() < 0.12 * 27


@pytest.mark.parametrize("meant", ["board", "cells", "patches"])
@pytest.mark.parametrize("first", [0, 1, 2, 3])
@pytest.mark.parametrize("backwards", [False, True])
def test_corners_may_mean_board_or_patches_and_begin_anywhere(
    draw_chart, meant: str, first: int, backwards: bool
) -> None:
    drawn = draw_chart()
    quad = drawn.board if meant == "board" else drawn.corners
    if meant == "patches":
        middle = quad.mean(axis=0)
        quad = middle + (quad - middle) * [5.88 / 6, 3.88 / 4]
    given = np.roll(quad, first, axis=0)
    given = given[::-1] if backwards else given
    wobble = np.array([[3, -2], [-2, 3], [2, 2], [-3, -2]])
    found = chart_at(drawn.values, given + wobble)
    assert found.by == "corners"
    assert _off(found, drawn.corners) < 0.08


def test_no_chart_is_no_chart() -> None:
    rng = np.random.default_rng(0)
    noise = rng.random((300, 400, 3)).astype(np.float32)
    checker = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((50, 50)))
    board = np.repeat(checker[..., None], 3, axis=2).astype(np.float32)
    for picture in (noise, board, np.zeros((300, 400, 3), np.float32)):
        found = found_chart(picture)
        assert not found
        assert found.reason
        given = chart_at(picture, [[50, 50], [350, 50], [350, 250], [50, 250]])
        assert not given
        assert "no colours of a chart" in given.reason


def test_a_chart_that_is_cut_off_is_said_to_be(draw_chart) -> None:
    drawn = draw_chart()
    cut = drawn.values[:, :400]
    found = chart_at(cut, drawn.corners)
    assert not found
    assert "not wholly" in found.reason


def test_size_and_scale(draw_chart) -> None:
    drawn = draw_chart()
    found = chart_at(drawn.values, drawn.corners)
    twice = found.scaled(2.0)
    np.testing.assert_allclose(
        twice.pixels(patch_middles()), 2.0 * found.pixels(patch_middles()), rtol=1e-6
    )
    x, y = drawn.corners.T
    area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
    assert found.width_px == pytest.approx(np.sqrt(area), rel=0.02)


def test_how_much_of_the_lit_is_the_chart(draw_chart) -> None:
    alone, wall = draw_chart(), draw_chart(background=0.7)
    assert chart_at(alone.values, alone.corners).share_of(alone.values) > 0.99
    assert chart_at(wall.values, wall.corners).share_of(wall.values) < 0.3


@pytest.mark.parametrize(
    ("file", "corners"),
    [
        ("canon/CRW_0101.CRW", [[168, 179], [2077, 128], [2090, 1383], [199, 1438]]),
        ("canon/CRW_0304.CRW", [[143, 139], [2165, 111], [2199, 1490], [158, 1473]]),
        ("olympus-c5050/PB180004.JPG", [[239, 293], [2271, 299], [2277, 1696], [209, 1663]]),
        ("kodak-dc120/P003910.KDC", [[31, 114], [869, 110], [884, 708], [22, 683]]),
    ],
)
def test_real_charts_by_detector_and_by_corners_agree(shared_data, file: str, corners) -> None:
    from workbench.photos.decoding import read_linear

    values = read_linear(shared_data("raw", *file.split("/")), half_size=True).values
    given = chart_at(values, np.array(corners) / 2)
    assert isinstance(given, FoundChart)
    automatic = found_chart(values)
    if automatic:  # versions of OpenCV's detector differ in what they find
        apart = np.linalg.norm(automatic.corners - given.corners, axis=1)
        assert apart.max() < 0.05 * given.width_px / np.sqrt(24)
