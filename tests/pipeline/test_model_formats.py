"""``lod`` and ``decode`` for surfels and coded points, of surfaces and of clouds."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from workbench.cli import run_cli
from workbench.formats.ply_points import write_ply_points
from workbench.formats.point_files import read_points
from workbench.formats.point_stream import slices_of, surveyed
from workbench.formats.surface_files import read_surface, write_surface_ply
from workbench.geometry.point_set import PointSet
from workbench.pipeline.model_formats import FORMATS
from workbench.voxels.lod_levels import thin_part
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import voxelise


@pytest.fixture
def cli(capsys):
    def call(*arguments, expect: int = 0):
        code = run_cli((), [*map(str, arguments), "--json"])
        out, err = capsys.readouterr()
        assert code == expect, err
        return json.loads(out)

    return call


@pytest.fixture
def ball(tmp_path: Path, sphere: Callable) -> Path:
    """A sphere of radius 1, red to the right and green to the left."""
    mesh = sphere(subdivisions=4)
    color = np.where(mesh.vertices[:, :1] > 0, [[200, 30, 30]], [[30, 160, 30]]).astype(np.uint8)
    write_surface_ply(tmp_path / "ball.ply", mesh.with_attributes(color=color))
    return tmp_path / "ball.ply"


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """5000 points on the sphere around (100, 0, 0), in colours."""
    rng = np.random.default_rng(3)
    way = rng.standard_normal((5000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    color = rng.integers(0, 256, (5000, 3)).astype(np.uint8)
    points = PointSet(way + np.array([100.0, 0, 0]), way.astype(np.float32), color)
    write_ply_points(tmp_path / "cloud.ply", surveyed(slices_of(points)))
    return tmp_path / "cloud.ply"


CONTRACT = {"format", "file", "items", "bytes", "bits_per_item", "seconds", "peak_rss_bytes"}


@pytest.mark.parametrize("codec", ["ci", "eci", "context"])
def test_cells_of_a_surface_are_its_thin_voxels(cli, tmp_path, ball, codec):
    given = ("lod", ball, "--format", codec, "--resolution", 64, "--out", tmp_path / "out")
    told = cli(*given)
    assert set(told) >= CONTRACT
    made = Path(told["file"])
    assert made == tmp_path / "out" / "points.pcube"
    assert told["bytes"] == made.stat().st_size
    assert told["bits_per_item"] == pytest.approx(8 * told["bytes"] / told["items"])
    assert told["cells_of"] == "surface"
    decoded = cli("decode", made, "--out", tmp_path / "a.ply")
    mesh = read_surface(ball)
    expected = thin_part(voxelise(mesh, grid_of_mesh(mesh.vertices, 6)))
    assert decoded["items"] == told["items"] == len(expected)
    found = read_points(tmp_path / "a.ply")
    order = np.lexsort(found.points.T)
    wanted = np.lexsort(expected.centers.T)
    np.testing.assert_allclose(found.points[order], expected.centers[wanted], atol=1e-9)
    np.testing.assert_array_equal(found.color[order], expected.color[wanted])


def test_cells_of_a_cloud_are_where_its_points_are(cli, tmp_path, cloud):
    told = cli(
        "lod", cloud, "--format", "context", "--resolution", 300, "--out", tmp_path / "a.pcube"
    )
    assert told["file"] == str(tmp_path / "a.pcube")
    assert told["cells_of"] == "points"
    assert told["items"] + told["merged"] == told["given"] == 5000
    cli("decode", tmp_path / "a.pcube", "--out", tmp_path / "a.ply")
    found = read_points(tmp_path / "a.ply").points
    distance = np.abs(np.linalg.norm(found - [100, 0, 0], axis=1) - 1)
    assert distance.max() <= told["largest_move"] <= np.sqrt(3) / 2 * told["cell_size"] * 1.001


@pytest.mark.parametrize("kind", ["ball", "cloud"])
def test_surfels_of_either(cli, tmp_path, request, kind):
    source = request.getfixturevalue(kind)
    given = ("--count", 2000, "--candidates", 256) if kind == "ball" else ("--count", 2000)
    told = cli("lod", source, "--format", "surfels", *given, "--seed", 5, "--out", tmp_path)
    assert set(told) >= CONTRACT
    assert told["items"] == 2000
    decoded = cli("decode", told["file"], "--count", 500, "--out", tmp_path / "a.ply")
    assert (decoded["items"], decoded["unit"]) == (500, "surfels")
    found = read_points(tmp_path / "a.ply")
    middle = [0, 0, 0] if kind == "ball" else [100, 0, 0]
    away = found.points - middle
    assert np.abs(np.linalg.norm(away, axis=1) - 1).max() < 0.01
    assert ((away * found.normals).sum(axis=1) > 0.98).all()
    if kind == "ball":
        right = away[:, 0] > 0.1
        assert (found.color[right, 0] > found.color[right, 1]).all()
    again = cli("lod", source, "--format", "surfels", *given, "--seed", 5, "--out", tmp_path / "b")
    assert Path(again["file"]).read_bytes() == Path(told["file"]).read_bytes()


def test_options_that_do_not_belong_are_refused(cli, tmp_path, ball, cloud):
    out = ("--out", tmp_path / "out")
    for words, arguments in {
        "--count does not belong": ("lod", ball, "--format", "ci", "--count", 5),
        "--seed does not belong": ("lod", ball, "--seed", 5),
        "--resolution does not belong": ("lod", ball, "--format", "surfels", "--resolution", 64),
        "did you mean 'surfels'": ("lod", ball, "--format", "surfel"),
        "cut from a surface": ("lod", cloud, "--format", "ssvdag", "--resolution", 64),
        "power of two": ("lod", ball, "--format", "eci", "--resolution", 300),
    }.items():
        error = cli(*arguments, *out, expect=2)["error"]
        assert words in " ".join(error.values()), arguments
    for words, arguments in {
        "--level does not belong": ("decode", cloud, "--level", 3),
        "--count does not belong": ("decode", cloud, "--count", 3),
    }.items():
        error = cli(*arguments, "--out", tmp_path / "b.ply", expect=2)["error"]
        assert words in error["message"]
    assert not (tmp_path / "out").exists()


def test_every_format_names_its_file(tmp_path):
    for name, made in FORMATS.items():
        inside = made.place(tmp_path / "folder")
        assert inside.parent == tmp_path / "folder", name
        if not made.ending:
            continue
        exactly = tmp_path / f"model.a{made.ending}"
        assert made.place(exactly) == exactly, name


@pytest.mark.parametrize("kind", ["laz", "las", "copc", "potree", "e57", "ply", "layered"])
def test_clouds_in_the_formats_of_others_and_back(cli, tmp_path, cloud, kind):
    told = cli("lod", cloud, "--format", kind, "--out", tmp_path / "out")
    assert set(told) >= CONTRACT
    made = Path(told["file"])
    assert told["items"] == 5000
    if kind == "potree":
        assert {path.name for path in made.iterdir()} >= {"metadata.json", "octree.bin"}
        return
    assert told["bytes"] == made.stat().st_size
    decoded = cli("decode", made, "--out", tmp_path / "back.ply")
    assert (decoded["items"], decoded["unit"]) == (5000, "points")
    given, found = read_points(cloud), read_points(tmp_path / "back.ply")
    near = cKDTree(found.points).query(given.points)[1]
    assert len(np.unique(near)) == 5000
    assert np.abs(found.points[near] - given.points).max() <= told["rounding_error"] + 1e-9
    np.testing.assert_array_equal(found.color[near], given.color)
