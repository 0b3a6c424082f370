from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry import transforms
from workbench.geometry.transforms import looking_at
from workbench.synthetic import CoarsePoseOptions, Scene, SimulationOptions
from workbench.synthetic.scanner import ray_directions
from workbench.synthetic.stations import coarse_pose, local_from_scan


def test_the_scan_frame_looks_along_z_with_y_down() -> None:
    pose = looking_at((0, -2, 1), (0, 0, 1))
    assert transforms.is_rigid(pose, 1e-12)
    assert np.allclose(transforms.rotate(pose, [0, 0, 1]), [0, 1, 0])
    assert np.allclose(transforms.rotate(pose, [0, 1, 0]), [0, 0, -1])
    assert np.allclose(transforms.rotate(pose, [1, 0, 0]), [1, 0, 0])


@pytest.mark.parametrize("pivot", ["object", "scanner"])
def test_coarse_poses_differ_from_the_truth_by_the_stated_sigma(pivot: str) -> None:
    options = CoarsePoseOptions.model_validate(
        {"rotation_sigma_deg": 1.0, "translation_sigma_m": 0.008, "pivot": pivot}
    )
    focus = np.array([0.2, 0.1, 0.6])
    truth = looking_at((1.0, -1.3, 0.9), focus)
    rng = np.random.default_rng(0)
    rotation, shift = [], []
    for _ in range(1500):
        error = coarse_pose(truth, focus, options, rng) @ transforms.inverse(truth)
        still = focus if pivot == "object" else truth[:3, 3]
        cosine = np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)
        rotation.append(np.degrees(np.arccos(cosine)))
        shift.append(transforms.apply(error, still) - still)
    # The angle of a rotation vector with three normal parts is Maxwell distributed.
    assert np.sqrt(np.mean(np.square(rotation)) / 3) == pytest.approx(1.0, rel=0.05)
    assert np.std(shift, axis=0) == pytest.approx([0.008] * 3, rel=0.08)
    assert np.abs(np.mean(shift, axis=0)).max() < 4 * 0.008 / np.sqrt(1500)


def test_statue_stations_surround_it_at_several_heights(statue_scene: Scene) -> None:
    options = SimulationOptions()
    poses = [local_from_scan(statue_scene, options, n, np.random.default_rng(n)) for n in range(12)]
    offset = np.array([pose[:3, 3] for pose in poses]) - statue_scene.focus
    distance = np.linalg.norm(offset, axis=1)
    assert np.abs(distance - 1.65).max() < 1.65 * 0.06 + 0.06
    elevation = np.degrees(np.arcsin(offset[:, 2] / distance))
    assert (elevation > 50).sum() >= 2
    assert (elevation < -5).sum() >= 2
    azimuth = np.sort(np.degrees(np.arctan2(offset[:, 1], offset[:, 0])) % 360)
    assert np.diff(np.append(azimuth, azimuth[0] + 360)).max() < 50


def test_building_stations_stand_outside_and_face_the_walls() -> None:
    options = SimulationOptions.model_validate({"scene": "building", "scans": 10})
    for n in range(10):
        scene = Scene("building", None, np.zeros(3), np.array([0, 0, 5.0]))  # type: ignore[arg-type]
        pose = local_from_scan(scene, options, n, np.random.default_rng(n))
        x, y, z = pose[:3, 3]
        assert abs(x) > 15 + 8 or abs(y) > 10 + 8
        assert 1 < z < 16
        assert pose[:3, 2] @ pose[:3, 3] < 0


@pytest.mark.parametrize("projection", ["perspective", "spherical"])
def test_ray_grids_have_their_field_of_view(projection: str) -> None:
    options = SimulationOptions.model_validate(
        {
            "scanner": {
                "projection": projection,
                "rows": 101,
                "cols": 201,
                "vertical_fov_deg": 40.0,
                "horizontal_fov_deg": 60.0,
            }
        }
    ).scanner
    grid = ray_directions(options).reshape(101, 201, 3)
    assert np.allclose(np.linalg.norm(grid, axis=2), 1)
    assert np.allclose(grid[50, 100], [0, 0, 1])
    left, top = grid[50, 0], grid[0, 100]
    assert np.degrees(np.arctan2(-left[0], left[2])) == pytest.approx(30, abs=0.3)
    assert np.degrees(np.arctan2(-top[1], top[2])) == pytest.approx(20, abs=0.4)
