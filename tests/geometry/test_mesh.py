from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from workbench.geometry.mesh import (
    TriangleMesh,
    edge_census,
    face_normals_and_areas,
    vertex_normals,
)
from workbench.synthetic import solids

CUBE = solids.box((0, 0, 0), (1, 2, 3))


def counted_by_hand(triangles: np.ndarray) -> tuple[int, int, int, int]:
    undirected: Counter[tuple[int, int]] = Counter()
    directed: Counter[tuple[int, int]] = Counter()
    for triangle in triangles.tolist():
        for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            undirected[min(a, b), max(a, b)] += 1
            directed[a, b] += 1
    return (
        len(undirected),
        sum(n == 1 for n in undirected.values()),
        sum(n > 2 for n in undirected.values()),
        sum(n == 2 and directed[e] != 1 for e, n in undirected.items()),
    )


def flipped(triangles: np.ndarray, which: int) -> np.ndarray:
    turned = triangles.copy()
    turned[which] = turned[which, ::-1]
    return turned


@pytest.mark.parametrize(
    ("triangles", "watertight"),
    [
        (CUBE.triangles, True),
        (CUBE.triangles[:, ::-1], True),
        (CUBE.triangles[1:], False),
        (flipped(CUBE.triangles, 4), False),
        (np.concatenate([CUBE.triangles, CUBE.triangles[:1]]), False),
        (np.concatenate([CUBE.triangles, [[0, 7, 3]]]).astype(np.int32), False),
        (np.zeros((0, 3), np.int32), False),
        (np.array([[0, 1, 2], [0, 2, 1]], np.int32), True),
    ],
    ids=["closed", "inside out", "open", "misoriented", "doubled", "fin", "empty", "pillow"],
)
def test_the_census_agrees_with_counting_by_hand(triangles: np.ndarray, watertight: bool) -> None:
    census = edge_census(triangles)
    assert (
        census.edges,
        census.boundary_edges,
        census.nonmanifold_edges,
        census.misoriented_edges,
    ) == counted_by_hand(triangles)
    assert census.watertight is watertight


def test_the_census_agrees_on_random_soups() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        triangles = np.array([rng.choice(12, 3, replace=False) for _ in range(30)], np.int32)
        census = edge_census(triangles)
        assert (
            census.edges,
            census.boundary_edges,
            census.nonmanifold_edges,
            census.misoriented_edges,
        ) == counted_by_hand(triangles)


def test_the_census_holds_for_the_largest_indices() -> None:
    high = np.iinfo(np.int32).max
    triangles = np.array([[0, 1, high], [1, 0, high - 1]], np.int32)
    assert edge_census(triangles).boundary_edges == 4


def test_kept_triangles_keep_their_corners_and_attributes() -> None:
    rng = np.random.default_rng(1)
    sphere = solids.geodesic_sphere((0, 0, 0), 1.0, 3)
    n = len(sphere.vertices)
    sphere = sphere.with_attributes(
        normal=rng.normal(size=(n, 3)), provenance=rng.integers(0, 2, n).astype(np.uint8)
    )
    keep = rng.random(len(sphere.triangles)) < 0.3
    part = sphere.keep_triangles(keep)
    assert len(part.vertices) == len(np.unique(sphere.triangles[keep]))
    assert part.triangles.dtype == np.int32
    for name in ("normal", "provenance"):
        before, after = sphere.vertex_attributes[name], part.vertex_attributes[name]
        assert after.dtype == before.dtype
        assert np.array_equal(after[part.triangles], before[sphere.triangles[keep]])
    assert np.array_equal(part.vertices[part.triangles], sphere.vertices[sphere.triangles[keep]])


def test_no_kept_triangle_leaves_an_empty_mesh() -> None:
    nothing = CUBE.keep_triangles(np.zeros(len(CUBE.triangles), bool))
    assert nothing.vertices.shape == (0, 3)
    assert nothing.triangles.shape == (0, 3)


@pytest.mark.parametrize("centre", [0.0, 5e6])
def test_vertex_normals_of_a_sphere_point_outwards(centre: float) -> None:
    sphere = solids.geodesic_sphere((0, 0, 0), 2.0, 4)
    moved = TriangleMesh(sphere.vertices + centre, sphere.triangles)
    cosine = np.einsum("vi,vi->v", vertex_normals(moved), sphere.vertices / 2.0)
    # Facets of a sphere divided 16 times per edge span 4 degrees; their mean is far closer.
    assert cosine.min() > np.cos(np.radians(1.0))


def test_areas_and_degenerate_faces() -> None:
    mesh = TriangleMesh(
        np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [6, 0, 0.0]]),
        np.array([[0, 1, 2], [0, 1, 3]], np.int32),
    )
    normals, areas = face_normals_and_areas(mesh)
    assert np.array_equal(areas, [6.0, 0.0])
    assert np.array_equal(normals, [[0, 0, 1], [0, 0, 0]])
    assert np.array_equal(vertex_normals(mesh), [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 0]])
