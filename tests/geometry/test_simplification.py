from __future__ import annotations

import numpy as np

from workbench.geometry.mesh import TriangleMesh, edge_census, face_normals_and_areas
from workbench.geometry.simplification import simplified

FAR = np.array([4.2e6, 5.1e5, 300.0])


def test_a_ball_stays_a_closed_ball_of_as_many_triangles(sphere):
    ball = sphere(0.5, (1, 2, 3), 4)
    fewer = simplified(ball, 800)
    assert 780 <= len(fewer.triangles) <= 800
    assert edge_census(fewer.triangles).watertight
    away = np.linalg.norm(fewer.vertices - [1, 2, 3], axis=1)
    # Half of the sagitta of triangles of this size is what a ball of 800 must lose.
    edge = np.sqrt(4 * np.pi * 0.25 / 800 * 4 / np.sqrt(3))
    assert np.abs(away - 0.5).max() < edge**2 / (8 * 0.5)
    normals, _ = face_normals_and_areas(fewer)
    middles = fewer.vertices[fewer.triangles].mean(axis=1) - [1, 2, 3]
    assert ((normals * middles).sum(axis=1) > 0).all()
    assert fewer.triangles.dtype == np.int32


def test_a_mesh_that_is_small_enough_is_itself(sphere):
    ball = sphere(subdivisions=2)
    assert simplified(ball, len(ball.triangles)) is ball


def test_flat_places_lose_triangles_first(cube):
    """A cube of many triangles is a cube of twelve."""
    import trimesh

    fine = trimesh.Trimesh(cube.vertices, cube.triangles).subdivide().subdivide().subdivide()
    mesh = TriangleMesh(np.asarray(fine.vertices), np.asarray(fine.faces, np.int32))
    fewer = simplified(mesh, 12)
    assert len(fewer.triangles) == 12
    assert np.abs(np.abs(fewer.vertices) - 1.0).max() < 1e-6
    assert np.isclose(face_normals_and_areas(fewer)[1].sum(), 24.0)


def test_colours_go_along_and_others_do_not(sphere):
    ball = sphere(subdivisions=4)
    color = np.round(127.5 + 100 * ball.vertices).astype(np.uint8)
    fewer = simplified(ball.with_attributes(color=color, weight=np.ones(len(color))), 1000)
    assert set(fewer.vertex_attributes) == {"color"}
    found = fewer.vertex_attributes["color"]
    assert found.dtype == np.uint8
    # Colours are those of places up to half a long edge away, 100 of 255 to the radius.
    assert np.abs(found - (127.5 + 100 * fewer.vertices)).mean() < 3


def test_far_from_the_origin_the_shape_is_the_same(sphere):
    here = simplified(sphere(0.2, subdivisions=4), 600)
    there = simplified(sphere(0.2, FAR, 4), 600)
    assert len(there.triangles) == len(here.triangles)
    away = np.linalg.norm(there.vertices - FAR, axis=1)
    assert np.abs(away - 0.2).max() < 0.004
