"""Loops tell right links from wrong ones, whatever those look like alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.geometry.transforms import Matrix4, apply, from_twist, inverse, rigid
from workbench.registration.cycles import Groups, grouped, link_weights
from workbench.registration.motion_averaging import averaged, loop_error_m
from workbench.registration.pairwise import Link

TOLERANCE = 0.05
MARKS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def true_poses(n: int, seed: int = 0) -> list[Matrix4]:
    rng = np.random.default_rng(seed)
    return [
        rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)) for _ in range(n)
    ]


def link(source: int, target: int, motion: Matrix4, agreeing: int = 500, against: int = 0) -> Link:
    return Link(source, target, motion, 0.3, agreeing, against, 1e-4, 0, MARKS)


def true_link(true: list[Matrix4], i: int, j: int, agreeing: int = 500) -> Link:
    return link(i, j, inverse(true[j]) @ true[i], agreeing)


def merged(links: list[Link], n: int, bears=lambda a, b: True, together=None) -> Groups:
    names = [f"scan_{k}" for k in range(n)]
    weights = link_weights(links, n)
    return grouped(links, weights, [MARKS] * n, names, TOLERANCE, bears, together)


def worst_error(poses, true, members) -> float:
    first = members[0]
    return max(
        float(np.abs(inverse(poses[first]) @ poses[k] - inverse(true[first]) @ true[k]).max())
        for k in members
    )


def test_a_false_link_stronger_than_all_true_ones_is_outvoted_round_loops() -> None:
    n, true = 8, true_poses(8)
    links = [true_link(true, *sorted((k, (k + step) % n))) for k in range(n) for step in (1, 2)]
    false = link(0, 4, from_twist([0, 0, 1, 0.5, 0, 0]), agreeing=900)
    found = merged([false, *links], n)
    assert not found.component.any()
    assert worst_error(found.poses, true, range(n)) < 1e-9
    assert found.rejected == (false,)
    assert len(found.kept) == len(links)
    assert not found.unconfirmed


def test_a_false_link_between_groups_loses_against_true_ones_that_agree() -> None:
    """No triangle spans the two groups: only the vote between groups can tell."""
    true = true_poses(6)
    within = [(0, 1), (1, 2), (0, 2), (3, 4), (4, 5), (3, 5)]
    links = [true_link(true, i, j) for i, j in within]
    bridges = [true_link(true, 0, 3, 300), true_link(true, 2, 5, 300)]
    false = link(1, 4, from_twist([1, 0, 0, 0, 0.7, 0]), agreeing=450)
    found = merged([*links, false, *bridges], 6)
    assert worst_error(found.poses, true, range(6)) < 1e-9
    assert found.rejected == (false,)


def test_repeated_parts_are_told_apart_by_what_the_loops_agree_on() -> None:
    """Every neighbour fits shifted by one bay too, and better than where it belongs."""
    true = [rigid(np.eye(3), [1.0 * k, 0, 0]) for k in range(6)]
    bay = rigid(np.eye(3), [1.0, 0, 0])
    links = []
    for i in range(5):
        right = inverse(true[i + 1]) @ true[i]
        links += [link(i, i + 1, right, 500), link(i, i + 1, bay @ right, 520)]
    links += [true_link(true, i, i + 2, 300) for i in range(4)]
    found = merged(links, 6)
    assert worst_error(found.poses, true, range(6)) < 1e-9
    assert len(found.rejected) == 5


def test_what_no_loop_can_tell_is_a_doubt_and_not_a_guess() -> None:
    true = true_poses(2)
    right = inverse(true[1]) @ true[0]
    links = [link(0, 1, right, 500), link(0, 1, from_twist([0, 0, 2, 0, 0, 0]) @ right, 450)]
    found = merged(links, 2)
    assert found.component.tolist() == [0, 1]
    assert found.doubts == ("scan_0 fits scan_1 in more than one way",)
    assert not found.kept


def test_a_link_without_a_loop_is_used_and_named() -> None:
    true = true_poses(4)
    links = [true_link(true, 0, 1), true_link(true, 1, 2), true_link(true, 0, 2)]
    bridge = true_link(true, 2, 3)
    found = merged([*links, bridge], 4)
    assert not found.component.any()
    assert found.unconfirmed == (bridge,)


def test_a_merge_the_scans_do_not_bear_is_not_made() -> None:
    true = true_poses(3)
    links = [true_link(true, 0, 1), true_link(true, 1, 2)]
    found = merged(links, 3, bears=lambda a, b: not ({*a, *b} >= {1, 2}))
    assert found.component.tolist() == [0, 0, 1]


def test_disjoint_groups_stay_apart() -> None:
    true = true_poses(5)
    links = [true_link(true, 0, 3), true_link(true, 1, 2), true_link(true, 2, 4)]
    assert merged(links, 5).component.tolist() == [0, 1, 1, 0, 1]


def test_known_poses_are_kept_and_the_others_come_to_them() -> None:
    true = true_poses(4)
    together = {1: true[1], 3: true[3]}
    links = [true_link(true, 0, 1), true_link(true, 0, 2), true_link(true, 2, 3)]
    found = merged(links, 4, together=together)
    assert not found.component.any()
    assert worst_error(found.poses, true, range(4)) < 1e-9


@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_left_of_a_loop_is_spread_over_its_links(seed: int) -> None:
    """A ring whose links are all a little wrong: the last one is no worse than the others."""
    n, true, rng = 10, true_poses(10), np.random.default_rng(seed)
    links = []
    for k in range(n):
        i, j = sorted((k, (k + 1) % n))
        noise = from_twist(rng.normal(scale=0.003, size=6))
        links.append(link(i, j, noise @ inverse(true[j]) @ true[i]))
    chained = list(true)
    for k in range(n - 1):
        step = links[k].target_from_source
        chained[k + 1] = chained[k] @ inverse(step)
    before = [loop_error_m(chained, one) for one in links]
    poses = averaged(chained, links, [1.0] * n, TOLERANCE).poses
    after = [loop_error_m(poses, one) for one in links]
    assert max(before) > 0.01
    assert max(after) < 0.5 * max(before)
    # Least squares spreads the miss evenly: the sum of squares falls to about 1 / n.
    assert np.sum(np.square(after)) < 2.5 / n * np.sum(np.square(before))


def test_averaging_leaves_exact_poses_and_lone_scans_alone() -> None:
    true = true_poses(4)
    links = [true_link(true, 0, 1), true_link(true, 1, 2), true_link(true, 0, 2)]
    poses = averaged(true, links, [1.0, 5.0, 2.0], TOLERANCE).poses
    assert np.allclose(np.stack(poses), np.stack(true), atol=1e-12)
    assert np.allclose(poses[3], true[3], atol=1e-15)
    assert np.allclose(apply(poses[0], MARKS), apply(true[0], MARKS))


def test_averaging_tells_how_unevenly_the_links_hold_the_scans() -> None:
    true = true_poses(4)
    links = [true_link(true, 0, 1), true_link(true, 1, 2), true_link(true, 2, 3)]
    even = averaged(true, links, [1.0] * 3, TOLERANCE)
    assert even.converged
    assert 1.0 < even.condition < 1e4
    # One end of the chain hangs on links that say a million times less of it.
    far = [replace(one, places=one.places + np.array([1e3, 0.0, 0.0])) for one in links]
    levered = averaged(true, [links[0], *far[1:]], [1.0] * 3, TOLERANCE)
    assert levered.condition > 100 * even.condition
    # Weak links are links: what they hold is brought back as well.
    moved = [from_twist([0, 0, 0, 0, 0, 0.02 * k]) @ pose for k, pose in enumerate(true)]
    weak = averaged(moved, links, [1.0, 1e-11, 1.0], TOLERANCE)
    assert max(loop_error_m(weak.poses, one) for one in links) < 1e-9
    assert averaged(true, [], [], TOLERANCE).condition == 1.0


def test_few_samples_against_a_link_tell_a_repetition_from_the_right_place() -> None:
    """The wrong link has half as many samples again; one in thirty of them contradicts it."""
    true = true_poses(2)
    right = inverse(true[1]) @ true[0]
    wrong = from_twist([0, 0, 0, 1, 0, 0]) @ right
    found = merged([link(0, 1, wrong, 750, 25), link(0, 1, right, 500, 0)], 2)
    assert worst_error(found.poses, true, range(2)) < 1e-9
    # Where all links are contradicted about as often, it tells nothing.
    found = merged([link(0, 1, wrong, 750, 25), link(0, 1, right, 500, 16)], 2)
    assert found.component.tolist() == [0, 1]
