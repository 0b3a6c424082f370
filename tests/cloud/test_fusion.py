from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from workbench.cloud.fusion import joined, merged, placed_samples
from workbench.errors import InputError
from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.transforms import apply, from_twist, inverse, rotate

CELL = 0.1


def merge_scans(scans, poses, colors, cell_m):
    """Scans as the stage merges them: placed, joined, merged."""
    placed = [
        placed_samples(scan, pose, color, number)
        for number, (scan, pose, color) in enumerate(zip(scans, poses, colors, strict=True))
    ]
    return merged(joined(placed), cell_m)


def scan_of(points: np.ndarray, normals: np.ndarray, seed: int = 0) -> OrientedScan:
    rng = np.random.default_rng(seed)
    n = len(points)
    return OrientedScan(
        np.asarray(points, float),
        np.asarray(normals, float),
        np.full(n, 0.1),
        rng.uniform(0.1, 0.2, n),
        rng.uniform(0.3, 1.0, n),
        np.full(n, 0.01),
        rng.random(n) < 0.2,
        np.arange(n),
    )


def random_scan(n: int, seed: int) -> OrientedScan:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return scan_of(rng.random((n, 3)), normals, seed)


def weights(scan: OrientedScan) -> np.ndarray:
    return np.where(scan.border, 0.5, 1.0) * scan.incidence_cos


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_exact_duplicates_become_one(offset: float) -> None:
    scan = random_scan(300, 1)
    scan = OrientedScan(**{**vars(scan), "points": scan.points + offset})
    eye = np.eye(4)
    once = merge_scans([scan], [eye], [None], 1e-6)
    twice = merge_scans([scan, scan], [eye, eye], [None, None], 1e-6)
    assert len(once) == len(twice) == 300
    assert np.allclose(twice.points, once.points, atol=1e-15 * max(1, offset) * 4)
    assert np.allclose(twice.confidence, 2 * once.confidence)
    assert np.allclose(twice.normals, once.normals)


def test_cell_zero_keeps_every_sample_where_the_poses_put_it() -> None:
    scans = [random_scan(50, 1), random_scan(70, 2)]
    poses = [from_twist([0.1, 0.5, -0.2, 1, 2, 3]), np.eye(4)]
    found = merge_scans(scans, poses, [None, None], 0.0)
    assert np.array_equal(found.points[:50], apply(poses[0], scans[0].points))
    assert np.array_equal(found.normals[:50], rotate(poses[0], scans[0].normals))
    assert np.array_equal(found.points[50:], scans[1].points)
    assert np.array_equal(found.scan, np.repeat([0, 1], [50, 70]))
    assert np.array_equal(found.confidence[50:], weights(scans[1]))
    assert found.color is None


def test_both_sides_of_a_thin_wall_stay() -> None:
    v, u = np.meshgrid(np.arange(20) * 0.05, np.arange(20) * 0.05)
    front = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    up = np.tile([0, 0, 1.0], (400, 1))
    wall = [scan_of(front, up), scan_of(front - [0, 0, 0.01], -up)]
    found = merge_scans(wall, [np.eye(4)] * 2, [None] * 2, CELL)
    above = found.normals[:, 2] > 0
    assert np.allclose(found.points[above, 2], 0.0, atol=1e-15)
    assert np.allclose(found.points[~above, 2], -0.01)
    assert above.sum() == (~above).sum() < 400
    assert np.array_equal(found.scan, np.where(above, 0, 1))


def brute_force(scan: OrientedScan, low: np.ndarray) -> dict[tuple[int, ...], list[int]]:
    groups: dict[tuple[int, ...], list[int]] = {}
    for k in range(len(scan)):
        normal = scan.normals[k]
        axis = int(np.argmax(np.abs(normal)))
        cell = np.floor((scan.points[k] - low) / CELL).astype(int)
        groups.setdefault((axis, int(normal[axis] < 0), *cell), []).append(k)
    return groups


def test_merged_samples_are_the_weighted_means_of_their_cells() -> None:
    scan = random_scan(2000, 3)
    rng = np.random.default_rng(3)
    color = rng.integers(0, 256, (2000, 3)).astype(np.uint8)
    found = merge_scans([scan], [np.eye(4)], [color], CELL)
    weight = weights(scan)
    groups = brute_force(scan, -CELL * np.array([0.382, 0.618, 0.236]))
    assert len(found) == len(groups) < 2000
    assert found.confidence.sum() == pytest.approx(weight.sum(), rel=1e-12)
    expected = {
        tuple(np.round(np.average(scan.points[k], axis=0, weights=weight[k]), 9)): k
        for k in groups.values()
    }
    for n, point in enumerate(np.round(found.points, 9)):
        members = expected[tuple(point)]
        heaviest = members[int(np.argmax(weight[members]))]
        assert found.confidence[n] == pytest.approx(weight[members].sum())
        assert found.radius_m[n] == scan.reach_m[members].max()
        assert np.array_equal(found.color[n], color[heaviest])
        mean = np.average(scan.normals[members], axis=0, weights=weight[members])
        assert np.allclose(found.normals[n], mean / np.linalg.norm(mean), atol=1e-9)
    assert found.color.dtype == np.uint8


def test_the_order_of_the_scans_does_not_matter() -> None:
    scans = [random_scan(400, k) for k in range(4)]
    poses = [from_twist([0.1 * k, 0, 0.2, 0.01 * k, 0, 0]) for k in range(4)]
    colors = [np.full((400, 3), 10 * k, np.uint8) for k in range(4)]
    order = [2, 0, 3, 1]
    one = merge_scans(scans, poses, colors, CELL)
    other = merge_scans(*([x[k] for k in order] for x in (scans, poses, colors)), CELL)
    assert np.allclose(one.points, other.points, atol=1e-12)
    assert np.allclose(one.normals, other.normals, atol=1e-12)
    assert np.allclose(one.confidence, other.confidence)
    assert np.array_equal(one.color, other.color)
    assert np.array_equal(one.scan, np.array(order)[other.scan])


def test_overlapping_scans_average_their_noise() -> None:
    rng = np.random.default_rng(8)
    v, u = np.meshgrid(np.arange(30) * 0.1 + 0.05, np.arange(30) * 0.1 + 0.05)
    flat = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    scans, poses = [], []
    for k in range(8):
        noisy = flat + rng.normal(scale=[0, 0, 0.004], size=flat.shape)
        pose = from_twist([0.3, 0.1 * k, 0, 0.1, 0, 1.0])
        up = rotate(inverse(pose), np.tile([0, 0, 1.0], (900, 1)))
        scan = scan_of(apply(inverse(pose), noisy), up)
        scans.append(OrientedScan(**{**vars(scan), "incidence_cos": np.ones(900),
                                     "border": np.zeros(900, bool)}))  # fmt: skip
        poses.append(pose)
    found = merge_scans(scans, poses, [None] * 8, CELL)
    many = found.confidence > 5
    assert many.mean() > 0.3
    assert np.std(found.points[many, 2]) == pytest.approx(0.004 / np.sqrt(8), rel=0.2)


def test_colours_are_dropped_unless_every_scan_with_samples_has_them() -> None:
    scan, nothing = random_scan(10, 1), random_scan(0, 1)
    color = np.zeros((10, 3), np.uint8)
    eye = np.eye(4)
    assert merge_scans([scan, scan], [eye, eye], [color, None], CELL).color is None
    assert merge_scans([scan, nothing], [eye, eye], [color, None], CELL).color is not None


def test_nothing_merges_to_nothing() -> None:
    found = merge_scans([random_scan(0, 1)], [np.eye(4)], [None], CELL)
    assert len(found) == 0
    assert found.points.shape == (0, 3)
    assert "color" not in found.arrays()


@pytest.mark.parametrize(
    ("name", "value"),
    [("confidence", 0.0), ("confidence", np.nan), ("points", np.inf), ("normals", np.nan)],
)
def test_samples_of_which_there_is_no_mean_are_refused(name, value) -> None:
    samples = placed_samples(random_scan(50, 1), np.eye(4), None, 0)
    values = getattr(samples, name).copy()
    values[7] = value
    with pytest.raises(InputError, match="sample 7"):
        merged(replace(samples, **{name: values}), CELL)


def test_cells_too_many_to_be_numbered_are_refused() -> None:
    samples = placed_samples(random_scan(50, 1), np.eye(4), None, 0)
    with pytest.raises(InputError, match="larger cells"):
        merged(samples, 1e-300)
