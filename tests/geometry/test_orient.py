from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.orientedscan import (
    OrientationSettings,
    _consistent_with_neighbours,
    orient,
)
from workbench.geometry.rangemap import RangeMap

SETTINGS = OrientationSettings()
NEAR, FAR = 1.0, 1.3


def perspective(depth: np.ndarray, fov_deg: float = 40.0) -> RangeMap:
    """A range map over a square grid of rays from the origin, looking along z."""
    n = len(depth)
    tangent = np.tan(np.radians(fov_deg) / 2) * (2 * (np.arange(n) + 0.5) / n - 1)
    u, v = np.meshgrid(tangent, tangent)
    points = np.stack([u, v, np.ones_like(u)], axis=-1) * depth[..., None]
    seen = np.isfinite(depth)
    grid = np.where(seen, np.cumsum(seen).reshape(n, n) - 1, -1).astype(np.int32)
    return RangeMap("scan", points[seen], grid, np.zeros(3))


def test_mixed_pixels_between_two_planes_go_and_both_planes_stay() -> None:
    n, edge = 60, 30
    depth = np.full((n, n), FAR)
    depth[:, :edge] = NEAR
    rng = np.random.default_rng(0)
    depth[:, edge] = rng.uniform(NEAR + 0.05, FAR - 0.05, n)
    scan = perspective(depth)
    found = orient(scan, SETTINGS)
    z = found.points[:, 2]
    on_plane = np.isclose(z, NEAR) | np.isclose(z, FAR)
    assert on_plane.all()
    kept = np.zeros(len(scan), bool)
    kept[found.source] = True
    kept = kept.reshape(n, n)
    assert kept[2:-2, 2 : edge - 2].all()
    assert kept[2:-2, edge + 3 : -2].all()
    assert np.abs(found.normals[:, 2] + 1).max() < 1e-9


def test_without_erosion_only_the_lone_returns_go() -> None:
    depth = np.full((40, 40), NEAR)
    depth[20, 20] = 0.5
    found = orient(perspective(depth), OrientationSettings(border_erosion=0))
    assert len(found) == 40 * 40 - 1
    assert 20 * 40 + 20 not in found.source


def test_holes_make_borders_and_do_not_erode() -> None:
    depth = np.full((40, 40), NEAR)
    depth[20, 20] = np.nan
    scan = perspective(depth)
    found = orient(scan, SETTINGS)
    assert len(found) == len(scan)
    cell = {int(i): c for c, i in np.ndenumerate(scan.grid) if i >= 0}
    for sample, border in zip(found.source.tolist(), found.border.tolist(), strict=True):
        r, c = cell[sample]
        beside_hole = max(abs(r - 20), abs(c - 20)) == 1
        assert border == (beside_hole or r in (0, 39) or c in (0, 39))


@pytest.mark.parametrize("tilt_deg", [30, 60, 70, 78, 82, 85])
def test_grazing_samples_are_dropped_and_the_cosine_is_right(tilt_deg: float) -> None:
    n = 80
    tangent = np.tan(np.radians(2.0)) * (2 * (np.arange(n) + 0.5) / n - 1)
    u, _ = np.meshgrid(tangent, tangent)
    slope = np.tan(np.radians(tilt_deg))
    scan = perspective(1.0 / (1 - slope * u), 4.0)
    # On a square grid samples at 75.5° lie four times as far apart down the slope as across.
    found = orient(scan, OrientationSettings(step_factor=8.0))
    normal = np.array([slope, 0, -1.0]) / np.hypot(slope, 1)
    sight = -scan.points_in_scan / np.linalg.norm(scan.points_in_scan, axis=1, keepdims=True)
    cosine = np.abs(sight @ normal)
    limit = np.cos(np.radians(SETTINGS.max_incidence_deg))
    assert np.allclose(found.incidence_cos, cosine[found.source], atol=1e-9)
    assert cosine[found.source].min(initial=1.0) >= limit - 1e-9
    share = (cosine > limit).mean()
    assert len(found) / len(scan) == pytest.approx(share, abs=0.03)
    if len(found):
        assert np.abs(np.abs(found.normals @ normal) - 1).max() < 1e-9


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_normals_face_the_scanner_wherever_it_stands(offset: float) -> None:
    rng = np.random.default_rng(4)
    depth = 1 + 0.05 * np.sin(np.arange(50) / 6)[:, None] + 0.0001 * rng.normal(size=(50, 50))
    scan = perspective(depth)
    moved = RangeMap("far", scan.points_in_scan + offset, scan.grid, np.full(3, offset))
    found = orient(moved, SETTINGS)
    sight = moved.viewpoint_in_scan - found.points
    assert np.einsum("ni,ni->n", sight, found.normals).min() > 0
    assert np.allclose(np.linalg.norm(found.normals, axis=1), 1, atol=1e-12)
    near = orient(scan, SETTINGS)
    assert np.array_equal(found.source, near.source)
    assert np.einsum("ni,ni->n", found.normals, near.normals).min() > 1 - 1e-6


def test_spacing_reach_and_roughness_are_those_of_the_plane() -> None:
    rng = np.random.default_rng(2)
    n, pitch, sigma = 50, 0.01, 0.0008
    v, u = np.meshgrid(np.arange(n) * pitch, np.arange(n) * 1.4 * pitch, indexing="ij")
    points = np.stack([u, v, rng.normal(scale=sigma, size=u.shape)], axis=-1).reshape(-1, 3)
    grid = np.arange(n * n, dtype=np.int32).reshape(n, n)
    found = orient(RangeMap("a", points, grid, np.array([0.35, 0.25, 100.0])), SETTINGS)
    assert len(found) == n * n
    assert np.median(found.spacing_m) == pytest.approx(pitch, rel=0.02)
    inside = ~found.border
    assert np.median(found.reach_m[inside]) == pytest.approx(1.4 * pitch, rel=0.02)
    assert np.sqrt(np.mean(found.roughness_m[inside] ** 2)) == pytest.approx(sigma, rel=0.1)


def sphere_cloud(n: int) -> np.ndarray:
    z = 1 - (2 * np.arange(n) + 1) / n
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def test_a_cloud_without_order_gets_normals_from_its_neighbours() -> None:
    points = sphere_cloud(4000)
    points = points[points[:, 2] > 0.3]
    viewpoint = np.array([0, 0, 50.0])
    found = orient(RangeMap("cloud", points, None, viewpoint), SETTINGS)
    assert len(found) > 0.97 * len(points)
    outward = np.einsum("ni,ni->n", found.normals, found.points)
    assert outward[~found.border].min() > np.cos(np.radians(4))
    assert np.median(found.spacing_m) == pytest.approx(np.sqrt(4 * np.pi / 4000), rel=0.15)
    rim = found.points[found.border]
    assert len(rim)
    assert rim[:, 2].max() < 0.5


def test_an_unknown_viewpoint_gives_normals_that_agree_with_each_other() -> None:
    points = sphere_cloud(2000)
    found = orient(RangeMap("cloud", points + 1e5), SETTINGS)
    outward = np.einsum("ni,ni->n", found.normals, found.points - 1e5)
    assert np.abs(outward).min() > np.cos(np.radians(3))
    assert len(np.unique(np.sign(outward))) == 1
    assert (found.incidence_cos == 1).all()


@pytest.mark.parametrize("count", [0, 1, 2, 12])
@pytest.mark.parametrize("ordered", [True, False])
def test_scans_of_a_few_samples_have_no_surface(count: int, ordered: bool) -> None:
    grid = np.arange(count, dtype=np.int32).reshape(1, count) if ordered else None
    points = np.column_stack([np.arange(count), np.zeros(count), np.ones(count)]).astype(float)
    assert len(orient(RangeMap("tiny", points, grid, np.zeros(3)), SETTINGS)) == 0


def test_a_grid_that_saw_nothing_has_no_samples() -> None:
    empty = RangeMap("a", np.zeros((0, 3)), np.full((5, 5), -1, np.int32), np.zeros(3))
    assert len(orient(empty, SETTINGS)) == 0


def test_taken_samples_keep_their_order() -> None:
    found = orient(perspective(np.full((20, 20), NEAR)), SETTINGS)
    part = found.take(np.array([7, 3, 11]))
    assert np.array_equal(part.source, found.source[[7, 3, 11]])
    assert np.array_equal(part.points, found.points[[7, 3, 11]])


def test_clouds_no_triangulation_of_space_takes_are_oriented_by_their_neighbours() -> None:
    places = np.stack(np.meshgrid(np.arange(20.0), np.arange(15.0)), axis=-1).reshape(-1, 2)
    flat = np.column_stack([places, np.full(len(places), 2.0)])
    assert (orient(RangeMap("flat", flat), SETTINGS).normals[:, 2] > 0.99).all()
    # Two balls apart, each with normals of either sign.
    angle = np.pi * (1 + np.sqrt(5)) * np.arange(3000)
    z = 1 - (2 * np.arange(3000) + 1) / 3000
    ball = np.column_stack([np.sqrt(1 - z**2) * f(angle) for f in (np.cos, np.sin)] + [z])
    rng = np.random.default_rng(0)
    beside = np.array([5.0, 0.0, 0.0])
    points, normals = np.concatenate([ball, ball + beside]), np.tile(ball, (2, 1))
    mixed = normals * rng.choice([-1.0, 1.0], len(normals))[:, None]
    assert np.allclose(_consistent_with_neighbours(points, mixed), normals)
