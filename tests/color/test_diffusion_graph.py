from __future__ import annotations

import numpy as np
import pytest

from workbench.color.diffusion_graph import edges_of_cloud, edges_of_mesh, sample_graph


def _pairs(edges) -> set[tuple[int, int]]:
    return {(int(a), int(b)) for a, b in edges}


def test_edges_of_two_triangles_are_there_once() -> None:
    triangles = np.array([[0, 1, 2], [2, 1, 3]], np.int32)
    assert _pairs(edges_of_mesh(triangles, 5)) == {(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)}
    assert len(edges_of_mesh(triangles, 5)) == 5


def test_degenerate_triangles_join_no_sample_to_itself() -> None:
    assert _pairs(edges_of_mesh(np.array([[1, 1, 2], [0, 0, 0]], np.int32), 3)) == {(1, 2)}


def test_around_a_hole_only_what_it_needs(sphere) -> None:
    mesh = sphere(subdivisions=4)
    around = np.zeros(len(mesh.vertices), bool)
    around[[7, 700]] = True
    every = edges_of_mesh(mesh.triangles, len(mesh.vertices))
    some = edges_of_mesh(mesh.triangles, len(mesh.vertices), around)
    assert len(some) < 0.05 * len(every)
    assert _pairs(some) <= _pairs(every)
    # Every edge of the hole and of its ring, so that their spacing is that of the whole mesh.
    ring = np.zeros_like(around)
    ring[every[around[every].any(axis=1)]] = True
    assert _pairs(some) == _pairs(every[ring[every].any(axis=1)])


def test_edges_of_a_cloud_are_those_of_a_plain_search() -> None:
    points = np.random.default_rng(0).normal(size=(200, 3))
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1)[:, :8]
    expected = {(min(i, j), max(i, j)) for i in range(200) for j in near[i].tolist()}
    assert _pairs(edges_of_cloud(points)) == expected
    around = np.arange(200) == 3
    asked = {3, *near[3].tolist()}
    expected = {(min(i, j), max(i, j)) for i in asked for j in near[i].tolist()}
    assert _pairs(edges_of_cloud(points, around=around)) == expected


def test_clouds_with_copies_and_clouds_too_small() -> None:
    points = np.zeros((12, 3))
    edges = edges_of_cloud(points)
    assert (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(edges)) == 12
    assert _pairs(edges_of_cloud(np.eye(3))) == {(0, 1), (0, 2), (1, 2)}
    assert edges_of_cloud(np.zeros((1, 3))).shape == (0, 2)
    assert edges_of_cloud(np.zeros((0, 3))).shape == (0, 2)
    assert edges_of_cloud(points, around=np.zeros(12, bool)).shape == (0, 2)


def test_conductances_are_those_of_the_formula() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    turned = [np.sin(0.4), 0.0, np.cos(0.4)]
    normals = np.array([[0.0, 0, 1], turned, turned])
    edges = np.array([[0, 1], [1, 2]], np.int32)
    found = sample_graph(edges, points, normals, crease_rad=0.3).conductances
    # Spacing is 1, 1.5 and 2; the first edge turns by 0.4.
    expected = [1.0 * 1.5 / 1.0 * np.exp(-((0.4 / 0.3) ** 2)), 1.5 * 2.0 / 4.0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_unit_and_offset_of_the_samples_do_not_matter() -> None:
    points = np.random.default_rng(0).normal(size=(300, 3))
    edges = edges_of_cloud(points)
    one = sample_graph(edges, points).conductances
    np.testing.assert_allclose(sample_graph(edges, 1e-3 * points).conductances, one, rtol=1e-9)
    np.testing.assert_allclose(sample_graph(edges, points + 1e6).conductances, one, rtol=1e-6)


def test_no_normal_is_no_crease_and_no_edge_is_cut() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    edges = np.array([[0, 1], [1, 2], [2, 3]], np.int32)
    normals = np.array([[0, 0, 0], [0, 0, 1], [0, 0, -1], [np.nan, 0, 0]])
    plain = sample_graph(edges, points).conductances
    found = sample_graph(edges, points, normals, crease_rad=1e-3).conductances
    np.testing.assert_allclose(found, plain * [1.0, 1e-8, 1.0], rtol=1e-12)
    np.testing.assert_array_equal(
        sample_graph(edges, points, normals, crease_rad=np.inf).conductances, plain
    )


@pytest.mark.parametrize("scale", [1.0, 1e-200])
def test_samples_at_one_place_conduct_well_but_not_without_bound(scale: float) -> None:
    points = scale * np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    found = sample_graph(np.array([[0, 1], [1, 2]], np.int32), points).conductances
    assert np.isfinite(found).all()
    assert (found > 0).all()
    same = sample_graph(np.array([[0, 1]], np.int32), np.zeros((2, 3))).conductances
    assert same.tolist() == [1.0]
