from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from tests.render.stitch.stitch_cases import labelled, pinhole, turned_by, wall
from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import view_of_surface
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import rigid
from workbench.kernels.triangle_raster import draw_front
from workbench.render.camera import orbit_camera
from workbench.render.raycast import render_buffers
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.screen import Screen, photo_camera
from workbench.render.stitch.visibility import visibility


def covered(pixels, triangles, shape):
    """How many of the triangles draw each pixel."""
    count = np.zeros(shape, int)
    depths = np.ones(len(pixels))
    for k in range(len(triangles)):
        depth = np.full(shape, np.inf, np.float32)
        number = np.full(shape, -1, np.int32)
        draw_front(pixels, depths, triangles[k : k + 1], np.array([7], np.int32), depth, number)
        count += number == 7
    return count


@pytest.mark.parametrize("seed", range(3))
def test_pixels_under_a_triangulation_are_drawn_once(seed):
    """No holes and no double pixels, even with corners and edges through pixels' middles."""
    rng = np.random.default_rng(seed)
    shape = (24, 32)
    free = rng.uniform([0, 0], [32, 24], (60, 2))
    on_middles = rng.integers([0, 0], [32, 24], (60, 2)) + 0.5
    points = np.unique(
        np.vstack([free, on_middles, [[-9, -9], [41, -9], [-9, 33], [41, 33]]]), axis=0
    )
    triangles = Delaunay(points).simplices.astype(np.int32)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles[area > 0] = triangles[area > 0][:, [0, 2, 1]]
    assert (covered(points, triangles, shape) == 1).all()


def test_edge_through_middles_belongs_to_the_triangle_at_its_right_or_below():
    corners = np.array([[1.5, 1.5], [4.5, 1.5], [1.5, 4.5], [4.5, 4.5]])
    square = np.array([[0, 2, 1], [1, 2, 3]], np.int32)
    drawn = covered(corners, square, (6, 6))
    expected = np.zeros((6, 6), int)
    expected[1:4, 1:4] = 1
    assert (drawn == expected).all()


def test_faces_that_turn_their_back_or_have_no_area_are_not_drawn():
    mesh = wall()
    flipped = TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1].copy())
    flat = TriangleMesh(mesh.vertices * [1, 0, 1], mesh.triangles)
    for hidden in (flipped, flat):
        seen = visibility(StitchScene.of([labelled(hidden)]), pinhole())
        assert (seen.triangle == -1).all()
        assert (seen.mesh == -1).all()
        assert (seen.label == NO_PHOTO).all()


def test_depth_is_that_of_rays(sphere):
    """Embree is independent; pixels at silhouettes may fall to either side."""
    ball = sphere(0.5, (0.1, 3.0, -0.2), 5)
    camera = orbit_camera(ball.vertices, 30, 20, 160, 120)
    seen = visibility(StitchScene.of([labelled(ball)]), photo_camera(camera))
    rays = render_buffers(ball, camera)
    both = rays.hit & np.isfinite(seen.depth)
    assert (rays.hit != np.isfinite(seen.depth)).sum() <= 4
    assert np.abs(seen.depth[both] - rays.depth[both]).max() < 2e-4
    assert np.mean(seen.triangle[both] == rays.face[both]) > 0.98


def test_a_floor_from_under_the_camera_to_the_horizon_is_cut_not_lost():
    """Two triangles that pass behind the camera, against the ray's own place on the plane."""
    corners = np.array([[-1e3, 1, -1e3], [1e3, 1, -1e3], [-1e3, 1, 1e3], [1e3, 1, 1e3]])
    floor = TriangleMesh(corners, np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    camera = pinhole(64, 48, 40.0)
    depth = visibility(StitchScene.of([labelled(floor)]), camera).depth
    slope = (np.arange(48) + 0.5 - 24) / 40.0
    exact = np.where(slope > 0, 1.0 / np.where(slope > 0, slope, 1.0), np.inf)
    near = exact < 1e3
    # The horizon itself is at 1000: rows above it are empty.
    assert np.isinf(depth[~near]).all()
    assert np.abs(depth[near] / exact[near, None] - 1).max() < 1e-5


def test_the_first_mesh_wins_among_equals_and_the_nearer_otherwise():
    near, far, same = wall(2.0), wall(3.0), wall(2.0)
    scene = StitchScene.of([labelled(far, 5), labelled(near, 6), labelled(same, 7)])
    seen = visibility(scene, pinhole())
    assert (seen.label == 6).all()
    assert (seen.mesh == 1).all()
    assert np.abs(seen.depth - 2.0).max() < 1e-6


def lens(k1=-0.12) -> PhotoCamera:
    params = (130.0, 128.0, 63.0, 50.0, k1, 0.02, 0.004, -0.003)
    return PhotoCamera("OPENCV", 128, 96, params, rigid(turned_by(20), [0.1, 0.0, 0.0]))


def test_photographs_lenses_are_followed(sphere):
    """Against rays through the same lens."""
    ball = sphere(0.7, (0.9, 0.1, 2.0), 5)
    camera = lens()
    seen = visibility(StitchScene.of([labelled(ball)]), camera).depth
    rays = view_of_surface(SurfaceRays(ball), vertex_normals(ball), camera)
    both = rays.seen & np.isfinite(seen)
    assert both.mean() > 0.3
    assert (rays.seen != np.isfinite(seen)).sum() <= 12
    flat = both & ~rays.steps()
    difference = np.abs(seen[flat] - rays.depth[flat])
    assert np.percentile(difference, 99) < 2e-3


def test_what_lies_beside_the_picture_is_not_folded_into_it():
    """With r (1 + k r²), k = −0.35, what is at a slope of 1.7 would be imaged at 0 and beyond."""
    camera = lens(-0.35)
    turn = camera.camera_from_world[:3, :3]
    mesh = wall(1.0, 0.5, 12)
    aside = mesh.vertices + np.array([1.9, 0.0, 0.0])
    moved = TriangleMesh((aside - camera.camera_from_world[:3, 3]) @ turn, mesh.triangles)
    pixels, _ = camera.project(moved.vertices)
    inside = ((pixels > 0) & (pixels < [128, 96])).all(axis=1)
    assert inside.any()
    assert np.isinf(visibility(StitchScene.of([labelled(moved)]), camera).depth).all()


def test_slopes_are_those_of_the_lens():
    camera = lens()
    rows, columns = np.array([0, 40, 95]), np.array([0, 64, 127])
    slopes = Screen(camera).slopes(rows, columns)
    places = np.column_stack([slopes, np.ones(3)]) * 2.5
    world = (places - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]
    pixels, _ = camera.project(world)
    assert np.abs(pixels - np.column_stack([columns, rows]) - 0.5).max() < 1e-6


def test_bad_scenes_say_so():
    mesh = wall()
    broken = TriangleMesh(np.where(mesh.vertices == 2.0, np.nan, mesh.vertices), mesh.triangles)
    with pytest.raises(InputError, match="not finite"):
        StitchScene.of([labelled(broken)])
    with pytest.raises(InputError, match="NaN"):
        StitchScene.of([labelled(mesh, penalties=np.nan)])
    with pytest.raises(InputError, match="distance"):
        StitchScene.of([labelled(mesh)], epsilon=-1.0)
    with pytest.raises(InputError, match="distance"):
        StitchScene.of([labelled(mesh)], epsilon=float("nan"))


def test_no_mesh_and_no_triangle_show_nothing():
    empty = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    for meshes in ([], [labelled(empty)]):
        seen = visibility(StitchScene.of(meshes), pinhole())
        assert np.isinf(seen.depth).all()


def test_behind_the_camera_nothing_is_seen():
    assert np.isinf(visibility(StitchScene.of([labelled(wall(-2.0))]), pinhole()).depth).all()
