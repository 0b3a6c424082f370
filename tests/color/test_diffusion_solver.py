from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse import csr_array

from tests.color.diffusion_cases import CASES, equations, grid, rim
from workbench.color.diffusion_graph import SampleGraph
from workbench.color.diffusion_hierarchy import Graph, Hierarchy
from workbench.color.diffusion_solver import solved
from workbench.kernels import diffusion_aggregation, diffusion_relaxation

ANY, EIGHT = np.full(4, np.inf), np.full(4, 1e-8)


def _graph(samples: SampleGraph, excess: np.ndarray) -> Graph:
    rows = diffusion_aggregation.rows_of_edges(samples.edges, samples.conductances, samples.count)
    return Graph(*rows, excess)


def _held_at_rim(samples: SampleGraph, n: int) -> tuple[Graph, csr_array]:
    """The graph within the border of a square, and its matrix made another way."""
    matrix, _ = equations(samples, np.zeros((n * n, 3)), ~rim(n))
    off = -matrix.tocsr()
    off.setdiag(0.0)
    off.eliminate_zeros()
    off.sort_indices()
    i, j = samples.edges.T
    inside = ~rim(n)
    open_end = np.where(inside[i], i, j)[inside[i] != inside[j]]
    held = samples.conductances[inside[i] != inside[j]]
    excess = np.bincount(open_end, held, n * n)[inside]
    return Graph(off.indptr.astype(np.int64), off.indices, off.data, excess), matrix


def _two_grid_bound(graph: Graph, matrix: np.ndarray, group: np.ndarray, members: range) -> float:
    """The largest of 2 vᵀ D (I − P) v over vᵀ A v on one group, by dense eigenvalues."""
    worst = 0.0
    diagonal = matrix.diagonal()
    for g in members:
        here = np.flatnonzero(group == g)
        block = matrix[np.ix_(here, here)].copy()
        joins = -(block - np.diag(block.diagonal()))
        own = np.diag(joins.sum(axis=1) + graph.excess[here]) - joins
        d = diagonal[here]
        smooth = np.diag(d) - np.outer(d, d) / d.sum()
        # Grounding by a trace of D keeps the pencil definite where the group has no excess.
        values = eigh(2.0 * smooth, own + 1e-12 * np.diag(d), eigvals_only=True)
        worst = max(worst, float(values[-1]))
    return worst


@pytest.mark.parametrize("case", CASES)
def test_groups_keep_the_bound_that_convergence_rests_on(case: str) -> None:
    n = 20
    graph, matrix = _held_at_rim(CASES[case](n), n)
    level = Hierarchy(graph)
    assert level.sizes == [len(graph)], "solved at once, but grouped below"
    rows = (graph.starts, graph.neighbours, graph.conductances, graph.excess)
    group, count = diffusion_aggregation.pairs(*rows, graph.diagonal(), 8.0)
    dense = matrix.toarray()
    assert _two_grid_bound(graph, dense, group, range(count)) <= 8.0 * (1 + 1e-6)
    for _ in range(2):
        small = diffusion_aggregation.smaller_graph(*rows, group, count)
        group, count = diffusion_aggregation.merged(
            *rows, graph.diagonal(), group, count, *small[:3], 8.0
        )
        assert _two_grid_bound(graph, dense, group, range(count)) <= 8.0 * (1 + 1e-6)
    assert np.bincount(group[group >= 0]).max() <= 8


@pytest.mark.parametrize("case", ["cloud with a fold", "random 1e-8 to 1"])
def test_the_smaller_graph_is_galerkins(case: str) -> None:
    n = 24
    graph, matrix = _held_at_rim(CASES[case](n), n)
    rows = (graph.starts, graph.neighbours, graph.conductances, graph.excess)
    group = (np.arange(len(graph)) // 3).astype(np.int32)
    group[5:40:7] = diffusion_aggregation.LEFT_OUT
    count = int(group.max()) + 1
    small = Graph(*diffusion_aggregation.smaller_graph(*rows, group, count))
    kept = np.flatnonzero(group >= 0)
    lumping = csr_array((np.ones(len(kept)), (kept, group[kept])), shape=(len(graph), count))
    expected = (lumping.T @ matrix @ lumping).toarray()
    found = np.diag(small.diagonal())
    row = np.repeat(np.arange(count), np.diff(small.starts))
    found[row, small.neighbours] -= small.conductances
    np.testing.assert_allclose(found, expected, atol=1e-12 * expected.max())
    for i in range(count):
        names = small.neighbours[small.starts[i] : small.starts[i + 1]]
        assert (np.diff(names) > 0).all()


def test_sweeps_are_gauss_and_seidels() -> None:
    n = 9
    graph, matrix = _held_at_rim(CASES["cloud with a fold"](n), n)
    a = matrix.toarray()
    rng = np.random.default_rng(0)
    right = rng.normal(size=(len(graph), 4))
    group = (np.arange(len(graph)) // 4).astype(np.int32)
    group[3] = diffusion_aggregation.LEFT_OUT
    lumping = (group[:, None] == np.arange(group.max() + 1)).astype(float)
    values, coarse = np.empty_like(right), np.empty((group.max() + 1, 4))
    upper = diffusion_relaxation.uppers(graph.starts, graph.neighbours)
    diffusion_relaxation.swept_down(
        graph.starts, upper, graph.neighbours, graph.conductances, graph.diagonal(), right, group,
        values, coarse,
    )  # fmt: skip
    expected = np.linalg.solve(np.tril(a), right)
    np.testing.assert_allclose(values, expected, rtol=1e-10)
    np.testing.assert_allclose(coarse, lumping.T @ (right - a @ expected), atol=1e-10)
    correction = rng.normal(size=coarse.shape)
    diffusion_relaxation.swept_up(
        graph.starts, graph.neighbours, graph.conductances, graph.diagonal(), right, group,
        correction, values,
    )  # fmt: skip
    expected = expected + lumping @ correction
    expected += np.linalg.solve(np.triu(a), right - a @ expected)
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(graph.applied(values), a @ values, atol=1e-10)


def test_elimination_keeps_every_digit_of_what_hangs_weakly() -> None:
    """A chain held at one end by 10⁻²⁰, against arithmetic with fractions."""
    n, weak = 30, 1e-20
    chain = SampleGraph(
        n, np.stack([np.arange(n - 1), np.arange(1, n)], axis=1).astype(np.int32), np.ones(n - 1)
    )
    excess = np.zeros(n)
    excess[0] = weak
    graph = _graph(chain, excess)
    rows = (graph.starts, graph.neighbours, graph.conductances, graph.excess)
    factors, pivots = diffusion_relaxation.eliminated(*rows)
    right = np.zeros((n, 4))
    right[:, 0] = np.arange(n) * weak
    found = np.empty_like(right)
    diffusion_relaxation.back_substituted(factors, pivots, right, found)
    # What flows into the chain all leaves through its end.
    inflow = [Fraction(float(r)) for r in right[:, 0]]
    value = sum(inflow) / Fraction(weak)
    expected = [value]
    for k in range(1, n):
        value += sum(inflow[k:])
        expected.append(value)
    np.testing.assert_allclose(found[:, 0], [float(v) for v in expected], rtol=1e-13)
    assert (found[:, 1:] == 0.0).all()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("n", [34, 102])
def test_convergence(case: str, n: int) -> None:
    """Less than half the residual is left per cycle, whatever the size and the conductances."""
    _converges(case, n)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("n", [318, 1002])
def test_convergence_of_large_graphs(case: str, n: int) -> None:
    _converges(case, n)


def _converges(case: str, n: int) -> None:
    graph, matrix = _held_at_rim(CASES[case](n), n)
    # Noise at the rim, as of holes, and everywhere, which has a share of every mode.
    right = np.random.default_rng(5).normal(size=(len(graph), 4))
    right[:, :2] *= graph.excess[:, None]
    right[:, 3] = graph.diagonal()
    hierarchy = Hierarchy(graph)
    coarser = zip(hierarchy.sizes[1:], hierarchy.sizes[:-1], strict=True)
    assert all(a <= 0.34 * b for a, b in coarser)
    assert hierarchy.sizes[-1] <= 400
    assert hierarchy.complexity < 1.8
    found = solved(graph, hierarchy, right, EIGHT, np.array([1e-8, 1e-8, np.inf, np.inf]), 60)
    assert found.converged
    cycles = len(found.corrections)
    factors = found.residuals[-1] ** (1.0 / cycles)
    print(f"{case:20s}{len(graph):9d} unknowns {cycles:3d} cycles, factors {factors.round(3)}")
    assert factors[:2].max() < 0.5
    assert factors[2] < 0.55
    # The residual that is carried along is the true one.
    true = np.linalg.norm(right - matrix @ found.values, axis=0) / np.linalg.norm(right, axis=0)
    assert true[:2].max() < 1e-7


@pytest.mark.parametrize("decades", [0, 8, 12])
def test_a_chain_falls_in_proportion_to_resistance(decades: int) -> None:
    """From 0 at one end to 1 at the other, over 5000 links of random conductances."""
    links = 5000
    conductances = 10.0 ** np.random.default_rng(0).uniform(-decades, 0, links + 1)
    edges = np.stack([np.arange(links - 1), np.arange(1, links)], axis=1).astype(np.int32)
    excess = np.zeros(links)
    excess[[0, -1]] = conductances[[0, -1]]
    graph = _graph(SampleGraph(links, edges, conductances[1:-1]), excess)
    right = np.zeros((links, 4))
    right[-1, 0] = conductances[-1]
    found = solved(graph, Hierarchy(graph), right, EIGHT, np.full(4, 1e-8), 60)
    resistance = np.cumsum(1.0 / conductances)
    assert found.converged
    np.testing.assert_allclose(found.values[:, 0], resistance[:-1] / resistance[-1], atol=1e-7)


def test_a_star_cannot_be_lumped_and_is_solved_all_the_same() -> None:
    leaves = 3000
    edges = np.stack([np.zeros(leaves), np.arange(1, leaves + 1)], axis=1).astype(np.int32)
    excess = np.zeros(leaves + 1)
    excess[1] = 1.0
    graph = _graph(SampleGraph(leaves + 1, edges, np.ones(leaves)), excess)
    hierarchy = Hierarchy(graph)
    assert hierarchy.sizes[-1] > 400
    right = np.tile(excess[:, None], 4)
    found = solved(graph, hierarchy, right, 1e-2 * EIGHT, ANY, 50)
    assert found.converged
    np.testing.assert_allclose(found.values, 1.0, rtol=1e-8)


def test_the_same_bits_again() -> None:
    graph, _ = _held_at_rim(grid(60), 60)
    right = np.random.default_rng(5).normal(size=(len(graph), 4))
    one = solved(graph, Hierarchy(graph), right, EIGHT, ANY, 60)
    other = solved(graph, Hierarchy(graph), right, EIGHT, ANY, 60)
    assert one.values.tobytes() == other.values.tobytes()


def test_right_hand_sides_do_not_disturb_each_other() -> None:
    """A channel that is solved, or zero, takes no steps and makes no numbers that are none."""
    graph, _ = _held_at_rim(grid(40), 40)
    right = np.zeros((len(graph), 4))
    right[:, 1] = graph.excess
    right[:, 2] = 1e-300
    found = solved(graph, Hierarchy(graph), right, EIGHT, ANY, 60)
    assert np.isfinite(found.values).all()
    assert (found.values[:, 0] == 0.0).all()
    np.testing.assert_allclose(found.values[:, 1], 1.0, rtol=1e-7)
