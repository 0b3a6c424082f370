"""Surfels and coded points that a project exports, and what its report says of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.stages.conftest import PLACE
from workbench.formats.point_files import read_points
from workbench.pointcodecs.cube_file import read_point_cubes
from workbench.surfels.surfel_file import surfel_points

GIVEN = (
    *("--set", "export.surfels=3000"),
    *("--set", "export.surfel_candidates_px=128"),
    *("--set", "export.cells=context"),
    *("--set", "export.cell_resolution=64"),
    *("--set", "verify.samples=2000"),
    *("--set", "verify.picture_width_px=120"),
)


def section_of(project: Path, title: str) -> dict | None:
    told = json.loads((project / "report" / "report.json").read_text())
    return next((s for s in told["sections"] if s["title"] == title), None)


def tables_of(section: dict) -> list[list]:
    return [block["rows"] for block in section["blocks"] if block["kind"] == "table"]


def test_surfels_and_cells_are_exported_and_told(cli, ball_project):
    ran = cli("verify", ball_project, *GIVEN)
    stages = {stage["name"]: stage for stage in ran["stages"]}
    said = {metric["name"]: metric["value"] for metric in stages["export"]["metrics"]}
    surfels = surfel_points(ball_project / "exports" / "surfels.surfels")
    away = surfels.points - PLACE
    assert len(surfels) == said["surfels"] == 3000
    assert np.abs(np.linalg.norm(away, axis=1) - 1).max() < 0.01
    below = away[:, 2] < -0.05
    assert (surfels.color[below, 2] > surfels.color[below, 0]).all()
    cells = read_point_cubes(ball_project / "exports" / "points.pcube")
    assert len(cells) == said["cells"]
    middles = np.linalg.norm(cells.frame.centers(cells.cells) - PLACE, axis=1)
    assert np.abs(middles - 1).max() <= np.sqrt(0.75) * said["cell_size"] + 1e-3

    found = {metric["name"]: metric["value"] for metric in ran["metrics"]}
    section = section_of(ball_project, "Surfels")
    prefixes, evenness, choices = tables_of(section)
    assert [row[0] for row in prefixes] == [1000, 3000]
    for row in prefixes:
        assert row[4] > 0.9
        assert row[5] == 0.0
        assert found[f"surfel_ssim_{row[0]}"] == row[4]
    # Discs of a prefix have the area of the ball between them, some twice over.
    covered = 1000 * np.pi * (1e-3 * prefixes[0][2]) ** 2 / (4 * np.pi)
    assert 1.0 < covered < 8.0
    random, exact = (next(r for r in evenness if r[0] == name) for name in ("random", "exact"))
    assert random[2] < 0.8
    assert exact[2:] == [1.0, 1.0]
    assert [row[0] for row in choices] == [128, 256, 512]
    assert choices[0][3] >= choices[-1][3] == 1.0

    codecs = {row[0]: row[1] for row in tables_of(section_of(ball_project, "Coded points"))[0]}
    assert codecs["octree by contexts (in the file)"] == said["cell_bits"]
    assert found["cell_bits_ci"] == codecs["CI, cell identification"]
    assert said["cell_bits"] < 0.5 * codecs["steps in Morton order, lzma"]

    cli("verify", ball_project, *GIVEN, "--set", "export.surfels=0", "--set", "export.cells=none")
    assert section_of(ball_project, "Surfels") is section_of(ball_project, "Coded points") is None
    assert not list((ball_project / "exports").glob("*.surfels"))
    assert not list((ball_project / "exports").glob("*.pcube"))


@pytest.mark.parametrize("most", [1000, 1_000_000])
def test_samples_go_to_clouds_in_the_users_coordinates(cli, tmp_path, most):
    """From memory, and from a layered cloud when there are more than memory may hold."""
    made, placed = tmp_path / "ball", ("--set", "world_offset_m=[4000000,2500000,300]")
    cli("simulate", made, "--scene", "sphere", "--scans", 8, "--set", "scanner.rows=70",
        "--set", "scanner.cols=70", *placed)  # fmt: skip
    ran = cli(
        "run", made, "--to", "export", "--set", f"fuse.memory_samples={most}",
        "--set", 'export.clouds=["laz","ply","potree"]',
    )  # fmt: skip
    stages = {stage["name"]: stage for stage in ran["stages"]}
    said = {m["name"]: m["value"] for m in stages["export"]["metrics"]}
    laz, ply = (read_points(made / "exports" / f"points.{kind}") for kind in ("laz", "ply"))
    assert len(laz) == len(ply) > 3000
    assert said["points_laz"] == pytest.approx(
        (made / "exports" / "points.laz").stat().st_size / 1e6
    )
    potree = json.loads((made / "exports" / "potree" / "metadata.json").read_text())
    assert potree["points"] == len(ply)
    # A sphere of 0.2 m or so about a place in the user's coordinates: all are as far from it.
    middle = np.linalg.lstsq(
        np.column_stack([2 * (ply.points - PLACE), np.ones(len(ply))]),
        ((ply.points - PLACE) ** 2).sum(axis=1), rcond=None,
    )[0][:3]  # fmt: skip
    radii = np.linalg.norm(ply.points - PLACE - middle, axis=1)
    assert radii.std() < 1e-3
    near, _ = cKDTree(ply.points - PLACE).query(laz.points - PLACE)
    assert near.max() < 1e-4
    assert (np.abs(np.linalg.norm(laz.normals, axis=1) - 1) < 1e-4).all()
