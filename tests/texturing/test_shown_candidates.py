"""Candidates of a single mesh against rays, hand-made covers and masks."""

from __future__ import annotations

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, picture, ring, sheet, together
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.shown_candidates import pixels_within, shown_candidates

OPTIONS = CostOptions(far=6.0)


def clear(camera) -> np.ndarray:
    return np.full((camera.height, camera.width, 4), 255, np.uint8)


def by_triangle(found, triangles) -> list[set[int]]:
    return [set(found.labels[found.starts[t] : found.starts[t + 1]]) for t in range(triangles)]


@pytest.fixture(scope="module")
def hidden_ball(sphere):
    """A ball and a smaller one beside it that hides part of it."""
    return together(sphere(0.8, subdivisions=4), sphere(0.25, (0.9, 0.4, 0.5), subdivisions=3))


def test_only_what_rays_reach_is_a_candidate_and_nearly_all_of_it(hidden_ball):
    rays, cameras = SurfaceRays(hidden_ball), ring(5)
    pictures = {k: picture(rays, camera) for k, camera in cameras.items()}
    found = by_triangle(
        shown_candidates(hidden_ball, cameras, pictures.get, OPTIONS), len(hidden_ball.triangles)
    )
    normals, _ = face_normals_and_areas(hidden_ball)
    corners = hidden_ball.vertices[hidden_ball.triangles]
    shares = np.array([[1, 1, 1], [8, 1, 1], [1, 8, 1], [1, 1, 8]]) / [[3], [10], [10], [10]]
    for k, camera in cameras.items():
        reached = np.ones(len(corners), bool)
        for share in shares:
            points = np.einsum("k,tkc->tc", share, corners)
            way = points - camera.center
            distance = np.linalg.norm(way, axis=1)
            met = rays.first_met(camera.center, way / distance[:, None])
            miss = np.linalg.norm(met.points - points, axis=1)
            reached &= met.found & (miss < 0.02)
        way = camera.center - corners.mean(axis=1)
        cosine = (way * normals).sum(axis=1) / np.linalg.norm(way, axis=1)
        chosen = np.array([k in photos for photos in found])
        assert not (chosen & ~(reached & (cosine > 0.0))).any()
        # Only a pixel beside an outline may make a triangle that is seen well no candidate.
        well = reached & (cosine > 0.4)
        assert chosen[well].mean() > 0.93
        assert 0 < chosen.sum() < 0.5 * len(chosen)


def test_a_sheet_before_another_hides_what_its_outline_reaches():
    front = sheet((-0.25, 1.0, -0.25), (0.5, 0, 0), (0, 0, 0.5), 2)
    back = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 16)
    # Their outside is towards −y, where the camera is not: turn them round.
    mesh = together(front, back)
    mesh = TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1].copy())
    camera = camera_at((0, 4, 0), size=(300, 300), focal=400.0, bend=0.0)
    found = shown_candidates(mesh, {0: camera}, lambda _: clear(camera), OPTIONS)
    shown = np.diff(found.starts)[len(front.triangles) :] == 1
    # By similar triangles the front sheet, 3 away, covers ±0.25 · 4 / 3 of the back one; reading
    # beside a triangle reaches one pixel, 1 / 100, further.
    x, z = back.vertices[back.triangles][..., 0], back.vertices[back.triangles][..., 2]
    edge = 0.25 * 4.0 / 3.0
    apart = np.zeros(len(x), bool)
    for values in (x, z):
        apart |= (values.min(axis=1) > edge + 0.03) | (values.max(axis=1) < -edge - 0.03)
    middle = (np.abs(x.mean(axis=1)) < edge) & (np.abs(z.mean(axis=1)) < edge)
    assert shown[apart].all()
    assert not shown[middle].any()
    assert np.diff(found.starts)[: len(front.triangles)].all()


def test_a_masked_pixel_takes_the_triangles_that_may_read_it():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 8)
    camera = camera_at((0, -4, 0), size=(300, 300), focal=400.0, bend=0.0)
    masked = clear(camera)
    masked[140, 167, 3] = 254
    found = shown_candidates(mesh, {0: camera}, lambda _: masked, OPTIONS)
    lost = np.diff(found.starts) == 0
    pixels, _ = camera.project(mesh.vertices[mesh.triangles].reshape(-1, 3))
    pixels = pixels.reshape(-1, 3, 2)
    holds = ((pixels.min(axis=1) < [167.5, 140.5]) & (pixels.max(axis=1) > [167.5, 140.5])).all(1)
    assert lost.sum() == 1
    assert holds[lost].all()


def test_triangles_smaller_than_pixels_are_found_too():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 40)
    camera = camera_at((0, -4, 0), size=(60, 60), focal=50.0, bend=0.0)
    found = shown_candidates(mesh, {3: camera}, lambda _: clear(camera), OPTIONS)
    assert (np.diff(found.starts) == 1).all()
    assert set(found.labels) == {3}


def test_penalties_are_those_of_equation_2():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 4)
    camera = camera_at((1, -4, 0.5), size=(400, 400), focal=400.0)
    found = shown_candidates(mesh, {0: camera}, lambda _: clear(camera), OPTIONS)
    way = camera.center - mesh.vertices[mesh.triangles].mean(axis=1)
    away = np.linalg.norm(way, axis=1)
    expected = away / 6.0 + 2.0 * (1.0 - way @ [0, -1, 0] / away)
    np.testing.assert_allclose(found.penalties, expected, rtol=1e-12)


def test_threads_change_nothing(hidden_ball):
    rays, cameras = SurfaceRays(hidden_ball), ring(4, size=(120, 90), focal=130.0)
    pictures = {k: picture(rays, camera) for k, camera in cameras.items()}
    one = shown_candidates(hidden_ball, cameras, pictures.get, OPTIONS, threads=1)
    four = shown_candidates(hidden_ball, cameras, pictures.get, OPTIONS, threads=4)
    np.testing.assert_array_equal(one.starts, four.starts)
    np.testing.assert_array_equal(one.labels, four.labels)


def test_no_area_no_front_no_picture():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 2)
    flat = TriangleMesh(mesh.vertices, np.array([[0, 1, 2], [0, 0, 1], [0, 1, 4]], np.int32))
    camera = camera_at((0, -4, 0), size=(300, 300), focal=300.0)
    found = shown_candidates(flat, {0: camera}, lambda _: clear(camera), OPTIONS)
    assert np.diff(found.starts).tolist() == [0, 0, 1]
    behind = camera_at((0, 4, 0), size=(300, 300), focal=300.0)
    assert not len(shown_candidates(mesh, {0: behind}, lambda _: clear(camera), OPTIONS).labels)
    away = camera_at((0, -4, 0), target=(0, -8, 0), size=(300, 300), focal=300.0)
    assert not len(shown_candidates(mesh, {0: away}, lambda _: clear(camera), OPTIONS).labels)


def test_a_lens_that_folds_back_shows_nothing_from_outside_the_picture():
    # With this distortion, r (1 − 0.2 r²) turns at r = 1.29: what is far out would come back.
    camera = camera_at((0, -1, 0), size=(200, 200), focal=180.0, bend=-0.2)
    points = np.array([[0.0, 0, 0], [1.9, 0, 0], [0.4, 0, 0.2]])
    folded, _ = camera.project(points)
    assert 0 < folded[1, 0] < 200
    pixels, nearness = pixels_within(points, camera)
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False, True]
    assert nearness.tolist() == [1.0, 0.0, 1.0]


def test_broken_input_is_refused():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 2)
    camera = camera_at((0, -4, 0))
    with pytest.raises(InputError, match="size"):
        shown_candidates(mesh, {0: camera}, lambda _: np.zeros((9, 9, 4), np.uint8), OPTIONS)
    mesh.vertices[3] = np.nan
    with pytest.raises(InputError, match="finite"):
        shown_candidates(mesh, {0: camera}, lambda _: clear(camera), OPTIONS)
