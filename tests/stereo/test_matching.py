"""Depth maps of bodies of known shape."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.stereo.scenes import Body, ball, paint, plane, seen
from workbench.stereo.agreement import AgreementSettings, agreed_range_map, speckles
from workbench.stereo.matching import DepthEstimate, MatchingSettings, agreed, matched
from workbench.stereo.views import StereoView

PLACES = [(0.0, 0.0, 4.0), (0.8, 0.1, 3.9), (-0.8, 0.1, 3.9), (0.1, 0.8, 3.9)]
SETTINGS = MatchingSettings(levels=2)
SPAN = (2.5, 5.5)


@cache
def scene(body: Body) -> tuple[list[StereoView], np.ndarray]:
    views = [seen(body, place) for place in PLACES]
    return [view for view, _ in views], views[0][1]


@cache
def estimates(body: Body) -> list[DepthEstimate]:
    views, _ = scene(body)
    return [
        matched(view, [other for other in views if other is not view], SPAN, SETTINGS, number)
        for number, view in enumerate(views)
    ]


@pytest.mark.parametrize("body", [plane, ball])
def test_depths_are_those_of_the_body(body: Body) -> None:
    views, depth = scene(body)
    found = estimates(body)[0]
    inner = views[0].usable & (found.cost < 0.3)
    assert inner.sum() > 0.8 * views[0].usable.sum()
    error = np.abs(1.0 / found.planes[..., 0] - depth)[inner]
    # A pixel of the other views is 4 / 200 / sin 11.5° = 0.1 of depth.
    assert np.median(error) < 0.01
    assert (error < 0.1).mean() > 0.95


def test_what_views_agree_on_is_on_the_body_and_knows_how_sure_it_is() -> None:
    views, _ = scene(ball)
    one, *others = estimates(ball)
    found = agreed_range_map("a", views[0], views[1:], one, others, AgreementSettings())
    scan = found.range_map
    assert scan.world_from_scan is not None
    assert scan.sigma_m is not None
    points = scan.points_in_scan @ scan.world_from_scan[:3, :3].T + scan.world_from_scan[:3, 3]
    off = np.abs(np.linalg.norm(points, axis=1) - 1.0)
    assert len(scan) > 0.8 * views[0].usable.sum()
    assert np.sqrt((off**2).mean()) < 0.02
    assert np.percentile(off, 99) < 0.06
    # Pictures free of noise: most of the deviation is the floor that real ones need.
    assert 0.1 < np.median(off / scan.sigma_m) < 1.0
    row, column = np.nonzero(scan.grid >= 0)
    pixels, _ = views[0].project(points[scan.grid[row, column]])
    np.testing.assert_allclose(pixels, np.column_stack([column, row]), atol=1e-6)


def test_depth_maps_that_know_of_each_other_agree_more() -> None:
    views, _ = scene(ball)
    settings = AgreementSettings()
    first = estimates(ball)
    others = views[1:]
    better = agreed(
        views[0], others, first[0], [one.nearness for one in first[1:]], SPAN, SETTINGS, 9
    )
    before = agreed_range_map("a", views[0], others, first[0], first[1:], settings)
    after = agreed_range_map("a", views[0], others, better, first[1:], settings)
    assert len(after.range_map) >= len(before.range_map)


def test_what_has_no_texture_has_no_depth() -> None:
    flat = [
        seen(ball, place, grey_of=lambda points: np.full(len(points), 120.0), noise=0.7)[0]
        for place in PLACES
    ]
    found = [
        matched(view, [other for other in flat if other is not view], SPAN, SETTINGS, number)
        for number, view in enumerate(flat)
    ]
    scan = agreed_range_map("a", flat[0], flat[1:], found[0], found[1:], AgreementSettings())
    assert len(scan.range_map) < 0.01 * flat[0].usable.sum()


def test_what_is_masked_has_no_depth_and_is_compared_with_nothing() -> None:
    views, _ = scene(ball)
    half = views[0].usable.copy()
    half[:, :70] = False
    cut = replace(views[0], usable=half)
    found = matched(cut, views[1:], SPAN, SETTINGS, 0)
    assert not np.isfinite(found.sigma[~half]).any()
    blind = [replace(view, usable=np.zeros_like(view.usable)) for view in views[1:]]
    lost = matched(views[0], blind, SPAN, SETTINGS, 0)
    assert (lost.nearness == 0.0).all()


def test_the_same_bytes_whatever_runs_beside() -> None:
    views, _ = scene(plane)
    alone = estimates(plane)[0]
    with ThreadPoolExecutor(4) as pool:
        jobs = [
            pool.submit(matched, views[0], views[1:], SPAN, SETTINGS, seed) for seed in (0, 1, 0, 2)
        ]
        same, other, again, _ = [job.result() for job in jobs]
    for one in (same, again):
        for name in ("planes", "cost", "sigma"):
            assert getattr(one, name).tobytes() == getattr(alone, name).tobytes()
    assert other.planes.tobytes() != alone.planes.tobytes()


def test_estimates_are_stored_as_they_are() -> None:
    views, _ = scene(ball)
    one = estimates(ball)[0]
    again = DepthEstimate.from_arrays(one.arrays(views[0].usable), views[0].usable)
    usable = views[0].usable
    np.testing.assert_array_equal(again.planes[usable], one.planes[usable])
    np.testing.assert_allclose(again.cost, one.cost, atol=1e-3)
    np.testing.assert_array_equal(again.sigma, one.sigma)
    stored = StereoView.from_arrays(views[0].arrays())
    np.testing.assert_allclose(stored.grey, np.clip(views[0].grey, 0, 255.99), atol=1 / 256)


def test_the_texture_of_these_scenes_is_seen_by_pixels() -> None:
    points = np.zeros((400, 3))
    points[:, 0] = np.linspace(0.0, 4.0, 400)
    assert paint(points).std() > 20.0


def test_small_pieces_apart_are_speckles_and_slopes_are_not():
    steps = np.add.outer(np.arange(60.0) * 0.4, np.arange(80.0) * 0.7)
    steps[10:14, 20:25] += 5.0  # 20 pixels in front
    steps[30:40, 30:50] -= 8.0  # 200 pixels behind
    steps[50:, :5] = np.nan
    steps[55, 2] = 7.0
    found = speckles(steps, 30)
    expected = np.zeros(steps.shape, bool)
    expected[10:14, 20:25] = True
    expected[55, 2] = True
    np.testing.assert_array_equal(found, expected)
    assert not speckles(steps, 0).any()
    assert speckles(steps, 250).sum() == 20 + 200 + 1
    assert not speckles(np.full((4, 5), np.nan), 30).any()
    # Depths that 16 bits do not hold in parts.
    assert not speckles(np.array([[0.0, 1.0, 1e5, 1e5 + 1.0]]), 1)[0].any()
