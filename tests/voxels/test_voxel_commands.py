"""The commands lod, decode and render on files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from workbench.formats.ply import read_ply
from workbench.formats.surface_files import read_surface, write_surface_ply
from workbench.geometry.mesh import TriangleMesh
from workbench.voxels.dag_encoding import ENCODINGS
from workbench.voxels.lod_levels import thin_part
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import voxelise


@pytest.fixture
def ball(tmp_path, sphere) -> Path:
    """A sphere of radius 1, red to the right and green to the left."""
    mesh = sphere(subdivisions=4)
    color = np.where(mesh.vertices[:, :1] > 0, [[200, 30, 30]], [[30, 160, 30]]).astype(np.uint8)
    write_surface_ply(tmp_path / "ball.ply", mesh.with_attributes(color=color))
    return tmp_path / "ball.ply"


def points_of(path: Path) -> dict[str, np.ndarray]:
    columns = read_ply(path).elements["vertex"].columns
    names = {"xyz": "x y z", "normal": "nx ny nz", "color": "red green blue"}
    return {
        key: np.stack([columns[name] for name in value.split()], axis=1)
        for key, value in names.items()
        if value.split()[0] in columns
    }


@pytest.mark.parametrize("kind", ["voxels", *ENCODINGS])
def test_every_format_gives_back_the_voxels_that_the_surface_touches(cli, tmp_path, ball, kind):
    code, told = cli("lod", ball, "--format", kind, "--resolution", 64, "--out", tmp_path / "out")
    assert code == 0
    assert {"format", "items", "bytes", "bits_per_item", "seconds", "peak_rss_bytes"} <= set(told)
    assert told["format"] == kind
    made = Path(told["file"])
    assert made.suffix == (".vlod" if kind == "voxels" else ".voxgraph")
    assert told["bytes"] == made.stat().st_size
    assert told["bits_per_item"] == pytest.approx(8 * told["bytes"] / told["items"])
    assert told["colors"] == "vertices"

    code, decoded = cli("decode", made, "--out", tmp_path / "points.ply")
    assert code == 0
    assert decoded["items"] == told["items"]
    mesh = read_surface(ball)
    expected = voxelise(mesh, grid_of_mesh(mesh.vertices, 6))
    if kind == "voxels":
        expected = thin_part(expected)
    found = points_of(tmp_path / "points.ply")
    np.testing.assert_allclose(found["xyz"], expected.centers, atol=1e-12)
    np.testing.assert_array_equal(found["color"], expected.color)
    assert ("normal" in found) == (kind == "voxels")
    if kind == "voxels":
        # Stored in steps of 1/511 along each axis.
        assert (np.sum(found["normal"] * expected.normal, axis=1) > 0.9999).all()


def test_the_number_of_threads_changes_no_byte(cli, tmp_path, ball):
    for kind, name in (("voxels", "voxels.vlod"), ("ssvdag", "voxels.voxgraph")):
        for workers in (1, 3):
            given = ("--format", kind, "--resolution", 128, "--workers", workers)
            assert cli("lod", ball, *given, "--out", tmp_path / str(workers))[0] == 0
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "3" / name).read_bytes()


def test_subsets_and_comparison(cli, tmp_path, ball):
    given = ("lod", ball, "--resolution", 64, "--out", tmp_path)
    whole = cli(*given, "--format", "svdag", "--compare")[1]
    thin = cli(*given, "--format", "svdag", "--subset", "thin")[1]
    assert whole["subset"] == "conservative"
    assert 0.4 < thin["items"] / whole["items"] < 0.7
    assert [row["encoding"] for row in whole["encodings"]] == list(ENCODINGS)
    conservative = cli(*given, "--subset", "conservative", "--no-geometry")[1]
    assert conservative["items"] == whole["items"]
    assert conservative["geometry_bytes"] == 0


def test_coarser_levels_are_decoded_by_name(cli, tmp_path, ball):
    told = cli("lod", ball, "--resolution", 512, "--out", tmp_path)[1]
    code, coarse = cli("decode", told["file"], "--level", 8, "--out", tmp_path / "a.ply")
    assert (code, coarse["resolution"]) == (0, 256)
    points = points_of(tmp_path / "a.ply")["xyz"]
    # Each within half the diagonal of a voxel of the sphere.
    assert (np.abs(np.linalg.norm(points, axis=1) - 1) < 0.87 * coarse["voxel_size"] + 1e-3).all()
    code, answer = cli("decode", told["file"], "--level", 3, "--out", tmp_path / "a.ply")
    assert code == 2
    assert answer["error"]["expected"] == "8, 9"


@pytest.mark.parametrize("kind", ["voxels", "ssvdag"])
def test_a_picture_shows_the_ball_where_it_is(cli, tmp_path, ball, kind):
    made = cli("lod", ball, "--format", kind, "--resolution", 128, "--out", tmp_path)[1]["file"]
    given = ("render", made, "--mode", "voxels", "--size", "200x160", "--camera=0,0")
    code, told = cli(*given, "--out", tmp_path / "a.png")
    assert (code, told["mode"], told["width"], told["height"]) == (0, "voxels", 200, 160)
    assert told["seconds"] > 0
    image = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    shown = image[..., 3] > 0
    rows, columns = np.nonzero(shown)
    assert abs(rows.mean() - 79.5) < 1.0
    assert abs(columns.mean() - 99.5) < 1.0
    # The silhouette of a ball of radius 1 from a distance d is tan(asin(1 / d)) wide.
    distance = 0.68 * 2 / np.sin(np.radians(17.5))
    radius = np.tan(np.arcsin(1 / distance)) / np.tan(np.radians(17.5)) * 80
    assert shown.sum() == pytest.approx(np.pi * radius**2, rel=0.04)
    blue, green, red = (image[..., k].astype(int) for k in range(3))
    right = shown & (np.arange(200) > 110)
    left = shown & (np.arange(200) < 90)
    assert (red >= green)[right].all()
    assert (green >= red)[left].all()
    assert cli(*given[:-1], "--camera=180,0", "--out", tmp_path / "b.png")[0] == 0
    behind = cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_UNCHANGED)
    assert (behind[..., 1].astype(int) >= behind[..., 2])[right].all()
    assert blue.max() < 256


def test_bad_wishes_are_told_with_what_can_be_done(cli, tmp_path, ball):
    (tmp_path / "file").write_text("")
    points = tmp_path / "points.ply"
    trimesh.PointCloud(np.eye(3)).export(points)
    flat = tmp_path / "flat.ply"
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    write_surface_ply(flat, TriangleMesh(line, np.array([[0, 1, 2]], np.int32)))
    broken = tmp_path / "nan.ply"
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [np.nan, 1, 0]])
    write_surface_ply(broken, TriangleMesh(corners, np.array([[0, 1, 2]], np.int32)))
    out, small = ("--out", tmp_path / "out"), ("--resolution", 64)
    cases = {
        "did you mean 'ssvdag'": ("lod", ball, "--format", "sssvdag", *out),
        "power of two": ("lod", ball, "--resolution", 100, *out),
        "power of two from": ("lod", ball, "--resolution", 1 << 20, *out),
        "4 voxels a side": ("lod", ball, "--resolution", 2, "--format", "svdag", *out),
        "does not exist": ("lod", tmp_path / "none.ply", *small, *out),
        "neither as a surface": ("lod", tmp_path / "file", *small, *out),
        "cut from a surface": ("lod", points, *small, *out),
        "no triangle with area": ("lod", flat, *small, *out),
        "not finite": ("lod", broken, *small, *out),
        "thin, conservative": ("lod", ball, "--subset", "thick", *out),
        "--compare does not belong": ("lod", ball, "--compare", *out),
        "--shell does not belong": ("lod", ball, "--shell", "--format", "svdag", *out),
        "A folder was expected": ("lod", ball, *small, "--out", tmp_path / "file"),
        "not read as": ("decode", tmp_path / "file", "--out", tmp_path / "a.ply"),
        "a .ply file": ("decode", ball, "--out", tmp_path / "a.obj"),
        "There is no mode": ("render", ball, "--mode", "fog", "--out", tmp_path / "a.png"),
        "--camera 'here'": ("render", ball, "--camera", "here", "--out", tmp_path / "a.png"),
        "--size '0x5'": ("render", ball, "--size", "0x5", "--out", tmp_path / "a.png"),
        "a .png file": ("render", ball, "--out", tmp_path / "none" / "a.png"),
        "workbench lod": ("render", ball, "--out", tmp_path / "a.png"),
        "around the object": (
            "render", ball, "--camera", "photo:a", "--out", tmp_path / "a.png"
        ),
        "name the project": ("render", ball, "--mode", "stitch", "--out", tmp_path / "a.png"),
        "not a project": ("render", tmp_path, "--mode", "stitch", "--out", tmp_path / "a.png"),
    }  # fmt: skip
    for words, arguments in cases.items():
        code, answer = cli(*arguments)
        assert code == 2, arguments
        assert words in " ".join(answer["error"].values()), arguments
        assert answer["error"]["fix"], arguments
    assert not (tmp_path / "a.png").exists()
    assert not list(tmp_path.rglob("*.vlod"))


def test_damaged_files_are_told(cli, tmp_path, ball):
    for kind in ("voxels", "ssvdag"):
        given = ("--format", kind, "--resolution", 64, "--out", tmp_path)
        made = Path(cli("lod", ball, *given)[1]["file"])
        data = bytearray(made.read_bytes())
        data[len(data) // 3] ^= 255
        made.write_bytes(data)
        code, answer = cli("decode", made, "--out", tmp_path / "a.ply")
        assert code == 2
        assert answer["error"]["file"] == str(made)
