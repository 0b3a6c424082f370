from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from threadpoolctl import threadpool_limits

from tests.color.diffusion_cases import CASES, equations, grid, noise_on_rim, overshoot, rim
from workbench.color.diffusion_graph import SampleGraph, edges_of_cloud, edges_of_mesh, sample_graph
from workbench.color.inpainting import (
    INPAINTED,
    PHOTOGRAPHED,
    UNPAINTED,
    InpaintingSettings,
    inpainted,
)
from workbench.errors import InputError, SettingsError
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh, vertex_normals

ALL_TRUSTED = InpaintingSettings(trusted=0.0)


def _star(colors: list[float], weights: list[float]) -> tuple[np.ndarray, np.ndarray, SampleGraph]:
    """An uncoloured sample with a coloured one at the end of each of its edges."""
    n = len(colors)
    edges = np.stack([np.zeros(n), np.arange(1, n + 1)], axis=1).astype(np.int32)
    values = np.vstack([[np.nan] * 3, np.repeat(np.array(colors)[:, None], 3, axis=1)])
    return values, np.array([0.0, *weights]), SampleGraph(n + 1, edges, np.ones(n))


def _exact(graph: SampleGraph, colors: np.ndarray, open_: np.ndarray) -> np.ndarray:
    """One channel by elimination with fractions, free of rounding."""
    hole = np.flatnonzero(open_).tolist()
    row_of = {sample: k for k, sample in enumerate(hole)}
    n = len(hole)
    rows = [[Fraction(0)] * (n + 1) for _ in range(n)]
    for (i, j), g in zip(graph.edges.tolist(), graph.conductances.tolist(), strict=True):
        for a, b in ((i, j), (j, i)):
            if a in row_of:
                rows[row_of[a]][row_of[a]] += Fraction(g)
                if b in row_of:
                    rows[row_of[a]][row_of[b]] -= Fraction(g)
                else:
                    rows[row_of[a]][n] += Fraction(g) * Fraction(float(colors[b, 0]))
    for k in range(n):
        for other in range(n):
            if other != k and rows[other][k]:
                share = rows[other][k] / rows[k][k]
                rows[other] = [x - share * y for x, y in zip(rows[other], rows[k], strict=True)]
    return np.array([float(rows[k][n] / rows[k][k]) for k in range(n)])


@pytest.mark.parametrize("case", CASES)
def test_equals_a_direct_solution(case: str) -> None:
    n = 40
    graph = CASES[case](n)
    colors, weights = noise_on_rim(n)
    open_ = weights == 0.0
    found = inpainted(colors, weights, graph)
    matrix, right = equations(graph, colors, open_)
    assert found.converged
    assert found.unknowns == open_.sum() == matrix.shape[0]
    # Where walls are 10⁸ times weaker a direct solution with rounding is itself no better.
    loose = 1e-6 if "creases" in case or "inclusions" in case or "random" in case else 1e-8
    np.testing.assert_allclose(found.colors[open_], spsolve(matrix, right), atol=loose)


@pytest.mark.parametrize("case", ["creases 1e-8", "random 1e-8 to 1", "cloud with a fold"])
def test_equals_the_exact_solution_however_weakly_parts_hang_together(case: str) -> None:
    n = 9
    graph = CASES[case](n)
    colors, weights = noise_on_rim(n)
    open_ = weights == 0.0
    found = inpainted(colors, weights, graph)
    exact = _exact(graph, colors, open_)
    np.testing.assert_allclose(found.colors[open_, 0], exact, rtol=0, atol=1e-12)


def test_float32_would_not_do() -> None:
    """A field whose rim conducts 10⁻⁸ floats in float32, where 4 + 10⁻⁸ is 4."""
    n = 60
    plain = grid(n)
    border = rim(n)
    values = np.where(border[plain.edges].any(axis=1), 1e-8, 1.0)
    graph = SampleGraph(n * n, plain.edges, values)
    colors, weights = noise_on_rim(n)
    matrix, right = equations(graph, colors, ~border)
    single = spsolve(matrix.astype(np.float32), right.astype(np.float32))
    found = inpainted(colors, weights, graph)
    # Alike all over: as much flows in as out, so what the rim's mean is, but for its corners.
    ends = graph.edges[border[graph.edges].sum(axis=1) == 1]
    mean = colors[ends[border[ends]]].mean(axis=0)
    assert found.converged
    np.testing.assert_allclose(
        found.colors[~border], np.tile(mean, ((~border).sum(), 1)), atol=1e-6
    )
    assert not np.abs(single - mean).max() < 0.01


@pytest.mark.parametrize("case", CASES)
def test_no_colour_leaves_the_range_of_the_rim(case: str) -> None:
    n = 40
    colors, weights = noise_on_rim(n)
    for cycles in (1, 60):
        found = inpainted(colors, weights, CASES[case](n), InpaintingSettings(max_cycles=cycles))
        assert overshoot(found, colors) <= 0.0


def test_each_hole_keeps_to_the_range_of_its_own_rim() -> None:
    graph = grid(40)
    column = np.arange(1600) % 40
    colors = np.repeat(np.where(column < 20, 0.1, 0.9)[:, None], 3, axis=1)
    weights = np.ones(1600)
    hole = (np.arange(1600) // 40 > 5) & (np.arange(1600) // 40 < 30)
    weights[hole & (abs(column - 8) < 5)] = 0.0
    weights[hole & (abs(column - 31) < 5)] = 0.0
    found = inpainted(colors, weights, graph)
    assert found.islands == 2
    # To the last bit: rounding makes no second colour.
    np.testing.assert_array_equal(found.colors, colors)


@pytest.mark.parametrize("diagonal", [0.0, 1.0])
def test_a_ramp_is_continued(diagonal: float) -> None:
    n = 80
    row, column = np.divmod(np.arange(n * n), n)
    ramp = np.stack([row, column, 3.0 * row - column], axis=1) / n
    weights = np.ones(n * n)
    weights[np.hypot(row - 40, column - 37) < 30] = 0.0
    found = inpainted(ramp, weights, grid(n, diagonal=diagonal))
    np.testing.assert_allclose(found.colors, ramp, atol=3e-8)


def test_a_ramp_is_continued_over_a_mesh_of_which_only_the_hole_is_looked_at() -> None:
    n = 60
    row, column = np.divmod(np.arange(n * n), n)
    corner = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    triangles = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + n + 1], axis=1),
            np.stack([corner, corner + n + 1, corner + n], axis=1),
        ]
    ).astype(np.int32)
    points = np.stack([row, column, np.zeros(n * n)], axis=1).astype(float)
    weights = np.ones(n * n)
    weights[np.hypot(row - 30, column - 27) < 20] = 0.0
    edges = edges_of_mesh(triangles, n * n, weights == 0.0)
    ramp = points @ [[0.1, 0.0, 0.3], [0.0, 0.2, -0.1], [0.0, 0.0, 0.0]]
    found = inpainted(ramp, weights, sample_graph(edges, points, np.tile([0.0, 0, 1], (n * n, 1))))
    np.testing.assert_allclose(found.colors, ramp, atol=1e-7)


def test_photographed_colours_stay_to_the_last_bit() -> None:
    n = 30
    rng = np.random.default_rng(4)
    colors = rng.normal(size=(n * n, 3)) * 10.0 ** rng.uniform(-30, 30, (n * n, 1))
    weights = np.where(rng.random(n * n) < 0.4, 0.0, 10.0 ** rng.uniform(-300, 300, n * n))
    given = colors.copy()
    found = inpainted(colors, weights, grid(n))
    kept = weights > 0.0
    assert colors.tobytes() == given.tobytes()
    assert found.colors[kept].tobytes() == given[kept].tobytes()
    assert (found.flags[kept] == PHOTOGRAPHED).all()
    assert (found.flags[~kept] == INPAINTED).all()
    assert np.isfinite(found.colors).all()


def test_a_hole_of_one_sample_is_the_mean_of_those_around_it() -> None:
    found = inpainted(*_star([0.1, 0.2, 0.6], [1.0, 1.0, 1.0]))
    np.testing.assert_allclose(found.colors[0], 0.3, rtol=1e-14)
    assert found.flags.tolist() == [INPAINTED, PHOTOGRAPHED, PHOTOGRAPHED, PHOTOGRAPHED]


def test_samples_of_little_weight_are_little_heard() -> None:
    # Below half the median weight in proportion to it: 0.1 of 1 is heard as 0.2.
    found = inpainted(*_star([0.0, 0.0, 1.0], [1.0, 1.0, 0.1]))
    np.testing.assert_allclose(found.colors[0], 0.2 / 2.2, rtol=1e-14)
    found = inpainted(*_star([0.25, 0.25, 1.0], [1.0, 3.0, 1e-12]))
    np.testing.assert_allclose(found.colors[0], 0.25, atol=1e-11)
    found = inpainted(*_star([0.0, 0.0, 1.0], [1.0, 1.0, 1e-12]), ALL_TRUSTED)
    np.testing.assert_allclose(found.colors[0], 1 / 3, rtol=1e-14)


def test_weights_count_relative_to_those_around_the_same_hole() -> None:
    n = 30
    colors, weights = noise_on_rim(n)
    one = inpainted(colors, weights, grid(n))
    tiny = inpainted(colors, 1e-12 * weights, grid(n))
    assert tiny.converged
    np.testing.assert_array_equal(tiny.colors, one.colors)


def test_weights_from_1e_12_to_1_are_solved_exactly() -> None:
    n = 9
    colors, weights = noise_on_rim(n)
    exponents = np.random.default_rng(3).uniform(-12.0, 0.0, n * n)
    weights *= 10.0**exponents
    border = weights > 0.0
    plain = grid(n)
    found = inpainted(colors, weights, plain)
    assert found.converged
    # The median is taken over the edges that lead into the hole.
    start, end = plain.edges.T
    ring = np.where(border[start], start, end)
    entering = border[start] != border[end]
    median = np.sort(weights[ring[entering]])[entering.sum() // 2]
    heard = np.where(entering, np.minimum(1.0, weights[ring] / (0.5 * median)), 1.0)
    exact = _exact(SampleGraph(n * n, plain.edges, heard), colors, ~border)
    np.testing.assert_allclose(found.colors[~border, 0], exact, atol=1e-9)


@pytest.mark.parametrize("scale", [2.0**-700, 2.0**700])
def test_the_unit_of_conductance_does_not_matter(scale: float) -> None:
    n = 20
    colors, weights = noise_on_rim(n)
    graph = CASES["1e-2 along"](n)
    scaled = SampleGraph(graph.count, graph.edges, scale * graph.conductances)
    one, other = inpainted(colors, weights, graph), inpainted(colors, weights, scaled)
    assert one.colors.tobytes() == other.colors.tobytes()


@pytest.mark.slow
def test_half_of_a_real_head(shared_data) -> None:
    mesh = read_surface(shared_data("meshes", "igea.ply"))
    points = mesh.vertices
    hole = points[:, 1] < np.median(points[:, 1])
    colors = (points - points.min(axis=0)) / np.ptp(points, axis=0).max()
    graph = sample_graph(edges_of_mesh(mesh.triangles, len(points), hole), points)
    found = inpainted(colors, (~hole).astype(float), graph)
    assert found.converged
    assert found.factor < 0.5
    assert found.unknowns == hole.sum()
    assert overshoot(found, colors) <= 0.0


def test_islands_without_colour_are_left_and_said() -> None:
    edges = np.array([[0, 1], [1, 2], [3, 4], [5, 6]], np.int32)
    graph = SampleGraph(9, edges, np.ones(4))
    colors = np.full((9, 3), 0.5)
    weights = np.array([1.0, 0, 0, 0, 0, 1, 1, 1, 0])
    found = inpainted(colors, weights, graph)
    assert found.flags.tolist() == [0, 1, 1, 2, 2, 0, 0, 0, 2]
    assert found.unpainted.tolist() == (found.flags == UNPAINTED).tolist()
    assert np.isnan(found.colors[found.unpainted]).all()
    np.testing.assert_array_equal(found.colors[:3], 0.5)
    assert (found.islands, found.islands_unpainted, found.unknowns) == (3, 2, 2)


def test_an_edge_that_does_not_conduct_is_none() -> None:
    graph = SampleGraph(3, np.array([[0, 1], [1, 2]], np.int32), np.array([1.0, 0.0]))
    found = inpainted(np.full((3, 3), 0.5), np.array([1.0, 0, 0]), graph)
    assert found.flags.tolist() == [0, 1, 2]


@pytest.mark.parametrize("weights", [np.ones(4), np.zeros(4), np.zeros(0)])
def test_nothing_to_solve(weights: np.ndarray) -> None:
    n = len(weights)
    edges = np.array([[0, 1]] if n else np.zeros((0, 2)), np.int32)
    graph = SampleGraph(n, edges, np.ones(len(edges)))
    found = inpainted(np.full((n, 3), 0.25), weights, graph)
    assert found.converged
    assert (found.cycles, found.unknowns, found.error, found.factor) == (0, 0, 0.0, 0.0)
    assert (found.flags == (PHOTOGRAPHED if weights.any() else UNPAINTED)).all()


def test_edges_given_twice_or_both_ways_conduct_twice_and_loops_nothing() -> None:
    colors = np.array([[np.nan] * 3, [0.0] * 3, [1.0] * 3])
    weights = np.array([0.0, 1, 1])
    edges = np.array([[0, 1], [1, 0], [0, 2], [0, 0]], np.int32)
    found = inpainted(colors, weights, SampleGraph(3, edges, np.ones(4)))
    np.testing.assert_allclose(found.colors[0], 1 / 3, rtol=1e-14)


@pytest.mark.parametrize("case", CASES)
def test_too_few_cycles_are_said_and_so_is_the_error(case: str) -> None:
    n = 60
    graph = CASES[case](n)
    colors, weights = noise_on_rim(n)
    open_ = weights == 0.0
    best = inpainted(colors, weights, graph, InpaintingSettings(tolerance=1e-13))
    for cycles in (1, 3, 9):
        found = inpainted(colors, weights, graph, InpaintingSettings(max_cycles=cycles))
        error = np.abs(found.colors[open_] - best.colors[open_]).max()
        assert found.cycles == cycles
        assert not found.converged
        assert error <= found.error <= 20.0 * error
        assert len(found.residuals) == len(found.factors) + 1 == cycles + 1


@pytest.mark.parametrize("case", ["even", "creases 1e-8", "1e-2 along"])
def test_the_condition_is_that_of_the_scaled_matrix(case: str) -> None:
    n = 22
    graph = CASES[case](n)
    colors, weights = noise_on_rim(n)
    matrix = equations(graph, colors, weights == 0.0)[0].toarray()
    scaled = matrix / matrix.diagonal()[:, None]
    expected = np.linalg.norm(scaled, np.inf) * np.linalg.norm(np.linalg.inv(scaled), np.inf)
    found = inpainted(colors, weights, graph, InpaintingSettings(tolerance=1e-10))
    assert found.condition == pytest.approx(expected, rel=1e-3)


def test_half_of_a_sphere(sphere) -> None:
    mesh = sphere(subdivisions=5)
    points = mesh.vertices
    weights = (points[:, 2] > 0.0).astype(float)
    colors = 0.5 + 0.4 * points
    edges = edges_of_mesh(mesh.triangles, len(points), weights == 0.0)
    found = inpainted(colors, weights, sample_graph(edges, points, vertex_normals(mesh)))
    assert found.converged
    assert found.unknowns == (weights == 0.0).sum()
    assert found.factor < 0.5
    # At the pole opposite every part of the rim is as near as any other: the mean of the rim.
    pole = np.argmin(points[:, 2])
    np.testing.assert_allclose(found.colors[pole, :2], 0.5, atol=0.01)


def test_time_and_size_go_with_the_hole(sphere) -> None:
    mesh = sphere(subdivisions=6)
    weights = np.ones(len(mesh.vertices))
    hole = mesh.vertices[:, 2] > 0.99
    weights[hole] = 0.0
    edges = edges_of_mesh(mesh.triangles, len(weights), hole)
    assert len(edges) < 0.02 * len(edges_of_mesh(mesh.triangles, len(weights)))
    found = inpainted(mesh.vertices, weights, sample_graph(edges, mesh.vertices))
    assert found.unknowns == hole.sum() == found.sizes[0]


def _half_painted_cube() -> tuple[TriangleMesh, np.ndarray, np.ndarray]:
    """A finely divided edge of a box, one face dark and one light, with a hole across it."""
    n = 41
    along, across = np.meshgrid(np.arange(n), np.arange(-20, 21), indexing="ij")
    along, across = along.ravel(), across.ravel()
    points = np.stack([along, np.maximum(across, 0), np.maximum(-across, 0)], axis=1).astype(float)
    corner = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    triangles = np.concatenate(
        [
            np.stack([corner, corner + n, corner + n + 1], axis=1),
            np.stack([corner, corner + n + 1, corner + 1], axis=1),
        ]
    ).astype(np.int32)
    shade = np.where(across > 0, 0.8, 0.2)
    weights = (np.hypot(along - 20, across) > 15).astype(float)
    return TriangleMesh(points, triangles), np.repeat(shade[:, None], 3, axis=1), weights


def test_colour_keeps_to_its_side_of_a_crease() -> None:
    mesh, shade, weights = _half_painted_cube()
    colors = np.where(weights[:, None] > 0.0, shade, np.nan)
    edges = edges_of_mesh(mesh.triangles, len(weights), weights == 0.0)
    normals = vertex_normals(mesh)
    # The samples on the crease itself have colours of their own.
    away = (weights == 0.0) & (mesh.vertices[:, 1:].max(axis=1) > 1.5)
    errors = {}
    for crease in (np.radians(10.0), np.radians(20.0), np.inf):
        found = inpainted(colors, weights, sample_graph(edges, mesh.vertices, normals, crease))
        errors[crease] = float(np.abs(found.colors - shade)[away].mean())
    assert errors[np.radians(20.0)] < 0.2 * errors[np.inf]
    assert errors[np.radians(10.0)] < 1e-3
    assert errors[np.inf] > 0.08


def test_clouds_come_to_the_same_as_meshes(sphere) -> None:
    mesh = sphere(subdivisions=5)
    points = mesh.vertices
    hole = points[:, 2] > 0.8
    colors = 0.5 + 0.3 * points
    found = [
        inpainted(colors, (~hole).astype(float), sample_graph(edges, points, points))
        for edges in (
            edges_of_mesh(mesh.triangles, len(points), hole),
            edges_of_cloud(points, 8, hole),
        )
    ]
    assert np.abs(found[0].colors - found[1].colors).max() < 0.02


def test_the_same_bits_whatever_the_threads() -> None:
    n = 60
    colors, weights = noise_on_rim(n)
    graph = CASES["cloud with a fold"](n)
    results = []
    for threads in (1, 2, 4):
        with threadpool_limits(threads):
            results.append(inpainted(colors, weights, graph).colors.tobytes())
    assert len(set(results)) == 1


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"weights": np.array([0.0, np.nan, 1.0])}, "weight"),
        ({"weights": np.array([0.0, -1.0, 1.0])}, "weight"),
        ({"weights": np.array([0.0, np.inf, 1.0])}, "weight"),
        ({"colors": np.array([[0.0] * 3, [np.nan] * 3, [1.0] * 3])}, "colour"),
        ({"colors": np.array([[0.0] * 3, [np.inf] * 3, [1.0] * 3])}, "colour"),
        ({"colors": np.zeros((3, 4))}, "same samples"),
        ({"weights": np.ones(2)}, "same samples"),
        ({"graph": SampleGraph(4, np.array([[0, 1]], np.int32), np.ones(1))}, "same samples"),
        ({"graph": SampleGraph(3, np.array([[0, 3]], np.int32), np.ones(1))}, "edges"),
        ({"graph": SampleGraph(3, np.array([[0, -1]], np.int32), np.ones(1))}, "edges"),
        ({"graph": SampleGraph(3, np.array([[0, 1]], np.int32), np.ones(2))}, "edges"),
        ({"graph": SampleGraph(3, np.array([[0, 1]], np.int32), -np.ones(1))}, "conductance"),
        ({"graph": SampleGraph(3, np.array([[0, 1]], np.int32), [np.nan] * np.ones(1))}, "conduct"),
    ],
)
def test_what_cannot_be_meant_is_refused(change: dict, word: str) -> None:
    given = {
        "colors": np.zeros((3, 3)),
        "weights": np.array([0.0, 1.0, 1.0]),
        "graph": SampleGraph(3, np.array([[0, 1], [0, 2]], np.int32), np.ones(2)),
    }
    with pytest.raises(InputError, match=word):
        inpainted(**{**given, **change})


@pytest.mark.parametrize("wrong", [{"tolerance": 0.0}, {"max_cycles": 0}, {"trusted": -1.0}])
def test_settings_that_cannot_be_met_are_refused(wrong: dict) -> None:
    with pytest.raises(SettingsError, match="cannot be met"):
        InpaintingSettings(**wrong)
