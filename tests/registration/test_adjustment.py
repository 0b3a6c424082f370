from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import RADIUS, SIGMA, Case, body_scans, errors, round_ball, scaled, simulated
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.geometry.transforms import from_twist, inverse, rigid, rotation_angle_deg
from workbench.registration.adjustment import Adjustment, AdjustmentSettings, adjust

SETTINGS = AdjustmentSettings()


def adjusted(case: Case, **settings: float) -> Adjustment:
    return adjust(case.scans, case.coarse, case.names, AdjustmentSettings(**settings))


@pytest.fixture(scope="module")
def body() -> Case:
    return body_scans(5, n=40)


@pytest.fixture(scope="module")
def found(body: Case) -> Adjustment:
    return adjusted(body)


def test_true_relative_poses_come_back_within_the_noise(body: Case, found: Adjustment) -> None:
    assert found, found.reason
    assert found.converged
    assert not found.freedoms
    before = errors(body, tuple(body.coarse), found.anchor)
    after = errors(body, found.poses, found.anchor)
    assert np.linalg.norm(before[:, 3:], axis=1).max() > body.spacing
    assert np.linalg.norm(after[:, 3:], axis=1).max() < 0.1 * body.spacing
    assert np.degrees(np.linalg.norm(after[:, :3], axis=1)).max() < 0.25


def test_residuals_are_those_of_two_noisy_samples(found: Adjustment) -> None:
    # Two samples differ by √2 σ along the normal; matching the closest makes it a little less.
    assert found.sigma_m == pytest.approx(np.sqrt(2) * SIGMA, rel=0.15)
    assert found.sigma_given_m > 2 * found.sigma_m
    assert len(found.residuals_after) == sum(pair.matches for pair in found.pairs)
    spread = [pair.rms_m for pair in found.pairs]
    assert np.median(spread) == pytest.approx(np.sqrt(2) * SIGMA, rel=0.3)


def test_residuals_grow_with_the_noise() -> None:
    loud = body_scans(5, sigma=3 * SIGMA, n=40)
    result = adjusted(loud)
    assert result
    assert 0.75 < result.sigma_m / (np.sqrt(2) * 3 * SIGMA) < 1.25


def test_without_noise_the_poses_are_exact_to_a_few_thousandths_of_a_spacing() -> None:
    case = body_scans(5, sigma=0.0, n=40)
    result = adjusted(case)
    assert result
    assert np.abs(errors(case, result.poses, result.anchor)[:, 3:]).max() < 0.02 * case.spacing


def test_the_anchor_keeps_its_pose_to_the_bit(body: Case, found: Adjustment) -> None:
    assert np.array_equal(found.poses[found.anchor], body.coarse[found.anchor])
    assert not found.covariance[found.anchor].any()
    others = [k for k in range(5) if k != found.anchor]
    assert all(not np.array_equal(found.poses[k], body.coarse[k]) for k in others)


def test_the_same_input_gives_the_same_bits(body: Case, found: Adjustment) -> None:
    again = adjusted(body)
    assert all(np.array_equal(a, b) for a, b in zip(found.poses, again.poses, strict=True))
    assert np.array_equal(found.covariance, again.covariance)
    assert again.rounds == found.rounds


def test_the_order_of_the_scans_does_not_matter(body: Case, found: Adjustment) -> None:
    order = [3, 0, 4, 1, 2]
    mixed = Case(*([x[k] for k in order] for x in (body.scans, body.true, body.coarse)), body.sigma)
    other = adjusted(mixed)
    assert order[other.anchor] == found.anchor
    for place, k in enumerate(order):
        assert np.allclose(other.poses[place], found.poses[k], atol=1e-6)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_does_not_matter(body: Case, found: Adjustment, factor: float) -> None:
    other = adjusted(scaled(body, factor))
    assert other.rounds == found.rounds
    assert other.anchor == found.anchor
    for a, b in zip(other.poses, found.poses, strict=True):
        assert np.allclose(a[:3, :3], b[:3, :3], atol=1e-7)
        assert np.allclose(a[:3, 3] / factor, b[:3, 3], atol=1e-7)
    assert other.sigma_m == pytest.approx(factor * found.sigma_m, rel=1e-6)


def test_the_place_of_the_scene_does_not_matter(body: Case, found: Adjustment) -> None:
    far = rigid(np.eye(3), [1e3, -2e3, 50.0])
    moved = replace(body, coarse=[far @ p for p in body.coarse])
    other = adjusted(moved)
    for a, b in zip(other.poses, found.poses, strict=True):
        assert np.allclose(inverse(far) @ a, b, atol=1e-6)


def test_the_place_of_the_samples_in_their_own_frame_does_not_matter(
    body: Case, found: Adjustment
) -> None:
    shift = rigid(np.eye(3), [500.0, 800.0, -300.0])
    scans = [replace(s, points=s.points + shift[:3, 3]) for s in body.scans]
    other = adjusted(replace(body, scans=scans, coarse=[p @ inverse(shift) for p in body.coarse]))
    for a, b in zip(other.poses, found.poses, strict=True):
        assert np.allclose(a @ shift, b, atol=1e-6)


def test_one_round_is_not_enough_and_says_so(body: Case) -> None:
    rounds: list[int] = []
    result = adjust(
        body.scans, body.coarse, body.names, AdjustmentSettings(max_rounds=1), rounds.append
    )
    assert not result
    assert not result.converged
    assert result.rounds == 1
    assert rounds == [1]
    assert "still move after 1 rounds" in result.reason


def test_a_scan_given_twice_stays_in_place(body: Case) -> None:
    twice = Case([body.scans[0]] * 2, [body.true[0]] * 2, [body.coarse[0]] * 2, SIGMA)
    result = adjusted(twice)
    assert result
    assert np.allclose(result.poses[0], result.poses[1], atol=1e-12)
    assert result.sigma_m < 1e-12
    assert not result.freedoms
    nudged = replace(
        twice, coarse=[body.coarse[0], from_twist([0.01, 0, 0.005, 0.002, 0, 0]) @ body.coarse[0]]
    )
    back = adjusted(nudged)
    assert back
    offset = inverse(back.poses[0]) @ back.poses[1]
    assert np.linalg.norm(offset[:3, 3]) < 1e-6
    assert rotation_angle_deg(offset) < 1e-5


def test_scans_that_share_nothing_are_falsy_and_stay(body: Case) -> None:
    away = rigid(np.eye(3), [10.0, 0, 0])
    scans, names = body.scans[:2], ["a", "b"]
    coarse = [body.coarse[0], away @ body.coarse[1]]
    result = adjust(scans, coarse, names, SETTINGS)
    assert not result
    assert "overlap no other" in result.reason
    assert result.graph.component.tolist() == [0, 1]
    assert not result.pairs
    assert all(np.array_equal(a, b) for a, b in zip(result.poses, coarse, strict=True))


def test_two_groups_are_told_apart_and_each_is_adjusted(body: Case) -> None:
    away = rigid(np.eye(3), [10.0, 0, 0])
    both = Case(
        body.scans * 2,
        body.true + [away @ p for p in body.true],
        body.coarse + [away @ p for p in body.coarse],
        SIGMA,
    )
    result = adjusted(both)
    assert not result
    assert result.graph.component.tolist() == [0] * 5 + [1] * 5
    # The group without the anchor floats: its six common motions are free, no other is.
    assert len(result.freedoms) == 6
    for group in (range(5), range(5, 10)):
        poses = [result.poses[k] for k in group]
        assert np.abs(errors(body, tuple(poses), 0)[:, 3:]).max() < 0.2 * body.spacing
    floating = range(5, 10) if result.anchor < 5 else range(5)
    common = [result.poses[k] @ inverse(both.coarse[k]) for k in floating]
    assert max(rotation_angle_deg(m) for m in common) < 3.0
    sigmas = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2))
    assert sigmas.max() < 0.1 * body.spacing / RADIUS


def test_predicted_errors_are_those_of_many_noise_draws() -> None:
    ratios = []
    for seed in range(16):
        case = body_scans(5, n=40, seed=seed, coarse_m=0.003)
        result = adjusted(case)
        assert result
        told = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2))
        seen = told > 0
        assert seen.sum() == 4 * 6
        ratios.append(errors(case, result.poses, result.anchor)[seen] / told[seen])
    rms = np.sqrt(np.mean(np.square(ratios)))
    assert 0.7 < rms < 1.6
    by_draw = np.sqrt(np.mean(np.square(ratios), axis=1))
    assert 1 / 3 < by_draw.min() <= by_draw.max() < 3


def turned_about_centre(case: Case, result: Adjustment) -> list[np.ndarray]:
    return [result.poses[k] @ inverse(case.coarse[k]) for k in range(len(case.scans))]


def test_a_plane_slides_and_turns_and_keeps_what_it_had() -> None:
    case = simulated("plane", 3, 50)
    result = adjusted(case)
    assert result
    others = [n for k, n in enumerate(case.names) if k != result.anchor]
    expected = {f"{n} can {how}" for n in others for how in
                ("slide along x", "slide along y", "turn about z")}  # fmt: skip
    words = {f.sentence for f in result.freedoms}
    # The anchor's coarse tilt turns the plane a little out of z.
    assert len(result.freedoms) == 6
    assert words == expected
    for k, moved in enumerate(turned_about_centre(case, result)):
        start = case.scans[k].points.mean(axis=0) @ case.coarse[k][:3, :3].T + case.coarse[k][:3, 3]
        slid = moved[:3, :3] @ start + moved[:3, 3] - start
        normal = case.coarse[result.anchor][:3, :3] @ inverse(case.true[result.anchor])[:3, 2]
        assert np.linalg.norm(slid - (slid @ normal) * normal) < 0.1 * case.spacing
        assert abs(Rotation.from_matrix(moved[:3, :3]).as_rotvec() @ normal) < 2e-3
    normals = np.array([result.poses[k][:3, :3] @ case.true[k][2, :3] for k in range(3)])
    assert np.degrees(np.arccos(np.clip(normals @ normals[0], -1, 1))).max() < 0.05


def test_a_sphere_turns_about_its_centre_and_the_centres_meet() -> None:
    case = body_scans(5, n=40, radius_of=round_ball)
    result = adjusted(case)
    assert result
    assert len(result.freedoms) == 12
    assert all("can turn about" in f.sentence for f in result.freedoms)
    assert {f.scans for f in result.freedoms} == {
        (n,) for k, n in enumerate(case.names) if k != result.anchor
    }
    centres = np.array([(result.poses[k] @ inverse(case.true[k]))[:3, 3] for k in range(5)])
    coarse = np.array([(case.coarse[k] @ inverse(case.true[k]))[:3, 3] for k in range(5)])
    assert np.ptp(coarse, axis=0).max() > case.spacing
    assert np.linalg.norm(centres - centres[result.anchor], axis=1).max() < 0.1 * case.spacing


def test_free_motions_do_not_drift_where_the_poses_were_right() -> None:
    case = body_scans(5, n=40, radius_of=round_ball)
    case = replace(case, coarse=case.true)
    result = adjusted(case)
    assert result
    assert len(result.freedoms) == 12
    turned = [rotation_angle_deg(m) for m in turned_about_centre(case, result)]
    assert np.radians(max(turned)) * RADIUS < case.sigma


def test_a_cylinder_slides_along_and_turns_about_its_axis() -> None:
    case = simulated("cylinder", 6, 40)
    result = adjusted(case)
    assert result
    others = [n for k, n in enumerate(case.names) if k != result.anchor]
    assert {f.sentence for f in result.freedoms} == {
        f"{n} can {how}" for n in others for how in ("slide along z", "turn about z")
    }
    assert len(result.freedoms) == 10
    for k in range(6):
        relative = inverse(case.true[result.anchor]) @ case.true[k]
        found = inverse(result.poses[result.anchor]) @ result.poses[k]
        axis = case.true[result.anchor][:3, :3].T @ [0, 0, 1.0]
        left = found @ inverse(relative)
        tilt = np.degrees(np.arccos(np.clip(axis @ left[:3, :3] @ axis, -1, 1)))
        assert tilt < 0.15


def test_both_sides_of_a_thin_sheet_are_never_matched() -> None:
    case = simulated("thin-sheet", 4, 60)
    result = adjusted(case)
    assert not result
    assert result.graph.component.tolist() == [0, 1, 0, 1]
    assert all((p.source - p.target) % 2 == 0 for p in result.pairs)
    for pair in ((0, 2), (1, 3)):
        two = Case(
            *([x[k] for k in pair] for x in (case.scans, case.true, case.coarse)), case.sigma
        )
        poses = tuple(result.poses[k] for k in pair)
        assert np.abs(errors(two, poses, 0)[:, 3:]).max() < 0.15 * case.spacing


def test_a_scan_without_samples_is_told_and_leaves_the_others_alone(body: Case) -> None:
    none = body.scans[2].take(np.zeros(0, np.int64))
    scans = [*body.scans[:2], none, *body.scans[3:]]
    result = adjust(scans, body.coarse, body.names, SETTINGS)
    assert "overlap no other" in result.reason
    assert np.allclose(result.poses[2], body.coarse[2], atol=1e-12)
    assert np.isfinite(result.covariance).all()
    away = result.graph.component != result.graph.component[2]
    assert away.sum() == 4
    moved = errors(body, result.poses, result.anchor)[away, 3:]
    assert np.linalg.norm(moved, axis=1).max() < 0.2 * body.spacing


def test_numbers_that_are_none_are_refused(body: Case) -> None:
    points = body.scans[1].points.copy()
    points[7, 1] = np.nan
    broken = [body.scans[0], replace(body.scans[1], points=points), *body.scans[2:]]
    with pytest.raises(InputError, match="samples of scan_01"):
        adjust(broken, body.coarse, body.names, SETTINGS)
    poses = [p.copy() for p in body.coarse]
    poses[0][0, 3] = np.inf
    with pytest.raises(InputError, match="pose of scan_00"):
        adjust(body.scans, poses, body.names, SETTINGS)
