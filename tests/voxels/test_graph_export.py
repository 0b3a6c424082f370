"""From voxels to files and pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from workbench.errors import InputError, WorkbenchError
from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.morton import morton_codes
from workbench.voxels import graph_export
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_encoding import ENCODINGS
from workbench.voxels.dag_file import read_voxel_graph
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.graph_export import export_voxel_graph
from workbench.voxels.graph_pictures import (
    PictureOptions,
    camera_around,
    picture,
    write_graph_picture,
)
from workbench.voxels.published_encodings import PUBLISHED
from workbench.voxels.screen_normals import screen_normals
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh
from workbench.voxels.voxelisation import voxel_parts, voxelise


@pytest.fixture
def ball(sphere) -> TriangleMesh:
    """A sphere of radius 1, red to the right and green to the left."""
    mesh = sphere(subdivisions=5)
    color = np.where(mesh.vertices[:, :1] > 0, [[200, 30, 30]], [[30, 160, 30]]).astype(np.uint8)
    return mesh.with_attributes(color=color)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_file_holds_the_voxels_and_their_colours(tmp_path, ball, encoding):
    grid = grid_of_mesh(ball.vertices, 6)
    voxels = voxelise(ball, grid)
    summary = export_voxel_graph([voxels], grid, tmp_path / "ball", encoding=encoding)
    found = read_voxel_graph(tmp_path / "ball")
    assert np.array_equal(DagWalk(dag_of(found.graph)).codes(), voxels.codes)
    assert np.array_equal(found.colors.all(), voxels.color)
    assert summary["lossless"]
    assert summary["voxels"] == len(voxels)
    assert summary["file_bytes"] == (tmp_path / "ball").stat().st_size
    assert summary["bits_per_voxel"] == 8 * summary["graph_bytes"] / len(voxels)


def test_parts_and_whole_give_the_same_file(tmp_path, ball):
    grid = grid_of_mesh(ball.vertices, 7)
    export_voxel_graph([voxelise(ball, grid)], grid, tmp_path / "whole")
    parts = list(voxel_parts(ball, grid, part_level=5))
    assert len(parts) > 10
    export_voxel_graph(parts, grid, tmp_path / "parts", part_level=5, at_once=500)
    assert (tmp_path / "whole").read_bytes() == (tmp_path / "parts").read_bytes()


def test_a_ball_is_told_by_its_octant(tmp_path, ball):
    """Eight mirrored octants: far fewer nodes than without mirrors, and the table says so."""
    grid = grid_of_mesh(ball.vertices, 7)
    summary = export_voxel_graph(voxel_parts(ball, grid), grid, tmp_path / "a", compare=True)
    by_name = {row["encoding"]: row for row in summary["encodings"]}
    assert list(by_name) == list(ENCODINGS)
    assert by_name["ssvdag"]["nodes"] < 0.4 * by_name["svdag"]["nodes"]
    assert by_name["ssvdag"]["bytes"] < by_name["esvdag"]["bytes"] < by_name["svdag"]["bytes"]
    assert by_name["ssvdag"]["bytes"] < by_name["ussvdag"]["bytes"] < by_name["svdag"]["bytes"]
    assert by_name["osvdag"]["nodes"] < 0.4 * by_name["ssvdag"]["nodes"]
    assert by_name["svo"]["nodes"] == summary["octree_nodes"]
    assert by_name["ssvdag"]["bytes"] == summary["graph_bytes"]


def test_the_papers_figures_are_those_of_its_table_5_2():
    lucy, david = PUBLISHED
    for model, encoding, bits in (
        (lucy, "ssvdag", 0.852),
        (lucy, "svdag", 1.608),
        (lucy, "svo", 2.666),
        (david, "ussvdag", 1.459),
        (david, "esvdag", 1.393),
    ):
        assert model.bits_per_voxel(encoding, 16) == pytest.approx(bits, abs=6e-4)
    assert lucy.bits_per_voxel("ssvdag", 10) is None


def test_a_graph_that_lost_a_voxel_is_not_written(tmp_path, ball, monkeypatch):
    grid = grid_of_mesh(ball.vertices, 5)
    real = graph_export.symmetric_dag
    lossy = graph_export.reduced_parts([voxelise(ball, grid).codes[1:]], 5, 0)
    monkeypatch.setattr(graph_export, "symmetric_dag", lambda dag, order: real(lossy, order))
    with pytest.raises(WorkbenchError, match="give back"):
        export_voxel_graph([voxelise(ball, grid)], grid, tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_nothing_at_all_can_be_written_and_shown(tmp_path):
    grid = VoxelGrid(np.zeros(3), 1.0, 5)
    assert export_voxel_graph([], grid, tmp_path / "a", compare=True)["voxels"] == 0
    found = read_voxel_graph(tmp_path / "a")
    assert (picture(found, camera_around(grid, 32, 24))[..., 3] == 0).all()


def test_a_picture_shows_the_ball_in_its_colours(tmp_path, ball):
    grid = grid_of_mesh(ball.vertices, 7)
    export_voxel_graph(voxel_parts(ball, grid), grid, tmp_path / "ball")
    camera = camera_around(grid, 160, 120, azimuth=0.0, elevation=0.0)
    write_graph_picture(
        tmp_path / "ball",
        tmp_path / "ball.png",
        camera=camera,
        options=PictureOptions(light=(0.0, 0.0, -1.0)),
    )
    image = cv2.imread(str(tmp_path / "ball.png"), cv2.IMREAD_UNCHANGED)
    assert image.shape == (120, 160, 4)
    inside = image[..., 3] == 255
    # The outline of a unit sphere seen from its distance d has the radius f / sqrt(d² − 1).
    away = np.linalg.norm(camera.center)
    radius = camera.params[0] / np.sqrt(away**2 - 1)
    assert np.sqrt(inside.sum() / np.pi) == pytest.approx(radius, abs=1.2)
    blue, green, red = (image[55:65, :, k].astype(int) for k in range(3))
    left, right = slice(55, 75), slice(85, 105)
    assert (green[:, left] > red[:, left] + 60).all()
    assert (red[:, right] > green[:, right] + 60).all()
    assert (blue[:, left] < 60).all()
    # Lit along the optical axis: a quarter from all around, the rest by the cosine.
    for column in (74, 60, 44):
        ray = camera.directions(np.array([[column + 0.5, 60.0]]))[0]
        along = -camera.center @ ray
        normal = camera.center + ray * (along - np.sqrt(along**2 - away**2 + 1))
        light = 0.25 + 0.75 * normal[2]
        assert green[:, column].mean() == pytest.approx(160 * light ** (1 / 2.2), abs=5)


def test_shadows_fall_where_the_light_does_not_reach():
    side = 64
    floor = np.zeros((side, side, side), bool)
    floor[:, 8, :] = True
    floor[24:40, 40, 24:40] = True
    grid = VoxelGrid(np.zeros(3), 1.0, 6)
    codes = np.sort(morton_codes(np.argwhere(floor)))
    graph = graph_export.encoded(graph_export.reduced_parts([codes], 6, 0), "svdag")
    voxels = graph_export.VoxelGraph(graph, grid)
    camera = camera_around(grid, 240, 240, azimuth=0.0, elevation=50.0)
    straight_down = camera.camera_from_world[:3, :3] @ [0.0, 1.0, 0.0]
    with_shadow, without = (
        picture(voxels, camera, PictureOptions(shadows=s, light=tuple(straight_down)))
        for s in (True, False)
    )

    def at(point):
        x, y = camera.project(np.array([point]))[0][0]
        return int(y), int(x)

    below, beside = at([0.5, 9 / 64, 0.55]), at([0.15, 9 / 64, 0.85])
    assert with_shadow[below][0] < 0.7 * without[below][0]
    assert with_shadow[beside][0] == without[beside][0]


def test_normals_of_a_slanted_plane_and_none_across_an_edge():
    y, x = np.mgrid[0:60, 0:80]
    rays = np.stack([(x - 40) / 100, (y - 30) / 100, np.ones(x.shape)], axis=-1)
    normal = np.array([0.3, -0.4, -0.8])
    normal /= np.linalg.norm(normal)
    depths = 5.0 * normal[2] / (rays @ normal)
    depths[:, 50:] += 30.0
    depths[:5] = np.inf
    found = screen_normals(depths, rays, np.full(x.shape, 0.05), 0.01)
    assert np.isnan(found[:5]).all()
    assert (np.abs(found[5:, :50] @ normal - 1.0) < 1e-6).all()
    shifted = screen_normals(depths[:, 50:], rays[:, 50:], np.full((60, 30), 0.05), 0.01)
    np.testing.assert_allclose(found[5:, 50:], shifted[5:], atol=1e-9)


def test_a_camera_needs_one_of_two_axes():
    with pytest.raises(InputError, match="Up"):
        camera_around(VoxelGrid(np.zeros(3), 1.0, 5), up="x")


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_camera_stands_upright_and_looks_at_the_middle(up):
    grid = VoxelGrid(np.array([1.0, 2.0, 3.0]), 4.0, 5)
    camera = camera_around(grid, 200, 100, azimuth=70.0, elevation=30.0, up=up)
    rotation = camera.camera_from_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(camera.project(grid.center[None])[0], [[100.0, 50.0]], atol=1e-9)
    above = grid.center + np.eye(3)["xyz".index(up)]
    pixel = camera.project(above[None])[0][0]
    assert pixel[0] == pytest.approx(100.0)
    assert pixel[1] < 50.0
    rise = (camera.center - grid.center)["xyz".index(up)]
    assert rise == pytest.approx(0.5 * np.linalg.norm(camera.center - grid.center))
