"""Placing scans by their shape: right, or not at all and with a reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import Case, body_scans, facade, moved_at_random, pair_errors, round_ball

from workbench.formats.scans import find_scans, read_pose_files, read_scans
from workbench.geometry.orientedscan import OrientationSettings, orient
from workbench.geometry.transforms import inverse, rigid
from workbench.registration.adjustment import AdjustmentSettings, adjust
from workbench.registration.placement import Placement, PlacementSettings, place

SETTINGS = PlacementSettings()


def placed(case: Case, names: list[str] | None = None, **known) -> Placement:
    return place(case.scans, case.viewpoints, names or case.names, SETTINGS, **known)


def joined(*cases: Case) -> Case:
    lists = ("scans", "true", "coarse", "viewpoints")
    return replace(cases[0], **{k: [x for c in cases for x in getattr(c, k)] for k in lists})


def empty(case: Case) -> Case:
    """The first scan of a case with no sample left."""
    scan = case.scans[0].take(np.zeros(0, np.int64))
    return Case([scan], case.true[:1], case.true[:1], case.sigma, case.viewpoints[:1])


@pytest.fixture(scope="module")
def body() -> Case:
    return moved_at_random(body_scans(6, n=50), seed=0)


@pytest.fixture(scope="module")
def found(body: Case) -> Placement:
    return placed(body)


def test_scans_of_a_body_come_together_whatever_frames_they_came_in(
    body: Case, found: Placement
) -> None:
    assert found, found.reason
    turned, shifted = pair_errors(body, found.poses)
    assert shifted.max() < body.spacing
    assert turned.max() < 1.0
    assert found.pairs_tried == 15
    assert found.loop_error_m < found.keypoint_m


def test_the_first_scan_by_name_keeps_its_frame(body: Case, found: Placement) -> None:
    assert np.array_equal(found.poses[0], np.eye(4))
    other = placed(body, names=["z", "f", "e", "d", "c", "b"])
    assert np.array_equal(other.poses[5], np.eye(4))


def test_the_same_scans_give_the_same_bits_in_any_order_and_number_of_threads(
    body: Case, found: Placement
) -> None:
    order = [3, 1, 5, 0, 4, 2]
    mixed = Case(
        *([x[k] for k in order] for x in (body.scans, body.true, body.coarse)),
        body.sigma,
        [body.viewpoints[k] for k in order],
    )
    names = [body.names[k] for k in order]
    other = place(mixed.scans, mixed.viewpoints, names, replace(SETTINGS, threads=1))
    for at, k in enumerate(order):
        assert np.array_equal(other.poses[at], found.poses[k])
    ends = {(order[link.source], order[link.target]) for link in other.links}
    assert {frozenset(e) for e in ends} == {frozenset((a.source, a.target)) for a in found.links}


def test_far_coordinates_of_the_samples_cost_nothing(body: Case, found: Placement) -> None:
    far = rigid(np.eye(3), [5e5, 5.2e6, 100.0])
    scans = [replace(s, points=s.points + far[:3, 3]) for s in body.scans]
    views = [None if v is None else v + far[:3, 3] for v in body.viewpoints]
    other = place(scans, views, body.names, SETTINGS)
    for a, b in zip(other.poses, found.poses, strict=True):
        assert np.abs(inverse(far) @ a @ far - b).max() < 1e-3 * body.spacing


def test_a_scan_given_twice_lies_on_itself(body: Case) -> None:
    twice = joined(body, replace(body, **{k: getattr(body, k)[2:3] for k in
                   ("scans", "true", "coarse", "viewpoints")}))  # fmt: skip
    result = placed(twice)
    assert result
    assert np.abs(result.poses[2] - result.poses[6]).max() < 0.02 * body.spacing


def test_a_scan_without_samples_is_named_and_the_others_are_placed(body: Case) -> None:
    result = placed(joined(empty(body), body))
    assert not result
    assert result.reason == "no surface that can be trusted in scan_00"
    assert result.largest_group() == [1, 2, 3, 4, 5, 6]
    assert pair_errors(body, result.poses[1:])[1].max() < body.spacing
    nothing = placed(Case([], [], [], 0.0, []))
    assert not nothing
    assert nothing.reason == "there are no scans"


def test_without_viewpoints_shape_and_loops_still_do(body: Case) -> None:
    blind = place(body.scans, [None] * 6, body.names, SETTINGS)
    assert blind, blind.reason
    assert pair_errors(body, blind.poses)[1].max() < body.spacing


def test_two_bodies_are_two_groups_each_in_place(body: Case) -> None:
    other = moved_at_random(body_scans(5, n=50, radius_of=knob), seed=4)
    result = placed(joined(body, other))
    assert not result
    assert result.component.tolist() == [0] * 6 + [1] * 5
    assert result.reason
    assert pair_errors(body, result.poses[:6])[1].max() < body.spacing
    assert pair_errors(other, result.poses[6:])[1].max() < other.spacing


def knob(direction: np.ndarray) -> np.ndarray:
    """Radius of another body, as uneven as the first and of the same size."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return 0.3 * (1 + 0.25 * np.sin(3 * x + 2 * z) * y + 0.15 * np.cos(6 * y + x) + 0.1 * z)


def test_scans_with_known_poses_keep_them_and_the_others_come_to_them(body: Case) -> None:
    known = [pose if k in (1, 4) else None for k, pose in enumerate(body.true)]
    result = placed(body, known=known)
    assert result, result.reason
    for k in (1, 4):
        assert np.array_equal(result.poses[k], body.true[k])
    for pose, true, scan in zip(result.poses, body.true, body.scans, strict=True):
        middle = np.append(scan.points.mean(axis=0), 1.0)
        assert np.linalg.norm((pose - true) @ middle) < 1.5 * body.spacing
    assert result.pairs_tried == 14


def test_a_ball_is_not_placed_and_says_why() -> None:
    result = placed(moved_at_random(body_scans(5, n=40, radius_of=round_ball), 1))
    assert not result
    assert result.reason


def test_identical_windows_are_told_apart_by_the_little_that_differs() -> None:
    """Every pair fits best one on top of the other; only here and there a sample objects."""
    wall = moved_at_random(facade(4, ornaments=0.05, n=70), seed=1)
    result = placed(wall)
    assert result, result.reason
    turned, shifted = pair_errors(wall, result.poses)
    assert shifted.max() < wall.spacing
    assert turned.max() < 0.5
    assert len(result.rejected) >= 5


def test_windows_that_do_not_differ_at_all_are_not_guessed() -> None:
    result = placed(moved_at_random(facade(3, ornaments=0.0, n=70), seed=1))
    assert not result
    assert "in more than one way" in result.reason


BUNNY_SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 20))]


@pytest.fixture(scope="module")
def bunny(shared_data) -> Case:
    listing = find_scans([shared_data("stanford-bunny")])
    poses = read_pose_files(listing.pose_files)
    maps = [
        reading.range_map
        for path, name in zip(listing.files, listing.names, strict=True)
        for reading in read_scans(path, poses, name)
    ]
    true = [m.world_from_scan for m in maps]
    scans = [orient(m, OrientationSettings()) for m in maps]
    return Case(scans, true, true, 1e-4, [m.viewpoint_in_scan for m in maps])


@pytest.mark.parametrize("seed", BUNNY_SEEDS)
def test_the_bunny_comes_together_from_nothing(bunny: Case, seed: int) -> None:
    """Bounds from the published poses, which are themselves about this good."""
    case = moved_at_random(bunny, seed)
    start = placed(case)
    assert start, start.reason
    refined = adjust(
        case.scans, start.poses, case.names, AdjustmentSettings(search_m=1.5 * start.keypoint_m)
    )
    assert refined, refined.reason
    turned, shifted = pair_errors(case, refined.poses)
    assert np.median(turned) <= 0.2
    assert np.median(shifted) <= 0.4e-3
    assert turned.max() < 0.4
