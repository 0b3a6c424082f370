from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from workbench.formats.poses import read_conf
from workbench.formats.range_ply import read_range_ply
from workbench.geometry import transforms
from workbench.geometry.mesh import edge_census
from workbench.synthetic import (
    OBJECT,
    Scene,
    SimulatedScan,
    SimulationOptions,
    analytic,
    build_scene,
    simulate_scan,
    simulate_scans,
    write_simulation,
)

TINY = {
    "scans": 2,
    "mesh_spacing_m": 0.014,
    "scanner": {"rows": 60, "cols": 44},
}


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulation")
    return write_simulation(out, SimulationOptions.model_validate({**TINY, "seed": 8}))


def test_same_seed_same_bytes_other_seed_other_bytes(written: Path, tmp_path: Path) -> None:
    again = write_simulation(
        tmp_path / "again", SimulationOptions.model_validate({**TINY, "seed": 8})
    )
    first = digests(written)
    assert sorted(first) == [
        "scans/poses.conf",
        "scans/scan_00.ply",
        "scans/scan_01.ply",
        "truth/masks/scan_00.png",
        "truth/masks/scan_01.png",
        "truth/scan_poses.json",
        "truth/scans/scan_00.npz",
        "truth/scans/scan_01.npz",
        "truth/simulation.json",
        "truth/surface.npz",
    ]
    assert digests(again) == first
    other = write_simulation(
        tmp_path / "other", SimulationOptions.model_validate({**TINY, "seed": 9})
    )
    changed = digests(other)
    assert all(changed[name] != digest for name, digest in first.items())


def test_files_hold_the_scans_and_their_truth(written: Path) -> None:
    options = SimulationOptions.model_validate({**TINY, "seed": 8})
    surface = np.load(written / "truth" / "surface.npz")
    assert surface["vertices"].dtype == np.float64
    assert edge_census(surface["triangles"]).watertight
    poses = json.loads((written / "truth" / "scan_poses.json").read_text())
    assert poses["origin"] == [0.0, 0.0, 0.0]
    coarse = read_conf(written / "scans" / "poses.conf")
    for scan in simulate_scans(options):
        name = scan.range_map.name
        stored = read_range_ply(written / "scans" / f"{name}.ply")
        assert np.array_equal(stored.points_in_scan, scan.range_map.points_in_scan)
        assert np.array_equal(stored.grid, scan.range_map.grid)
        assert np.array_equal(stored.reflectance, scan.range_map.reflectance)
        truth = np.load(written / "truth" / "scans" / f"{name}.npz")
        assert len(truth["material"]) == len(stored)
        mask = np.asarray(Image.open(written / "truth" / "masks" / f"{name}.png"))
        keep = (truth["material"] == OBJECT) & ~truth["is_mixed"] & ~truth["is_stray"]
        assert np.array_equal(np.unique(mask), [0, 255])
        assert np.array_equal(mask.ravel()[truth["pixel"]] == 255, keep)
        assert (mask == 255).sum() == keep.sum()
        true_pose = np.array(poses["scans"][name]["world_from_scan"])
        good = ~truth["is_mixed"] & ~truth["is_stray"]
        moved = transforms.apply(true_pose, stored.points_in_scan)
        gap = np.linalg.norm(moved - truth["true_points_in_local"], axis=1)[good]
        # Noise of 0.2 mm and half a footprint of 1.3 mm at most.
        assert np.median(gap) < 0.0006
        # The beam meets an edge beside its axis: half the footprint, foreshortened.
        assert gap.max() < 0.003
        error = coarse[f"{name}.ply"] @ transforms.inverse(true_pose)
        assert 0.1 < transforms.rotation_angle_deg(error) < 6
        assert np.allclose(coarse[f"{name}.ply"], scan.range_map.world_from_scan, atol=1e-12)
    saved = json.loads((written / "truth" / "simulation.json").read_text())
    assert SimulationOptions.model_validate(saved["options"]) == options


def test_a_scan_is_the_same_alone_and_from_a_copy_sent_to_a_worker(
    statue_scene: Scene, statue_options: SimulationOptions, statue_scans: list[SimulatedScan]
) -> None:
    assert statue_scene.caster is not None
    sent_scene, sent_options = pickle.loads(pickle.dumps((statue_scene, statue_options)))
    assert "caster" not in sent_scene.__dict__
    alone = simulate_scan(sent_scene, sent_options, 6)
    first = statue_scans[2]
    assert alone.range_map.points_in_scan.tobytes() == first.range_map.points_in_scan.tobytes()
    assert np.array_equal(alone.world_from_scan, first.world_from_scan)
    assert not np.array_equal(alone.world_from_scan, statue_scans[0].world_from_scan)


def test_scans_land_on_the_true_surface(
    statue_scene: Scene,
    faultless: dict[str, float],
    distance_to_triangles: Callable[..., np.ndarray],
) -> None:
    options = SimulationOptions.model_validate(
        {"scene": "statue", "seed": 3, "mesh_spacing_m": 0.007, "scanner": faultless}
    )
    rng = np.random.default_rng(0)
    for index in (2, 5):
        scan = simulate_scan(statue_scene, options, index)
        chosen = rng.integers(0, len(scan.range_map), 150)
        points = transforms.apply(scan.world_from_scan, scan.range_map.points_in_scan[chosen])
        gap = distance_to_triangles(
            points, statue_scene.surface.vertices, statue_scene.surface.triangles
        )
        assert gap.max() < 2e-7


def test_faulty_scans_stay_within_noise_and_footprint_of_the_surface(
    statue_scene: Scene,
    statue_scans: list[SimulatedScan],
    distance_to_triangles: Callable[..., np.ndarray],
) -> None:
    rng = np.random.default_rng(1)
    scan = statue_scans[1]
    good = np.flatnonzero(~scan.samples.is_mixed & ~scan.samples.is_stray)
    chosen = rng.choice(good, 200, replace=False)
    points = transforms.apply(scan.world_from_scan, scan.range_map.points_in_scan[chosen])
    gap = distance_to_triangles(
        points, statue_scene.surface.vertices, statue_scene.surface.triangles
    )
    # Noise of 0.5 mm at the stand-off, and what the tilt and the footprint add.
    assert 1.25e-4 < np.sqrt(np.mean(gap**2)) < 7.5e-4
    assert gap.max() < 3.75e-3


@pytest.mark.parametrize("offset", [(5e5, 5.2e6, 120.0)])
def test_a_world_offset_moves_the_poses_and_leaves_the_scans(
    offset: tuple[float, float, float],
) -> None:
    small = {"scene": "building", "scans": 4, "scanner": {"rows": 60, "cols": 90}}
    plain, far = (
        SimulationOptions.model_validate({**small, "world_offset_m": shift})
        for shift in ((0.0, 0.0, 0.0), offset)
    )
    for here, there in zip(simulate_scans(plain), simulate_scans(far), strict=True):
        assert np.array_equal(here.range_map.points_in_scan, there.range_map.points_in_scan)
        assert here.range_map.grid is not None
        assert np.array_equal(here.range_map.grid, there.range_map.grid)
        for near_pose, far_pose in (
            (here.world_from_scan, there.world_from_scan),
            (here.range_map.world_from_scan, there.range_map.world_from_scan),
        ):
            assert near_pose is not None
            assert far_pose is not None
            assert np.array_equal(near_pose[:3, :3], far_pose[:3, :3])
            assert np.abs(far_pose[:3, 3] - offset - near_pose[:3, 3]).max() < 2e-9
        assert np.array_equal(here.samples.true_points_in_scan, there.samples.true_points_in_scan)


@pytest.fixture
def scanned_points(faultless: dict[str, float]) -> Callable[[str], list[np.ndarray]]:
    """Faultless samples of four scans of a scene, in world coordinates."""

    def points(scene_name: str) -> list[np.ndarray]:
        options = SimulationOptions.model_validate(
            {"scene": scene_name, "scans": 4, "scanner": faultless}
        )
        return [
            transforms.apply(scan.world_from_scan, scan.range_map.points_in_scan)
            for scan in simulate_scans(options)
        ]

    return points


def test_the_plane_is_flat_and_fills_every_view(
    scanned_points: Callable[[str], list[np.ndarray]],
) -> None:
    for points in scanned_points("plane"):
        assert len(points) == 200 * 200
        assert np.abs(points[:, 2]).max() < 1e-12


def test_the_sphere_is_round(
    scanned_points: Callable[[str], list[np.ndarray]],
) -> None:
    for points in scanned_points("sphere"):
        radius = np.linalg.norm(points, axis=1)
        assert np.abs(radius - analytic.SPHERE_RADIUS_M).max() < 6e-6


def test_the_cylinder_is_round_and_never_ends(
    scanned_points: Callable[[str], list[np.ndarray]],
) -> None:
    for points in scanned_points("cylinder"):
        radius = np.hypot(points[:, 0], points[:, 1])
        assert np.abs(radius - analytic.CYLINDER_RADIUS_M).max() < 2e-6
        assert np.abs(points[:, 2]).max() < 0.6


def test_the_thin_sheet_shows_both_sides_a_few_millimetres_apart(
    scanned_points: Callable[[str], list[np.ndarray]],
) -> None:
    tops, bottoms = 0, 0
    for points in scanned_points("thin-sheet"):
        inside = (np.abs(points[:, 0]) < 0.299) & (np.abs(points[:, 1]) < 0.199)
        above = points[inside, 2] - analytic.sheet_height(points[inside, 0], points[inside, 1])
        half = 0.5 * analytic.SHEET_THICKNESS_M
        assert np.abs(np.abs(above) - half).max() < 2e-5
        tops += int((above > 0).sum())
        bottoms += int((above < 0).sum())
    assert min(tops, bottoms) > 5000


def test_the_building_is_closed_and_of_its_size() -> None:
    scene = build_scene(SimulationOptions.model_validate({"scene": "building"}))
    assert edge_census(scene.surface.triangles).watertight
    stone = scene.surface.vertices[scene.material == OBJECT]
    # Walls of 30 × 20 m, cornices, the portico's steps and the chimneys.
    assert np.allclose(np.ptp(stone, axis=0), [31.2, 25.3, 12.7], atol=0.3)
    assert scene.origin_in_world.tolist() == [5e5, 5.2e6, 120.0]


def test_walls_let_no_ray_through() -> None:
    scene = build_scene(SimulationOptions.model_validate({"scene": "building"}))
    rng = np.random.default_rng(0)
    target = np.column_stack(
        [rng.uniform(-14.5, 14.5, 20000), np.full(20000, -10.0), rng.uniform(0.5, 8.5, 20000)]
    )
    start = np.array([0.0, -40.0, 5.0])
    way = target - start
    distance = np.linalg.norm(way, axis=1)
    hits = scene.caster.cast(start, way / distance[:, None])
    # Window and door recesses end at the core, 0.45 m behind the face of the wall.
    assert (hits.distance <= distance * (1 + 0.46 / 30)).all()


def test_progress_counts_up_to_the_total(statue_scene: Scene) -> None:
    calls: list[tuple[int, int, str]] = []
    options = SimulationOptions.model_validate(
        {"scans": 3, "scanner": {"rows": 20, "cols": 20}, "seed": 3, "mesh_spacing_m": 0.007}
    )
    scans = list(simulate_scans(options, lambda *call: calls.append(call), statue_scene))
    assert [scan.range_map.name for scan in scans] == ["scan_00", "scan_01", "scan_02"]
    assert [done for done, _, _ in calls] == [1, 2, 3, 4]
    assert {total for _, total, _ in calls} == {4}


def test_scans_overlap_and_see_nearly_all_of_the_statue(
    statue_scene: Scene, statue_options: SimulationOptions
) -> None:
    from scipy.spatial import cKDTree

    coarse = statue_options.model_copy(
        update={"scanner": statue_options.scanner.model_copy(update={"rows": 150, "cols": 110})}
    )
    views = []
    for scan in simulate_scans(coarse, scene=statue_scene):
        good = (scan.samples.material == OBJECT) & ~scan.samples.is_stray
        views.append(transforms.apply(scan.local_from_scan, scan.samples.true_points_in_scan[good]))
    rng = np.random.default_rng(0)
    stone = statue_scene.surface.vertices[statue_scene.material == OBJECT]
    probe = stone[rng.integers(0, len(stone), 4000)]
    probe = probe[probe[:, 2] > 0.01]
    seen = np.stack(
        [np.isfinite(cKDTree(view).query(probe, distance_upper_bound=0.012)[0]) for view in views]
    )
    assert (seen.sum(axis=0) >= 1).mean() > 0.9
    assert (seen.sum(axis=0) >= 2).mean() > 0.8
    for n in range(len(views)):
        others = np.delete(seen, n, axis=0).any(axis=0)
        assert (seen[n] & others).sum() > 0.5 * seen[n].sum()
