"""Depths of surfaces and of samples, and what lies on them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, sheet, together
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.depth_map import (
    DepthMap,
    depth_map_of_samples,
    depth_map_of_surface,
    small_camera,
    usable_pixels,
)
from workbench.texturing.depth_mesh import depth_mesh

FACING = {"along": (2, 0, 0), "up": (0, 0, 2)}


def everywhere(camera):
    return np.ones((camera.height, camera.width), bool)


def map_of(mesh, camera, closed=True):
    return depth_map_of_surface(SurfaceRays(mesh), camera, everywhere(camera), closed)


@dataclass(frozen=True)
class Samples:
    """Some samples as a block."""

    points: np.ndarray
    normals: np.ndarray
    spacing: np.ndarray
    first: int = 0


def test_a_small_camera_keeps_the_aspect():
    camera = camera_at((0, -3, 0), size=(3000, 2000), focal=2500.0)
    small = small_camera(camera, 256)
    assert (small.width, small.height) == (256, 171)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    scale = np.array([256 / 3000, 171 / 2000])
    np.testing.assert_allclose(
        small.project(points)[0], camera.project(points)[0] * scale, atol=0.1
    )
    assert small_camera(camera, 9999).width == 3000
    with pytest.raises(InputError, match="two pixels"):
        small_camera(camera, 2)


def test_a_pixel_is_usable_where_all_of_it_is():
    camera = camera_at((0, -3, 0), size=(12, 9))
    alpha = np.full((90, 120), 255, np.uint8)
    alpha[30, 47] = 0
    alpha[44:46, 80] = 128
    usable = usable_pixels(alpha, camera)
    assert np.argwhere(~usable).tolist() == [[3, 4], [4, 8]]


def test_places_lie_on_the_surface(sphere):
    ball = sphere(1.0, (5e5, 4e6, 100.0), 5)
    camera = camera_at((5e5, 4e6 - 3, 100.0), (5e5, 4e6, 100.0))
    found = map_of(ball, camera)
    made = depth_mesh(found)
    away = np.linalg.norm(made.mesh.vertices - [5e5, 4e6, 100.0], axis=1)
    # The ball's triangles are up to 0.0005 below it; float32 depths of 3 m add 2e-7.
    # Vertices are moved outwards by what triangles between them lie within.
    assert 0.9993 < away.min() <= away.max() < 1.002
    pixels, depths = camera.project(made.mesh.vertices)
    row, column = np.divmod(made.pixels, camera.width)
    np.testing.assert_allclose(pixels, np.column_stack([column, row]) + 0.5, atol=1e-6)
    np.testing.assert_allclose(depths, found.fitted[row, column], rtol=1e-9)
    assert found.shows(made.mesh.vertices).mean() > 0.98


def test_stored_and_read_again_it_is_the_same(sphere):
    camera = camera_at((0, -3, 0), size=(1200, 900), focal=1300.0)
    usable = np.random.default_rng(0).random((171, 228)) < 0.9
    small = small_camera(camera, 228)
    one = depth_map_of_surface(SurfaceRays(sphere()), small, usable, True)
    one = replace(one, flatness_px=0.5)
    again = DepthMap.from_arrays(camera, one.arrays())
    earlier = {name: array for name, array in one.arrays().items() if name != "flatness_px"}
    assert DepthMap.from_arrays(camera, earlier).flatness_px == 0.0
    assert (again.usable == usable).all()
    assert again.closed
    assert depth_mesh(again).mesh.vertices.tobytes() == depth_mesh(one).mesh.vertices.tobytes()
    assert (depth_mesh(again).mesh.triangles == depth_mesh(one).mesh.triangles).all()


def test_what_lies_behind_or_is_unusable_is_not_shown():
    near = sheet((-0.5, -1, -1), (0.5, 0, 0), (0, 0, 2), 4)
    far = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 8)
    camera = camera_at((0, -3, 0))
    seen = map_of(together(near, far), camera)
    points = np.array([[-0.25, -1, 0], [-0.25, 0, 0], [0.5, 0, 0], [0.5, 0.2, 0], [0.5, -4, 0]])
    assert seen.shows(points).tolist() == [True, False, True, False, False]
    half = everywhere(camera)
    half[:, camera.width // 2 :] = False
    masked = DepthMap(camera, seen.depth, half, True)
    assert masked.shows(points).tolist() == [True, False, False, False, False]


def test_what_a_bent_lens_folds_back_is_not_shown():
    """Far off the axis the model brings points back into the picture, onto the sheet it shows."""
    camera = camera_at((0, -3, 0), bend=-0.35)
    mesh = sheet((-9, 0, -9), (18, 0, 0), (0, 0, 18), 2)
    far_off = np.array([[x, 0.0, 0.0] for x in np.linspace(3.2, 8.9, 200)])
    pixels, depths = camera.project(far_off)
    folded = (np.abs(pixels - [120, 90]) < [118, 88]).all(axis=1)
    assert folded.sum() > 3
    assert np.allclose(depths, 3.0)
    assert not map_of(mesh, camera).shows(far_off[folded]).any()


@pytest.mark.parametrize("turn", [0.0, 60.0, 78.0])
def test_a_slanted_sheet_is_whole(turn):
    a = np.radians(turn)
    along = 2 * np.array([np.cos(a), np.sin(a), 0.0])
    mesh = sheet(-0.5 * along - [0, 0, 1], along, (0, 0, 2), 3)
    made = depth_mesh(map_of(mesh, camera_at((0, -4, 0))))
    _, areas = face_normals_and_areas(made.mesh)
    # But for what lies between the outermost pixels and the sheet's edge, up to a pixel a side.
    lost = 2 * (4.3 / 260) / (2 * np.cos(a)) + 2 * (4.3 / 260) / 2
    assert 4.0 * (1.0 - 1.5 * lost) < areas.sum() <= 4.0


def test_samples_are_drawn_in_their_own_planes():
    """Depths of a slanted sheet's samples are exact, though discs are wider than pixels."""
    mesh = sheet((-1, -1, -1), (2, 2, 0), (0, 0, 2), 60)
    normals = np.tile(np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), (len(mesh.vertices), 1))
    block = Samples(mesh.vertices, normals, np.full(len(normals), 2.83 / 60))
    camera = camera_at((0, -4, 0))
    drawn = depth_map_of_samples(lambda: [block], camera, everywhere(camera))
    cast = map_of(mesh, camera)
    both = np.isfinite(drawn.depth) & np.isfinite(cast.depth)
    assert both.sum() == np.isfinite(cast.depth).sum()
    np.testing.assert_allclose(drawn.depth[both], cast.depth[both], rtol=1e-5)


def test_noise_of_samples_is_averaged_and_what_is_behind_is_not_mixed_in():
    rng = np.random.default_rng(0)
    noise, step = 0.004, 2 / 60
    near, far = (
        sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 60),
        sheet((-1, 1, -1), (2, 0, 0), (0, 0, 2), 60),
    )
    points = np.concatenate([near.vertices, far.vertices])
    points[:, 1] += rng.normal(0, noise, len(points))
    normals = np.tile([0.0, -1.0, 0.0], (len(points), 1))
    spacing = np.full(len(points), step)
    camera = camera_at((0, -4, 0), bend=0.0)
    whole = [Samples(points, normals, spacing)]
    drawn = depth_map_of_samples(lambda: whole, camera, everywhere(camera))
    inside = np.abs(camera.project(near.vertices)[0] - [120, 90]).max(axis=0) - 3
    middle = drawn.depth[
        int(90 - inside[1]) : int(90 + inside[1]), int(120 - inside[0]) : int(120 + inside[0])
    ]
    # Several discs cover a pixel: their mean is nearer to the truth than each. None of the sheet
    # behind, a metre further, may be in it; nor is it biased to the front, as the nearest would be.
    error = middle - 4.0
    assert np.abs(error).max() < 5 * noise
    assert error.std() < 0.8 * noise
    assert abs(error.mean()) < 0.2 * noise
    parts = [Samples(points[k::3], normals[k::3], spacing[k::3]) for k in range(3)]
    again = depth_map_of_samples(lambda: parts, camera, everywhere(camera))
    np.testing.assert_allclose(again.depth, drawn.depth, rtol=1e-6)


def test_samples_that_turn_their_backs_or_are_sparse():
    camera = camera_at((0, -4, 0))
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [np.nan, 0, 0], [0, -9, 0]])
    normals = np.array([[0.0, -1, 0], [0, 1, 0], [0, -1, 0], [0, -1, 0]])
    block = Samples(points, normals, np.full(4, 1e-4))
    drawn = depth_map_of_samples(lambda: [block], camera, everywhere(camera))
    # Far smaller than a pixel, and yet drawn where it lies, as deep as it is.
    assert np.argwhere(np.isfinite(drawn.depth)).tolist() == [[90, 120]]
    assert drawn.depth[90, 120] == pytest.approx(4.0, rel=1e-5)


def test_a_map_of_another_size_is_refused():
    camera = camera_at((0, -4, 0))
    with pytest.raises(InputError, match="size"):
        DepthMap(camera, np.zeros((3, 3), np.float32), everywhere(camera), True)


def test_fitted_vertices_halve_the_error_between_them(sphere):
    """Chords lie within a ball; vertices moved outwards leave as much beyond it as within."""
    found = map_of(sphere(1.0, subdivisions=7), camera_at((0.0, -3.0, 0.0), (0.0, 0.0, 0.0)))
    mesh = depth_mesh(found).mesh
    plain = TriangleMesh(found.places(depth_mesh(found).pixels), mesh.triangles)
    off = {}
    for name, made in (("plain", plain), ("fitted", mesh)):
        corners = made.vertices[made.triangles]
        facing = corners.mean(axis=1)[:, 1] < -0.5
        shares = np.random.default_rng(0).dirichlet(np.ones(3), 40)
        places = np.einsum("sk,mkj->smj", shares, corners[facing])
        off[name] = np.linalg.norm(places, axis=2) - 1.0
    assert off["plain"].mean() < -0.9 * np.abs(off["plain"]).mean()
    assert abs(off["fitted"].mean()) < 0.2 * abs(off["plain"].mean())
    rms = {name: float(np.sqrt((values**2).mean())) for name, values in off.items()}
    assert rms["fitted"] < 0.55 * rms["plain"]
