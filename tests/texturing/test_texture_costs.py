"""Problems made of meshes and pictures hold eq. 1–5."""

from collections import Counter

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, picture, ring, sheet
from tests.texturing.test_candidates import maps_of
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.candidates import candidates_of
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.expansion import expanded
from workbench.texturing.labelling import FULL_COLOR
from workbench.texturing.texture_costs import side_by_side, texture_problem

LARGE = {"size": (960, 720), "focal": 1040.0}


def ramp(width=960, height=720):
    """Red rises to the right, green downwards, one step every fourth pixel, smooth between."""
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    zero = np.zeros_like(row)
    out = np.stack([column / 4.0, row / 4.0, zero + 40.0, zero + 255.0], axis=-1)
    return np.round(out).astype(np.uint8)


def test_triangles_side_by_side():
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    pairs, ends = side_by_side(tetrahedron)
    assert pairs.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert ends.tolist() == [[0, 1], [1, 2], [0, 2], [1, 3], [0, 3], [2, 3]]
    # Three leaves of a book: each is beside the next. A folded triangle is not beside itself.
    book = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [5, 6, 5]], np.int32)
    pairs, ends = side_by_side(book)
    assert pairs.tolist() == [[0, 1], [1, 2]]
    assert ends.tolist() == [[0, 1], [0, 1]]
    assert side_by_side(np.zeros((0, 3), np.int32))[0].shape == (0, 2)


def test_data_costs_are_penalties_times_areas():
    mesh = sheet((-0.5, 0, -0.5), (1, 0, 0), (0, 0, 2), 3)
    cameras = {0: camera_at((0, -4, 0)), 1: camera_at((1, -3, 0))}
    options = CostOptions(8.0)
    found = candidates_of(mesh, maps_of(mesh, cameras), options)
    problem = texture_problem(mesh, cameras, found, lambda _: ramp(240, 180), options)
    np.testing.assert_allclose(problem.costs, found.penalties * (2.0 / 18.0), rtol=1e-12)


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_colors_are_read_along_edges_in_the_world(samples):
    """Long, slanted edges under a bent lens, against the projection of every place itself."""
    mesh = sheet((-0.6, -0.6, -0.6), (1.2, 1.2, 0), (0, 0, 1.2), 12)
    cameras = {0: camera_at((0.3, -4, 0.2), **LARGE), 1: camera_at((1, -3, -0.4), **LARGE)}
    options = CostOptions(8.0, edge_samples=samples)
    found = candidates_of(mesh, maps_of(mesh, cameras), options)
    problem = texture_problem(mesh, cameras, found, lambda _: ramp(), options)
    edges, ends = side_by_side(mesh.triangles)
    assert (problem.edges == edges).all()
    a, b = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]]
    np.testing.assert_allclose(problem.edge_lengths, np.linalg.norm(b - a, axis=1))
    checked = 0
    for e in range(len(edges)):
        for row in range(problem.edge_starts[e], problem.edge_starts[e + 1]):
            share = ((np.arange(samples) + 0.5) / samples)[:, None]
            places = (1 - share) * a[e] + share * b[e]
            pixels, _ = cameras[int(problem.edge_labels[row])].project(places)
            colors = problem.edge_colors[row] / FULL_COLOR * 255
            # The ramp itself is rounded to whole steps, half a step off at the most.
            np.testing.assert_allclose(colors[:, :2], pixels / 4.0, atol=0.55)
            np.testing.assert_allclose(colors[:, 2], 40.0, atol=0.01)
            checked += 1
    assert checked > 500


def test_colors_lie_between_pixels():
    """At a quarter of the way from one pixel's middle to the next, a quarter of the difference."""
    whole = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 1)
    mesh = sheet((-0.3, 0, -0.3), (0.6, 0, 0), (0, 0, 0.6), 1)
    camera = camera_at((0, -4, 0), size=(241, 181), bend=0.0, focal=260.0)
    # The only inner edge's middle is at the picture's own middle plus a quarter of a pixel.
    moved = TriangleMesh(mesh.vertices + np.array([0.25 * 4 / 260, 0, 0]), mesh.triangles)
    image = np.zeros((181, 241, 4), np.uint8)
    image[..., 3] = 255
    image[90, 120], image[90, 121] = (100, 0, 200, 255), (200, 0, 100, 255)
    options = CostOptions(8.0, edge_samples=1)
    found = candidates_of(moved, maps_of(whole, {0: camera}), options)
    problem = texture_problem(moved, {0: camera}, found, lambda _: image, options)
    color = problem.edge_colors[0, 0] / FULL_COLOR * 255
    np.testing.assert_allclose(color, [125, 0, 175], atol=0.5)
    # What must not be used does not bleed into what may.
    image[90, 121, 3] = 0
    problem = texture_problem(moved, {0: camera}, found, lambda _: image, options)
    np.testing.assert_allclose(
        problem.edge_colors[0, 0] / FULL_COLOR * 255, [100, 0, 200], atol=0.01
    )


def scene_of(sphere, scale):
    mesh = sphere(0.8 * scale, (0, 0, 0), 4)
    cameras = ring(6, 3.0 * scale, 0.4 * scale)
    unit = SurfaceRays(sphere(0.8, (0, 0, 0), 4))
    pictures = {k: picture(unit, c, 1.0 + 0.05 * k) for k, c in ring(6).items()}
    return mesh, cameras, pictures


def test_each_picture_is_asked_for_once(sphere):
    mesh, cameras, pictures = scene_of(sphere, 1.0)
    options = CostOptions(6.0)
    asked = Counter()

    def load(label):
        asked[label] += 1
        return pictures[label]

    found = candidates_of(mesh, maps_of(mesh, cameras), options)
    texture_problem(mesh, cameras, found, load, options)
    assert asked == Counter(dict.fromkeys(range(6), 1))


def test_a_small_copy_is_labelled_as_the_scene_is(sphere):
    chosen, energies = [], []
    for scale in (1.0, 0.01):
        mesh, cameras, pictures = scene_of(sphere, scale)
        options = CostOptions(6.0 * scale)
        found = candidates_of(mesh, maps_of(mesh, cameras), options)
        labelling = expanded(
            texture_problem(mesh, cameras, found, pictures.__getitem__, options), 5
        )
        chosen.append(labelling.labels)
        energies.append(labelling.energy.total / scale**2)
    assert (chosen[0] == chosen[1]).mean() > 0.995
    assert energies[0] == pytest.approx(energies[1], rel=1e-3)


def test_a_mesh_that_nothing_sees(sphere):
    mesh = sphere(0.1, (0, 0, 50), 1)
    cameras = ring(2)
    options = CostOptions(6.0)
    maps = maps_of(sphere(0.8, (0, 0, 0), 2), cameras)
    found = candidates_of(mesh, maps, options)
    problem = texture_problem(mesh, cameras, found, lambda _: 1 / 0, options)
    assert (expanded(problem).labels == -1).all()
