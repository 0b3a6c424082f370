"""Depth, normals, steps, visibility and shadows of one photograph."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tests.color.blending_scene import DISTANCE, FLASH, RADIUS, ball, camera_at
from workbench.color.blending_samples import blocks_of_mesh
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import (
    PlainBlock,
    lit_by_flash,
    reduced_camera,
    view_of_samples,
    view_of_surface,
)
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.photo_buffers import between_pixels, interpolated_normals, splat
from workbench.masking.flash_shadow import flash_shadows_by_geometry


def view_of(mesh, camera):
    normals = np.concatenate([block.normals for block in blocks_of_mesh(mesh)])
    return view_of_surface(SurfaceRays(mesh), normals, camera)


def plate(middle, normal, side, cells=40):
    """A square plate as a mesh."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    steps = np.linspace(-0.5, 0.5, cells + 1) * side
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    vertices = np.asarray(middle) + u[:, None] * across + v[:, None] * up
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    right, above = corner + cells + 1, corner + 1
    # Wound so that the triangles face along the normal.
    triangles = np.concatenate(
        [np.stack([corner, right, above], 1), np.stack([above, right, right + 1], 1)]
    ).astype(np.int32)
    return TriangleMesh(vertices, triangles)


def joined(*meshes):
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return TriangleMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.triangles + s for m, s in zip(meshes, starts, strict=False)]).astype(
            np.int32
        ),
    )


PINHOLE = PhotoCamera("PINHOLE", 200, 160, (300.0, 300.0, 100.0, 80.0), np.eye(4))


def test_depth_and_normals_are_those_of_the_ball():
    camera = camera_at(0.7)
    view = view_of(ball(5), camera)
    pixels = np.argwhere(view.seen)[:, ::-1] + 0.5
    ways = camera.directions(pixels) @ camera.camera_from_world[:3, :3].T
    middle = camera.camera_from_world[:3, 3]
    along = ways @ middle
    under = along**2 - (middle @ middle - RADIUS**2)
    clear = under > (0.3 * RADIUS) ** 2
    depth = ((along - np.sqrt(np.maximum(under, 0.0))) * ways[:, 2])[clear]
    # Facets with edges of R / 25 lie R / 5000 below the ball, seen at a slant a thousandth.
    assert np.abs(view.depth[view.seen][clear] - depth).max() < 1e-3 * RADIUS
    places = ways[clear] * (depth / ways[clear, 2])[:, None]
    cosine = (view.normals[view.seen][clear] * (places - middle) / RADIUS).sum(axis=1)
    assert np.degrees(np.arccos(np.minimum(cosine, 1.0))).max() < 0.5
    expected = -(view.normals[view.seen][clear] * ways[clear]).sum(axis=1)
    assert view.cosines[view.seen][clear] == pytest.approx(expected, abs=1e-5)


def test_places_are_where_the_rays_end():
    view = view_of(ball(4), camera_at(2.0))
    rows = slice(100, 120)
    places = view.places(rows)
    assert np.isnan(places).any(axis=2).tolist() == (~view.seen[rows]).tolist()
    apart = np.linalg.norm(places[view.seen[rows]] - view.camera.camera_from_world[:3, 3], axis=1)
    assert apart == pytest.approx(RADIUS, rel=5e-3)


def test_far_from_the_origin_the_view_is_the_same():
    near, far = (
        view_of(ball(4, m), camera_at(0.7, middle=m)) for m in (np.zeros(3), (4e5, 5e6, 0))
    )
    assert (near.seen == far.seen).mean() > 0.9999
    both = near.seen & far.seen
    assert np.abs(near.depth[both] - far.depth[both]).max() < 1e-5


def test_steps_are_found_at_edges_and_not_on_slopes():
    wall = plate([0.0, 0.0, 2.0], [0.7, 0.3, -1.0], 4.0)
    assert not view_of(wall, PINHOLE).steps()[2:-2, 2:-2].any()
    front = plate([-0.2, 0.0, 1.0], [0.0, 0.0, -1.0], 0.4)
    view = view_of(joined(wall, front), PINHOLE)
    nearer = view.depth < 1.05
    border = nearer & ~np.roll(nearer, -1, axis=1)
    assert border.sum() > 50
    assert view.steps()[border].all()
    assert view.steps().sum() < 0.03 * view.depth.size


def test_what_stands_behind_is_not_seen():
    wall = plate([0.0, 0.0, 2.0], [0.0, 0.0, -1.0], 1.0)
    front = plate([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], 0.2)
    view = view_of(joined(wall, front), PINHOLE)
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 1.0], [0.4, 0.0, 2.0], [0.0, 0.0, -1.0]])
    seen = view.which_are_seen(*PINHOLE.project(points))
    assert seen.tolist() == [False, True, True, False]
    # The ball's far half hides behind the near one.
    mesh, camera = ball(5), camera_at(1.0)
    seen = view_of(mesh, camera).which_are_seen(*camera.project(mesh.vertices))
    towards = camera.center - mesh.vertices
    facing = (mesh.vertex_attributes["normal"] * towards).sum(1) / np.linalg.norm(towards, axis=1)
    assert not seen[facing < -0.15].any()
    assert seen[facing > 0.1].all()


def test_shadows_agree_with_those_by_four_rays_a_pixel():
    wall = plate([0.0, 0.0, 2.0], [0.0, 0.0, -1.0], 3.0)
    front = plate([0.05, 0.0, 1.2], [0.0, 0.0, -1.0], 0.25)
    mesh, flash = joined(wall, front), np.array([-0.3, -0.1, 0.0])
    view = view_of(mesh, PINHOLE)
    lit = lit_by_flash(view, SurfaceRays(mesh), flash)
    expected = ~flash_shadows_by_geometry(mesh, PINHOLE, flash)
    assert (lit == expected).mean() > 0.99
    assert 0.01 < (~lit).mean() < 0.2
    # And with where the shadow falls: its edge is the plate's, seen from the flash.
    left = flash[0] + (0.05 - 0.125 - flash[0]) * 2.0 / 1.2
    right = flash[0] + (0.05 + 0.125 - flash[0]) * 2.0 / 1.2
    dark = np.flatnonzero(~lit[80]) + 0.5
    hidden_by_plate = 100.0 + 300.0 * 0.175 / 1.2
    assert dark.max() == pytest.approx(100.0 + 300.0 * right / 2.0, abs=1.0)
    assert dark.min() == pytest.approx(max(100.0 + 300.0 * left / 2.0, hidden_by_plate), abs=1.0)
    with pytest.raises(InputError, match="flash"):
        lit_by_flash(view, SurfaceRays(mesh), np.array([0.0, np.nan, 0.0]))


def test_samples_without_a_surface_show_what_the_surface_shows():
    mesh, camera = ball(6), camera_at(0.4)
    surface = view_of(mesh, camera)
    blocks = blocks_of_mesh(mesh)
    samples = view_of_samples(blocks, camera)
    assert (surface.seen & samples.seen).sum() / (surface.seen | samples.seen).sum() > 0.96
    both = surface.seen & samples.seen & (surface.cosines > 0.3)
    assert np.abs(surface.depth[both] - samples.depth[both]).max() < 0.05 * RADIUS
    cosine = (surface.normals * samples.normals).sum(axis=2)[both]
    assert np.degrees(np.arccos(np.minimum(cosine, 1.0))).max() < 3.0
    # In parts and in one: the same to the last bit.
    whole = blocks[0]
    halves = [
        PlainBlock(f, whole.points[p], whole.normals[p], whole.spacing[p])
        for f, p in ((0, slice(0, 9000)), (9000, slice(9000, None)))
    ]
    assert np.array_equal(view_of_samples(halves, camera).depth, samples.depth)
    # Every vertex the surface shows clearly is seen in the samples' view, too.
    pixels, depths = camera.project(mesh.vertices)
    clear = surface.which_are_seen(pixels, depths)
    towards = camera.center - mesh.vertices
    facing = (mesh.vertex_attributes["normal"] * towards).sum(1) / np.linalg.norm(towards, axis=1)
    assert samples.which_are_seen(pixels, depths)[clear & (facing > 0.3)].mean() > 0.999
    assert not samples.which_are_seen(pixels, depths)[facing < -0.15].any()


def test_smoothing_takes_out_noise_and_leaves_the_background():
    view = view_of(ball(5), camera_at(0.2))
    smooth = view.smoothed(5)
    assert np.linalg.norm(smooth.normals, axis=2)[view.seen] == pytest.approx(1.0, abs=1e-5)
    assert not smooth.normals[~view.seen].any()
    assert view.smoothed(1) is view


def test_a_reduced_camera_sees_the_same_places():
    camera = camera_at(0.9)
    small = reduced_camera(camera, 120, 120)
    points = ball(2).vertices
    assert small.project(points)[0] == pytest.approx(camera.project(points)[0] / 2.0, abs=1e-9)
    assert reduced_camera(camera, camera.width, camera.height) is camera


def test_between_pixels_is_linear():
    rng = np.random.default_rng(3)
    picture = rng.random((13, 17, 2)).astype(np.float32)
    pixels = rng.uniform(-2, 20, (500, 2))
    pixels[0] = np.nan
    found = between_pixels(picture, pixels)
    assert np.isnan(found[0]).all()
    for k in range(2):
        expected = map_coordinates(
            picture[..., k].astype(float), (pixels[1:, ::-1] - 0.5).T, order=1, mode="nearest"
        )
        assert found[1:, k] == pytest.approx(expected, abs=1e-6)


def test_normals_blend_by_the_place_in_the_triangle():
    rng = np.random.default_rng(4)
    vertices, normals = rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    triangles = np.array([[0, 1, 2], [3, 4, 5], [0, 0, 0]], np.int32)
    which = rng.integers(0, 2, 50)
    share = rng.dirichlet(np.ones(3), 50)
    points = np.einsum("nc,ncd->nd", share, vertices[triangles[which]])
    expected = np.einsum("nc,ncd->nd", share, normals[triangles[which]])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    found = interpolated_normals(points, which.astype(np.int64), vertices, triangles, normals)
    assert found == pytest.approx(expected, abs=1e-5)
    odd = interpolated_normals(points[:2], np.array([-1, 2]), vertices, triangles, normals)
    assert not odd[0].any()
    assert np.isfinite(odd).all()


def test_the_nearest_disc_wins_and_odd_samples_draw_nothing():
    depth = np.full((20, 20), np.inf, np.float32)
    normal = np.zeros((20, 20, 3), np.float32)
    pixels = np.array([[10.0, 10.0], [10.2, 10.0], [np.nan, 3.0], [-50.0, 5.0], [3.5, 3.5]])
    depths = np.array([2.0, 1.0, 1.0, 1.0, 3.0])
    normals = np.eye(3)[[0, 1, 2, 2, 2]].astype(float)
    splat(pixels, depths, np.array([4.0, 2.0, 5.0, 5.0, 0.0]), normals, depth, normal)
    rows, columns = np.mgrid[:20, :20] + 0.5
    near = np.hypot(columns - 10.2, rows - 10.0) <= 2.0
    far = (np.hypot(columns - 10.0, rows - 10.0) <= 4.0) & ~near
    assert (depth[near] == 1.0).all()
    assert (depth[far] == 2.0).all()
    assert depth[3, 3] == 3.0  # a disc of no size still has its own pixel
    assert np.isfinite(depth).sum() == near.sum() + far.sum() + 1
    assert FLASH.reference_distance == DISTANCE
