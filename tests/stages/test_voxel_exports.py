"""Voxels that a project exports, and what its report says of them."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from tests.stages.conftest import PLACE
from workbench.formats.surface_files import read_surface
from workbench.verification.voxel_errors import MeshViews
from workbench.voxels.lod_export import LodOptions, write_voxel_lod
from workbench.voxels.lod_file import LodFile
from workbench.voxels.voxel_points import voxel_points
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import voxelise


def options(voxels: str, resolution: int = 64) -> list[str]:
    return [
        *("--set", f"export.voxels={voxels}"),
        *("--set", f"export.voxel_resolution={resolution}"),
        *("--set", "verify.samples=2000"),
        *("--set", "verify.picture_width_px=120"),
    ]


def section_of(project: Path) -> dict | None:
    told = json.loads((project / "report" / "report.json").read_text())
    return next((s for s in told["sections"] if s["title"] == "Voxels"), None)


def table_of(section: dict) -> list[list]:
    return next(block["rows"] for block in section["blocks"] if block["kind"] == "table")


def test_a_graph_is_exported_and_its_encodings_are_told(cli, ball_project, tmp_path):
    ran = cli("verify", ball_project, *options("ssvdag"))
    stages = {stage["name"]: stage for stage in ran["stages"]}
    said = {metric["name"]: metric["value"] for metric in stages["export"]["metrics"]}
    made = ball_project / "exports" / "voxels.voxgraph"
    assert said["voxel_file"] == pytest.approx(made.stat().st_size / 1e6)
    assert not (ball_project / "exports" / "voxels.vlod").exists()

    mesh = read_surface(ball_project / "exports" / "surface.ply")
    expected = voxelise(mesh, grid_of_mesh(mesh.vertices, 6))
    found = voxel_points(made)
    np.testing.assert_array_equal(found.codes, expected.codes)
    np.testing.assert_array_equal(found.color, expected.color)
    assert said["voxels"] == len(expected)
    # In the user's own coordinates, around the ball.
    assert np.abs(found.grid.center - PLACE).max() < 1e-6
    distance = np.linalg.norm(found.centers - PLACE, axis=1)
    assert (np.abs(distance - 1) < found.grid.voxel_size).all()

    section = section_of(ball_project)
    assert section is not None
    rows = {row[0].split()[0]: row for row in table_of(section)}
    assert list(rows) == ["svo", "svdag", "ussvdag", "esvdag", "ssvdag", "osvdag"]
    # Table 5.4, Lucy at 2048³, in bits for each of its six million voxels.
    assert rows["svdag"][5] == pytest.approx(4.0 * 8 * 2**20 / 6e6)
    assert rows["osvdag"][5] is None
    # A ball is its own mirror image in every plane; most of its graph is there once.
    assert rows["ssvdag"][1] < 0.3 * rows["esvdag"][1]
    metrics = {metric["name"]: metric["value"] for metric in ran["metrics"]}
    assert metrics["voxel_bits_ssvdag"] == rows["ssvdag"][3]

    picture = tmp_path / "a.png"
    told = cli("render", ball_project, "--mode", "voxels", "--size", "64x64", "--out", picture)
    assert 0.3 < told["shown"] < 0.9
    assert (
        "no textured depth meshes"
        in cli("render", ball_project, "--mode", "stitch", "--out", picture, expect=2)["error"][
            "message"
        ]
    )


def test_levels_are_exported_and_a_change_of_mind_leaves_nothing_behind(cli, ball_project):
    cli("verify", ball_project, *options("voxels", 512))
    made = ball_project / "exports" / "voxels.vlod"
    file = LodFile(made)
    section = section_of(ball_project)
    assert section is not None
    rows = table_of(section)
    assert [row[0] for row in rows] == [256, 512]
    assert [row[1] for row in rows] == [
        int(file.nodes["voxels"][file.nodes["level"] == level].sum()) for level in (8, 9)
    ]
    assert rows[1][5] < 0.8 * rows[0][5]
    # Error stands against bytes and against run time.
    plots = [block["data"] for block in section["blocks"] if block["kind"] == "plot"]
    for data, (key, column) in zip(plots, (("megabytes", 3), ("seconds", 4)), strict=True):
        assert {int(level): tuple(told.values()) for level, told in data.items()} == {
            row[0]: (pytest.approx(row[column]), pytest.approx(row[5])) for row in rows
        }
        assert all(told[key] > 0 for told in data.values())

    cli("verify", ball_project, *options("none"))
    assert not made.exists()
    assert section_of(ball_project) is None


def test_nothing_asked_for_is_left_out_with_its_reason(cli, ball_project):
    off = ["ply", "obj", "glb", "textured_glb", "textured_obj"]
    nothing = [text for name in off for text in ("--set", f"export.{name}=false")]
    stages = {s["name"]: s for s in cli("plan", ball_project, *nothing)["stages"]}
    assert (stages["export"]["action"], stages["export"]["reason"]) == (
        "left out",
        "no format asked for",
    )
    stages = {
        s["name"]: s
        for s in cli("plan", ball_project, *nothing, "--set", "export.voxels=svdag")["stages"]
    }
    assert stages["export"]["action"] == "run"
    error = cli("plan", ball_project, "--set", "export.voxel_resolution=1000", expect=2)["error"]
    assert "voxel_resolution" in error["message"] + error.get("where", "")


def test_errors_of_levels_are_those_of_pictures(tmp_path, sphere):
    """A mesh against itself differs by nothing but its silhouette; half a voxel more shows."""
    mesh = sphere(subdivisions=6)
    write_voxel_lod(mesh, tmp_path / "a.vlod", LodOptions(resolution=512, chunk_level=6))
    file = LodFile(tmp_path / "a.vlod")
    views = MeshViews.of(mesh, file.grid, 512)
    # The disk of a unit ball, and the grey of its middle: straight towards the viewer.
    disk = views.views[0] > 0
    assert disk.mean() == pytest.approx(np.pi / 4, rel=0.005)
    assert views.views[0][256, 256] == pytest.approx(255 / np.sqrt(1 + 0.5**2 + 0.6**2), rel=0.01)
    errors = [views.error_of(file, level) for level in (6, 7, 8, 9)]
    # Normals and silhouettes alike err with the side of a voxel.
    for coarse, fine in itertools.pairwise(errors):
        assert 0.35 < fine / coarse < 0.7
    tilted = type(views)(views.rays, tuple(np.roll(view, 8, axis=1) for view in views.views))
    assert tilted.error_of(file, 9) > 3 * errors[-1]
