from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_sampling import sample_surface
from workbench.verification.distances import (
    DistanceSummary,
    closest_barycentric,
    distance_to_surface,
    signed_distances_m,
    vertex_areas,
)

UTM = np.array([512_345.25, 5_403_210.5, 210.125])


def brute_force(points: np.ndarray, mesh: TriangleMesh) -> np.ndarray:
    """Smallest float64 distance over all triangles, by the case tree of Ericson 2005, 5.1.5."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    best = np.empty(len(points))
    for i, p in enumerate(points):
        best[i] = min(np.linalg.norm(p - ericson(p, *abc)) for abc in zip(a, b, c, strict=True))
    return best


def ericson(p, a, b, c):
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab @ ap, ac @ ap
    if d1 <= 0 and d2 <= 0:
        return a
    bp = p - b
    d3, d4 = ab @ bp, ac @ bp
    if d3 >= 0 and d4 <= d3:
        return b
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        return a + ab * d1 / (d1 - d3)
    cp = p - c
    d5, d6 = ab @ cp, ac @ cp
    if d6 >= 0 and d5 <= d6:
        return c
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        return a + ac * d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        return b + (c - b) * (d4 - d3) / ((d4 - d3) + (d5 - d6))
    return a + ab * vb / (va + vb + vc) + ac * vc / (va + vb + vc)


def query_points(rng: np.random.Generator, mesh: TriangleMesh, count: int) -> np.ndarray:
    """Points all around, just beside the surface, and on vertices and edges."""
    around = rng.uniform(-2, 2, (count, 3))
    on_surface, _, _ = sample_surface(mesh, count, 5)
    beside = on_surface + 1e-5 * rng.normal(size=(count, 3))
    middles = mesh.vertices[mesh.triangles[:, :2]].mean(axis=1)
    return np.concatenate([around, beside, mesh.vertices[:count], middles[:count]])


def test_distances_equal_brute_force(sphere, rng):
    mesh = sphere(subdivisions=2)
    points = query_points(rng, mesh, 30)
    found = distance_to_surface(points, mesh).distance_m
    assert found == pytest.approx(brute_force(points, mesh), abs=1e-12)


def test_distances_at_georeferenced_coordinates_equal_those_at_the_origin(sphere, rng):
    mesh = sphere(radius=0.25, subdivisions=2)
    points = 0.25 * query_points(rng, mesh, 30)
    far = TriangleMesh(mesh.vertices + UTM, mesh.triangles)
    found = distance_to_surface(points + UTM, far)
    # float64 coordinates near 5.4e6 are themselves rounded to 1e-9.
    assert found.distance_m == pytest.approx(brute_force(points, mesh), abs=4e-9)
    signed = signed_distances_m(found, far)
    near = signed_distances_m(distance_to_surface(points, mesh), mesh)
    clear = np.abs(near) > 1e-8
    assert np.array_equal(np.sign(signed[clear]), np.sign(near[clear]))


def test_the_closest_triangle_and_weights_reproduce_the_offset(sphere, rng):
    mesh = sphere(subdivisions=2)
    points = query_points(rng, mesh, 25)
    found = distance_to_surface(points, mesh)
    closest = np.einsum(
        "ij,ijk->ik", found.barycentric, mesh.vertices[mesh.triangles[found.triangle]]
    )
    assert points - closest == pytest.approx(found.offset, abs=1e-12)
    assert found.barycentric.min() >= 0
    assert found.barycentric.sum(axis=1) == pytest.approx(1)


def test_cube_distances_and_signs_are_those_of_the_formula(cube, rng):
    points = rng.uniform(-2, 2, (2000, 3))
    found = distance_to_surface(points, cube)
    # Signed distance of a box (Quilez): exact outside and inside, at faces, edges, corners.
    q = np.abs(points) - 1
    true = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    assert signed_distances_m(found, cube) == pytest.approx(true, abs=1e-12)


def test_signs_hold_at_a_sharp_spike(rng):
    """Beside an acute corner the face normals of the nearest triangles disagree."""
    vertices = np.array([[0, 0, 4.0], [-0.3, -0.3, 0], [0.3, -0.3, 0], [0.0, 0.4, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32)
    spike = TriangleMesh(vertices, triangles)
    above = np.array([0, 0, 4.0]) + rng.normal(size=(500, 3)) * [0.4, 0.4, 0.1]
    above = above[above[:, 2] > 4.0]
    assert len(above) > 100
    assert signed_distances_m(distance_to_surface(above, spike), spike).min() > 0


def test_closest_point_of_a_sliver_and_of_a_point_triangle():
    corners = np.array(
        [[[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1, 1, 1], [1, 1, 1], [1, 1, 1]]], float
    )
    weights = closest_barycentric(np.array([[1.7, 3, 0], [1, 1, 4.0]]), corners)
    closest = np.einsum("ij,ijk->ik", weights, corners)
    assert closest == pytest.approx(np.array([[1.7, 0, 0], [1, 1, 1]]))


def test_closest_barycentric_is_optimal(rng):
    corners = rng.normal(size=(20, 3, 3))
    points = 2 * rng.normal(size=(20, 3))
    weights = closest_barycentric(points, corners)
    for point, triangle, weight in zip(points, corners, weights, strict=True):
        solution = minimize(
            lambda w, p=point, t=triangle: ((w @ t - p) ** 2).sum(),
            np.full(3, 1 / 3),
            bounds=[(0, 1)] * 3,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1},
        )
        assert ((weight @ triangle - point) ** 2).sum() <= solution.fun + 1e-9


def test_a_surface_without_triangles_is_refused():
    empty = TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32))
    with pytest.raises(InputError, match="without triangles"):
        distance_to_surface(np.zeros((1, 3)), empty)
    with pytest.raises(InputError, match="without area"):
        sample_surface(empty, 10, 0)


def test_samples_follow_area_and_seed(cube):
    points, triangles, barycentric = sample_surface(cube, 12_000, 7)
    # Twelve equal triangles: each holds its thousandth to within one sample.
    assert np.abs(np.bincount(triangles, minlength=12) - 1000).max() <= 1
    assert np.abs(points).max(axis=1) == pytest.approx(1, abs=1e-12)
    assert barycentric.mean(axis=0) == pytest.approx([1 / 3] * 3, abs=0.01)
    again, _, _ = sample_surface(cube, 12_000, 7)
    other, _, _ = sample_surface(cube, 12_000, 8)
    assert np.array_equal(points, again)
    assert not np.array_equal(points, other)


def test_samples_lie_on_the_surface_at_georeferenced_coordinates(cube):
    far = TriangleMesh(cube.vertices + UTM, cube.triangles)
    points, _, _ = sample_surface(far, 1000, 0)
    assert np.abs(points - UTM).max(axis=1) == pytest.approx(1, abs=2e-9)


def test_vertex_areas_sum_to_the_surface(cube):
    assert vertex_areas(cube).sum() == pytest.approx(24)


def test_a_summary_tells_what_numpy_tells(rng):
    values = rng.normal(0.1, 1, 5000)
    summary = DistanceSummary.of(values, signed=True)
    assert summary.rms == pytest.approx(np.sqrt((values**2).mean()))
    assert summary.bias == pytest.approx(values.mean())
    assert summary.p95 == pytest.approx(np.percentile(np.abs(values), 95))
    assert np.isnan(DistanceSummary.of(np.empty(0)).rms)
    assert np.isnan(DistanceSummary.of(values).bias)
