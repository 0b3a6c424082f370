"""Georeferenced scans give the model that the same scans give near the origin."""

import numpy as np
import pytest

from tests.stages.conftest import workbench
from workbench.formats.poses import read_conf
from workbench.formats.range_ply import read_range_ply, write_range_ply
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import apply
from workbench.verification.distances import distance_to_surface

OFFSET = np.array([5e5, 5.2e6, 120.0])
SCENE = ("--scene", "sphere", "--seed", "5", "--scans", "5")
QUICK = ("--to", "export", "--set", "infill.depth=6")


@pytest.fixture(scope="module")
def near(simulated):
    project = simulated(*SCENE)
    workbench("run", project, *QUICK)
    return read_surface(project / "exports" / "surface.ply"), project


def assert_same_surface(found: TriangleMesh, expected: TriangleMesh) -> None:
    moved = TriangleMesh(found.vertices - OFFSET, found.triangles)
    assert distance_to_surface(moved.vertices, expected).distance_m.max() <= 1e-6
    assert distance_to_surface(expected.vertices, moved).distance_m.max() <= 1e-6


def test_poses_far_away(near, simulated):
    expected, _ = near
    offset = ",".join(str(v) for v in OFFSET)
    project = simulated(*SCENE, "--set", f"world_offset_m=[{offset}]")
    workbench("run", project, *QUICK)
    assert_same_surface(read_surface(project / "exports" / "surface.ply"), expected)


def test_samples_far_away_without_poses(near, tmp_path):
    """Scans already in world coordinates, as exports of other software are."""
    _, source = near
    poses = read_conf(source / "scans" / "poses.conf")
    for folder, offset in (("here", np.zeros(3)), ("there", OFFSET)):
        (tmp_path / folder).mkdir()
        for file, pose in poses.items():
            scan = read_range_ply(source / "scans" / file)
            moved = {
                "points_in_scan": apply(pose, scan.points_in_scan) + offset,
                "world_from_scan": None,
                "viewpoint_in_scan": apply(pose, scan.viewpoint_in_scan) + offset,
            }
            write_range_ply(tmp_path / folder / file, type(scan)(**{**vars(scan), **moved}))
        workbench("new", tmp_path / f"{folder}-project", "--scans", tmp_path / folder)
        project = tmp_path / f"{folder}-project"
        workbench("run", project, *QUICK, "--set", "ingest.missing_pose=identity")
    here = read_surface(tmp_path / "here-project" / "exports" / "surface.ply")
    there = read_surface(tmp_path / "there-project" / "exports" / "surface.ply")
    assert_same_surface(there, here)
