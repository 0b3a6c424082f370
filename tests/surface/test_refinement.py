from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import divided_box, sphere_samples, without

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.samples import Samples
from workbench.surface.refinement import moved_onto_samples
from workbench.synthetic import solids

SAMPLES = sphere_samples(6000)
SPACING = float(np.sqrt(4 * np.pi / 6000))


def rough_sphere(amplitude: float) -> TriangleMesh:
    mesh = solids.geodesic_sphere((0, 0, 0), 1.0, 4)
    x, y, z = mesh.vertices.T
    wave = np.sin(3 * x + 1) * np.cos(2 * y) * np.cos(z)
    return TriangleMesh(mesh.vertices * (1 + amplitude * wave)[:, None], mesh.triangles)


def rms(mesh: TriangleMesh) -> float:
    return float(np.sqrt(np.mean((np.linalg.norm(mesh.vertices, axis=1) - 1) ** 2)))


def test_vertices_come_to_lie_on_the_sphere() -> None:
    mesh = rough_sphere(0.4 * SPACING)
    moved = moved_onto_samples(mesh, SAMPLES, 2)
    assert rms(moved) < rms(mesh) / 5
    assert np.array_equal(moved.triangles, mesh.triangles)


def test_no_rounds_move_nothing_and_attributes_stay() -> None:
    mesh = rough_sphere(0.01).with_attributes(mark=np.arange(2562))
    assert len(mesh.vertices) == 2562
    assert moved_onto_samples(mesh, SAMPLES, 0) is mesh
    moved = moved_onto_samples(mesh, SAMPLES, 1)
    assert np.array_equal(moved.vertex_attributes["mark"], np.arange(2562))


def test_noise_is_averaged_not_followed() -> None:
    sigma = 0.1 * SPACING
    mesh = solids.geodesic_sphere((0, 0, 0), 1.0, 4)
    moved = moved_onto_samples(mesh, sphere_samples(6000, noise=sigma), 2)
    assert rms(moved) < 0.8 * sigma


def test_infilled_parts_stay_and_no_step_appears_at_their_rim() -> None:
    hole = SAMPLES.points[:, 2] > 0.8
    samples = without(SAMPLES, hole)
    lift = 0.3 * SPACING
    ball = solids.geodesic_sphere((0, 0, 0), 1 + lift, 6)
    moved = moved_onto_samples(ball, samples, 1)
    z = ball.vertices[:, 2] / (1 + lift)
    angle = np.arccos(0.8) - np.arccos(np.clip(z, -1, 1))
    motion = np.linalg.norm(moved.vertices - ball.vertices, axis=1)
    reach = samples.radius_m[0]
    assert not motion[angle > 1.5 * reach].any()
    assert motion[angle < -SPACING].min() > 0.8 * lift
    edges = ball.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    length = np.linalg.norm(ball.vertices[edges[:, 0]] - ball.vertices[edges[:, 1]], axis=1)
    slope = np.abs(motion[edges[:, 0]] - motion[edges[:, 1]]) / length
    # The motion falls from ``lift`` to nothing over half a reach: a slope of 2 lift / reach.
    assert slope.max() < 2 * (2 * lift / reach)


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_the_two_sides_of_a_thin_wall_are_not_mixed(offset: float) -> None:
    v, u = np.meshgrid(np.arange(30.0), np.arange(30.0), indexing="ij")
    flat = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3) + offset
    thick = 0.4
    n = len(flat)
    samples = Samples(
        np.concatenate([flat, flat - [0, 0, thick]]),
        np.repeat([[0, 0, 1.0], [0, 0, -1.0]], n, axis=0),
        np.full(2 * n, 1.5),
        np.ones(2 * n),
        np.zeros(2 * n, np.int32),
    )
    wall = divided_box(0, 1, 20)
    stretched = wall.vertices * [29, 29, thick + 0.1] + [0, 0, -thick - 0.05] + offset
    moved = moved_onto_samples(TriangleMesh(stretched, wall.triangles), samples, 2).vertices
    inside = (np.abs(wall.vertices[:, :2] - 0.5) < 0.4).all(axis=1)
    top, bottom = inside & (wall.vertices[:, 2] == 1), inside & (wall.vertices[:, 2] == 0)
    assert np.abs(moved[top, 2] - offset).max() < 1e-6
    assert np.abs(moved[bottom, 2] - offset + thick).max() < 1e-6


def test_samples_that_reach_nowhere_move_nothing() -> None:
    mesh = rough_sphere(0.4 * SPACING)
    nowhere = replace(SAMPLES, radius_m=np.zeros(len(SAMPLES)))
    assert np.array_equal(moved_onto_samples(mesh, nowhere, 2).vertices, mesh.vertices)
