"""What verifies a pair: compatible places, samples that meet, free space."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Case, body_scans, round_ball
from scipy.spatial.transform import Rotation

from workbench.geometry.transforms import (
    apply,
    from_twist,
    inverse,
    rigid,
    rotate,
    rotation_angle_deg,
)
from workbench.registration.consensus import Correspondences, agreed_motions
from workbench.registration.features import describe, keypoint_distance_m, thinned
from workbench.registration.freespace import FreeSpace
from workbench.registration.pairwise import PairRegistration


@pytest.fixture(scope="module")
def body() -> Case:
    return body_scans(5, n=60)


@pytest.fixture(scope="module")
def pairs(body: Case) -> PairRegistration:
    distance = keypoint_distance_m(body.scans, 500)
    keypoints = [describe(scan, distance) for scan in body.scans]
    return PairRegistration(body.scans, body.viewpoints, keypoints, distance)


def relative(body: Case, i: int, j: int) -> np.ndarray:
    return inverse(body.true[j]) @ body.true[i]


def correspondences(right: int, wrong: int, seed: int = 0) -> tuple[Correspondences, np.ndarray]:
    """Places on a rough ball, moved, and others that only look alike."""
    rng = np.random.default_rng(seed)
    motion = rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
    n = right + wrong
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = normals * rng.uniform(0.8, 1.2, (n, 1))
    there, turned = apply(motion, points), rotate(motion, normals)
    shuffled = rng.permutation(np.arange(right, n))
    there[right:], turned[right:] = there[shuffled], turned[shuffled]
    return Correspondences(
        points, there + rng.normal(scale=0.005, size=(n, 3)), normals, turned
    ), motion


def test_the_motion_is_found_among_mostly_wrong_correspondences() -> None:
    found, motion = correspondences(40, 760)
    best, *_ = agreed_motions(found, 0.03, 3)
    assert rotation_angle_deg(inverse(motion) @ best.target_from_source) < 0.5
    assert best.inliers[:40].sum() >= 38
    assert best.inliers[40:].sum() <= 4


def test_no_motion_is_made_up_from_wrong_correspondences() -> None:
    found, _ = correspondences(0, 400)
    assert max((m.inliers.sum() for m in agreed_motions(found, 0.03, 3)), default=0) < 10
    assert agreed_motions(Correspondences(*(np.zeros((0, 3)),) * 4), 0.03, 3) == []


def test_two_motions_that_both_hold_are_both_found() -> None:
    first, motion = correspondences(60, 0, seed=1)
    second, other = correspondences(50, 0, seed=2)
    both = Correspondences(
        *(np.concatenate([getattr(first, k), getattr(second, k)]) for k in vars(first))
    )
    one, two = agreed_motions(both, 0.03, 2)
    assert rotation_angle_deg(inverse(motion) @ one.target_from_source) < 0.5
    assert rotation_angle_deg(inverse(other) @ two.target_from_source) < 0.5


def test_keypoints_are_as_far_apart_as_asked(body: Case) -> None:
    distance = keypoint_distance_m(body.scans, 400)
    points, normals = thinned(body.scans[0], distance)
    apart = np.sort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)[:, 1]
    assert 0.4 * distance < np.median(apart) < 1.1 * distance
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_neighbours_are_found_by_shape_to_a_fraction_of_the_spacing(
    body: Case, pairs: PairRegistration
) -> None:
    found = pairs.links(0, 1, 4)
    left = inverse(relative(body, 0, 1)) @ found[0].target_from_source
    assert rotation_angle_deg(left) < 0.3
    assert found[0].consistency > 0.97
    assert found[0].free_motions == 0
    assert len(found) == 1


def test_a_wrong_motion_is_told_by_what_misses_and_what_hangs_in_the_air(
    body: Case, pairs: PairRegistration
) -> None:
    true = relative(body, 0, 1)
    assert pairs.judged(0, 1, true).consistency > 0.98
    for twist in ([0, 0, 0.15, 0, 0, 0], [0, 0, 0, 0, 0, 0.04], [0, 0.2, 0, 0, 0.02, 0]):
        assert pairs.judged(0, 1, true @ from_twist(twist)).consistency < 0.75


def test_smooth_sides_that_almost_fit_are_told_from_those_that_do() -> None:
    """The far side of the body resembles the near one to a few times the noise."""
    sides = body_scans(2, n=60)
    distance = keypoint_distance_m(sides.scans, 500)
    keypoints = [describe(scan, distance) for scan in sides.scans]
    pairs = PairRegistration(sides.scans, sides.viewpoints, keypoints, distance)
    assert all(link.consistency < 0.8 or link.free_motions for link in pairs.links(0, 1, 4))


def test_what_can_slide_is_said_to() -> None:
    ball = body_scans(5, n=60, radius_of=round_ball)
    distance = keypoint_distance_m(ball.scans, 300)
    pairs = PairRegistration(
        ball.scans, ball.viewpoints, [describe(s, distance) for s in ball.scans], distance
    )
    link = pairs.judged(0, 1, inverse(ball.true[1]) @ ball.true[0])
    assert link.consistency > 0.98
    assert link.free_motions == 3


def test_free_space_is_what_the_scanner_saw_through(body: Case) -> None:
    scan, viewpoint = body.scans[0], body.viewpoints[0]
    air = FreeSpace(scan, viewpoint)
    inner = scan.points[~scan.border][::7]
    sight = viewpoint - inner
    assert air.violated(inner + 0.2 * sight, 0.01).mean() > 0.98
    assert not air.violated(inner - 0.2 * sight, 0.01).any()
    assert not air.violated(inner, 0.01).any()
    beside = viewpoint + 2.0 * (inner - viewpoint) @ from_twist([0, 0, 0, 0, 0, 0])[:3, :3]
    beside[:, 0] += 10.0
    assert not air.violated(beside, 0.01).any()
    assert not FreeSpace(scan.take(np.zeros(0, np.int64)), viewpoint).violated(inner, 0.01).any()
