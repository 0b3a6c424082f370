from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import looking_at
from workbench.synthetic import ScannerOptions, Scene, SimulatedScan, solids
from workbench.synthetic.raycasting import RayCaster
from workbench.synthetic.scanner import Samples, scan_samples
from workbench.synthetic.scene import OBJECT, SUPPORT, painted

Scan = Callable[..., Samples]
GRID = {"rows": 300, "cols": 300, "vertical_fov_deg": 40.0, "horizontal_fov_deg": 40.0}


def scene_of(*meshes: TriangleMesh) -> Scene:
    return Scene("test", solids.collected(meshes), np.zeros(3), np.zeros(3))


def slab(reflectance: float = 0.6, material: int = OBJECT) -> TriangleMesh:
    return painted(solids.box((-30, -30, -0.5), (30, 30, 0)), material, np.array([reflectance]))


@pytest.fixture
def scan(faultless: dict[str, float]) -> Scan:
    """A scan without faults but those that are asked for."""

    def samples(scene: Scene, pose: np.ndarray, **options: object) -> Samples:
        chosen = ScannerOptions.model_validate(
            {**faultless, **GRID, "max_range_m": 100.0, **options}
        )
        return scan_samples(scene, pose, chosen, np.random.default_rng(0))

    return samples


def test_ray_hits_agree_with_brute_force_in_float64() -> None:
    rng = np.random.default_rng(0)
    mesh = solids.geodesic_sphere((0.3, 0.2, 0.1), 0.7, 3)
    start = np.array([3.0, -1.0, 0.5])
    way = np.array([0.3, 0.2, 0.1]) + rng.uniform(-0.8, 0.8, (200, 3)) - start
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    hits = RayCaster(mesh).cast(start, way)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    for n in range(200):
        p = np.cross(way[n], c - a)
        det = ((b - a) * p).sum(1)
        u = ((start - a) * p).sum(1) / det
        q = np.cross(start - a, b - a)
        v = (q @ way[n]) / det
        t = ((c - a) * q).sum(1) / det
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
        expected = t[inside].min() if inside.any() else np.inf
        assert hits.distance[n] == pytest.approx(expected, abs=1e-12)
    assert np.isinf(hits.distance).any()
    struck = np.isfinite(hits.distance)
    points = start + hits.distance[struck, None] * way[struck]
    corners = mesh.vertices[mesh.triangles[hits.triangle[struck]]]
    assert np.allclose((hits.barycentric[struck, :, None] * corners).sum(1), points, atol=1e-6)


def test_noise_lies_along_the_ray_and_grows_with_the_square_of_the_distance(scan: Scan) -> None:
    scene = scene_of(slab())
    for height in (1.0, 2.0):
        pose = looking_at((0, -0.9 * height, height), (0, 0, 0))
        samples = scan(scene, pose, depth_sigma_m=4e-4, reference_distance_m=1.5)
        direction = samples.points_in_scan / np.linalg.norm(
            samples.points_in_scan, axis=1, keepdims=True
        )
        # The plane z = 0 met analytically: nothing of the simulator's own truth is used.
        exact = -pose[2, 3] / (direction @ pose[:3, :3].T)[:, 2]
        noise = np.linalg.norm(samples.points_in_scan, axis=1) - exact
        sigma = 4e-4 * (exact / 1.5) ** 2
        assert np.std(noise / sigma) == pytest.approx(1.0, rel=0.05)
        assert abs(np.mean(noise / sigma)) < 0.02
        near = exact < np.median(exact)
        for half in (near, ~near):
            assert np.std(noise[half] / sigma[half]) == pytest.approx(1.0, rel=0.05)
        assert np.allclose(samples.depth_sigma_m, sigma, rtol=1e-9)
        assert np.allclose(samples.true_range_m, exact, rtol=1e-9)


def test_noise_on_the_statue_agrees_with_the_options(statue_scans: list[SimulatedScan]) -> None:
    for one in statue_scans:
        truth = one.samples
        good = ~truth.is_mixed & ~truth.is_stray
        ranges = np.linalg.norm(truth.points_in_scan, axis=1)
        hits = np.linalg.norm(truth.true_points_in_scan, axis=1)
        sigma = 0.0005 * (hits / 1.5) ** 2
        assert np.std((ranges - hits)[good] / sigma[good]) == pytest.approx(1.0, rel=0.05)


def test_angular_jitter_moves_the_hit_but_not_the_nominal_ray(scan: Scan) -> None:
    pose = looking_at((0, -1.0, 2.0), (0, 0, 0))
    still, shaken = (scan(scene_of(slab()), pose, angular_jitter_rad=j) for j in (0.0, 1e-3))
    nominal = still.points_in_scan / np.linalg.norm(still.points_in_scan, axis=1, keepdims=True)
    along = np.linalg.norm(shaken.points_in_scan, axis=1, keepdims=True)
    assert np.allclose(shaken.points_in_scan / along, nominal, atol=1e-12)
    hit = shaken.true_points_in_scan
    sine = np.linalg.norm(np.cross(hit, nominal), axis=1) / np.linalg.norm(hit, axis=1)
    # Two normal components: the tilt is Rayleigh distributed.
    assert np.sqrt(np.mean(sine**2) / 2) == pytest.approx(1e-3, rel=0.02)


def test_grazing_dropout_rises_linearly_to_its_probability_at_ninety_degrees(scan: Scan) -> None:
    pose = looking_at((0, 0, 0.5), (0, 3.0, 0.0))
    grid = {"rows": 500, "cols": 400, "vertical_fov_deg": 16.0, "horizontal_fov_deg": 4.0}
    kept, every = (
        scan(scene_of(slab()), pose, grazing_dropout=p, grazing_start_deg=75.0, **grid)
        for p in (0.8, 0.0)
    )
    ranges = np.linalg.norm(every.points_in_scan, axis=1)
    angle = np.degrees(np.arccos(0.5 / ranges))
    assert angle.min() < 75
    assert angle.max() > 88
    there = np.isin(every.pixel, kept.pixel)
    assert there[angle < 75].all()
    for low in np.arange(75, 88, 2):
        bin_ = (angle >= low) & (angle < low + 2)
        expected = 0.8 * (angle[bin_].mean() - 75) / 15
        tolerance = 4 * np.sqrt(expected * (1 - expected) / bin_.sum()) + 1e-3
        assert 1 - there[bin_].mean() == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize(("reflectance", "expected"), [(0.02, 0.4 * 0.75), (0.1, 0.0)])
def test_dark_dropout_follows_the_signal(scan: Scan, reflectance: float, expected: float) -> None:
    pose = looking_at((0, -1e-6, 5.0), (0, 0, 0))
    narrow = {"vertical_fov_deg": 2.0, "horizontal_fov_deg": 2.0}
    samples = scan(scene_of(slab(reflectance)), pose, dark_signal=0.08, dark_dropout=0.4, **narrow)
    lost = 1 - len(samples.pixel) / 90000
    assert lost == pytest.approx(expected, abs=4 * np.sqrt(0.25 / 90000))


def test_reflectance_is_material_times_cosine_with_its_noise(scan: Scan) -> None:
    pose = looking_at((0, -3.0, 3.0), (0, 0, 0))
    narrow = {"vertical_fov_deg": 1.0, "horizontal_fov_deg": 1.0}
    samples = scan(scene_of(slab(0.6)), pose, reflectance_sigma=0.05, **narrow)
    cosine = np.cos(np.radians(45))
    assert samples.reflectance.mean() == pytest.approx(0.6 * cosine, rel=5e-3)
    assert samples.reflectance.std() == pytest.approx(0.05 * 0.6 * cosine, rel=0.1)


def test_range_limits_hold(scan: Scan) -> None:
    pose = looking_at((0, -1.0, 1.0), (0, 0.0, 0))
    samples = scan(scene_of(slab()), pose, min_range_m=1.2, max_range_m=1.6)
    ranges = np.linalg.norm(samples.points_in_scan, axis=1)
    assert ranges.min() >= 1.2
    assert ranges.max() <= 1.6
    assert 1000 < len(ranges) < 90000


def test_stray_points_come_at_their_rate_before_the_surface(scan: Scan) -> None:
    pose = looking_at((0, -1.0, 2.0), (0, 0, 0))
    samples = scan(scene_of(slab()), pose, stray_probability=0.01, min_range_m=0.3)
    assert samples.is_stray.mean() == pytest.approx(0.01, rel=0.15)
    ranges = np.linalg.norm(samples.points_in_scan, axis=1)
    assert (ranges[samples.is_stray] < samples.true_range_m[samples.is_stray]).all()
    assert np.allclose(ranges[~samples.is_stray], samples.true_range_m[~samples.is_stray])


def step_scene() -> Scene:
    """A bright wall at z = 0 with a plate 60 mm before its left half (x < 0)."""
    plate = painted(solids.box((-1, -1, 0.05), (0, 1, 0.06)), SUPPORT, np.array([0.3]))
    return scene_of(slab(), plate)


def test_mixed_pixels_lie_at_the_step_and_between_the_two_surfaces(scan: Scan) -> None:
    pose = looking_at((0.001, -1e-6, 2.0), (0.001, 0, 0))
    samples = scan(step_scene(), pose, beam_divergence_rad=2e-3, footprint_rays=19)
    # Beams through the grid's columns lie 4.9 mm apart at the wall; the footprint is 4 mm wide.
    rows_with_step = 300
    mixed = samples.is_mixed
    assert 0.3 * rows_with_step < mixed.sum() < 2 * rows_with_step
    height = samples.points_in_scan @ pose[:3, :3].T + pose[:3, 3]
    assert np.abs(height[mixed, 0]).max() < 0.5 * 2e-3 * 2.2
    assert (height[mixed, 2] > 1e-4).all()
    assert (height[mixed, 2] < 0.06 - 1e-4).all()
    on_wall = np.abs(height[~mixed, 2]) < 1e-6
    on_plate = np.abs(height[~mixed, 2] - 0.06) < 1e-6
    assert (on_wall | on_plate).all()
    assert not scan(step_scene(), pose, beam_divergence_rad=0.0).is_mixed.any()


def test_echoes_beyond_the_pulse_are_told_apart(scan: Scan) -> None:
    pose = looking_at((0.001, -1e-6, 2.0), (0.001, 0, 0))
    samples = scan(
        step_scene(), pose, beam_divergence_rad=2e-3, footprint_rays=19, mixed_step_max_m=0.03
    )
    assert not samples.is_mixed.any()


def test_mixed_pixels_on_the_statue_lie_between_independently_cast_surfaces(
    statue_scene: Scene, statue_scans: list[SimulatedScan]
) -> None:
    one = statue_scans[0]
    mixed = np.flatnonzero(one.samples.is_mixed & ~one.samples.is_stray)
    assert len(mixed) > 100
    measured = np.linalg.norm(one.samples.points_in_scan[mixed], axis=1)
    axis = one.samples.points_in_scan[mixed] / measured[:, None]
    rng = np.random.default_rng(0)
    reached = []
    for _ in range(200):
        tilt = rng.normal(0, 3e-4, axis.shape)
        way = (axis + tilt) / np.linalg.norm(axis + tilt, axis=1, keepdims=True)
        cast = statue_scene.caster.cast(
            one.local_from_scan[:3, 3], way @ one.local_from_scan[:3, :3].T
        )
        reached.append(np.where(np.isfinite(cast.distance), cast.distance, np.nan))
    near, far = np.nanmin(reached, axis=0), np.nanmax(reached, axis=0)
    assert np.mean((measured > near - 1e-3) & (measured < far + 1e-3)) > 0.97
    assert np.median(far - near) > 0.004
