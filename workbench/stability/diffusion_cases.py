"""Colour spread over holes where conductances, sizes and what is known go to extremes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from workbench.color.diffusion_graph import SampleGraph, edges_of_cloud, sample_graph
from workbench.color.inpainting import (
    INPAINTED,
    UNPAINTED,
    Inpainting,
    InpaintingSettings,
    inpainted,
)
from workbench.stability.case import Bound, Case, Measured, Refused

_METHOD = "diffusion of colour"
_COLORS = tuple[NDArray[np.float64], NDArray[np.float64]]


def square_graph(n: int, conductance_of: Callable[[int], NDArray[np.float64]]) -> SampleGraph:
    """Samples in a square of n × n, row by row; ``conductance_of`` is told the number of edges."""
    number = np.arange(n * n, dtype=np.int32).reshape(n, n)
    pairs = ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    return SampleGraph(n * n, edges, conductance_of(len(edges)))


def _rim_of_noise(n: int) -> _COLORS:
    """Colours (n², 3) of a square, random at its border and unknown within, and weights."""
    inside = np.zeros((n, n), bool)
    inside[1:-1, 1:-1] = True
    colors = np.random.default_rng(2).uniform(0.0, 1.0, (n * n, 3))
    colors[inside.ravel()] = np.nan
    return colors, 1.0 - inside.ravel()


def _plain_solution(graph: SampleGraph, colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same equations by a direct solver, for weights that are all one."""
    i, j = graph.edges.T
    n = graph.count
    joined = coo_array((np.tile(graph.conductances, 2), (np.r_[i, j], np.r_[j, i])), (n, n))
    matrix = csr_array(diags_array(joined.sum(axis=1)) - joined)
    open_ = np.flatnonzero(np.isnan(colors).any(axis=1))
    known = np.nan_to_num(colors)
    right = -(matrix[open_] @ known)
    found = known.copy()
    found[open_] = splu(csc_array(matrix[open_][:, open_])).solve(right)
    return found


def _told(found: Inpainting) -> str:
    last = f"{found.residuals[-1].max():.1e}" if len(found.residuals) else "0"
    return (
        f"condition {found.condition:.3g}, residual {last} after {found.cycles} cycles, "
        f"error {found.error:.1e}"
    )


def _against_direct(graph: SampleGraph, n: int) -> Measured | Refused:
    colors, weights = _rim_of_noise(n)
    found = inpainted(colors, weights, graph)
    if not found.converged:
        return Refused(f"not converged: {_told(found)}")
    return Measured(
        float(np.abs(found.colors - _plain_solution(graph, colors)).max()), _told(found)
    )


def _decades(count: int) -> NDArray[np.float64]:
    return np.asarray(10.0 ** np.random.default_rng(0).uniform(-8.0, 0.0, count))


def _random_conductances() -> Measured | Refused:
    return _against_direct(square_graph(60, _decades), 60)


def _one_way() -> Measured | Refused:
    """Rows that conduct and columns that conduct a hundred-millionth of it."""
    return _against_direct(square_graph(60, lambda count: np.repeat([1.0, 1e-8], count // 2)), 60)


def _inclusions() -> Measured | Refused:
    """A checkerboard of fields, every other of which conducts a hundred-millionth."""
    graph = square_graph(64, np.ones)
    row, column = np.divmod(np.arange(64 * 64), 64)
    poor = (row // 8 + column // 8) % 2 == 1
    return _against_direct(
        replace(graph, conductances=np.where(poor[graph.edges].any(axis=1), 1e-8, 1.0)), 64
    )


def _denormal_conductances() -> Measured | Refused:
    """Conductances at the very end of the range of numbers, all the same."""
    colors, weights = _rim_of_noise(40)
    found = inpainted(colors, weights, square_graph(40, lambda count: np.full(count, 5e-324)))
    plain = _plain_solution(square_graph(40, np.ones), colors)
    return Measured(float(np.abs(found.colors - plain).max()), _told(found))


def _islands() -> Measured:
    """Holes that no coloured sample touches, beside some that one does: flags tell which."""
    graph = square_graph(40, np.ones)
    row, column = np.divmod(np.arange(1600), 40)
    cut = (row[graph.edges] // 10 != (row[graph.edges] // 10)[:, :1]).any(axis=1)
    graph = SampleGraph(1600, graph.edges[~cut], graph.conductances[~cut])
    weights = ((row // 10 == 1) & (column == 0)).astype(float)
    colors = np.repeat(np.where(weights > 0, 0.25, np.nan)[:, None], 3, axis=1)
    found = inpainted(colors, weights, graph)
    reached = row // 10 == 1
    wrong = (found.flags == UNPAINTED) != ~reached
    wrong |= np.isfinite(found.colors).all(axis=1) != reached
    off = np.abs(found.colors[reached] - 0.25).max()
    told = f"{found.islands_unpainted} of {found.islands} islands unpainted"
    return Measured(float(max(wrong.sum(), off)), told)


def _all_unknown() -> Measured:
    found = inpainted(np.full((400, 3), np.nan), np.zeros(400), square_graph(20, np.ones))
    return Measured(float((found.flags != UNPAINTED).sum()), _told(found))


def _single_precision() -> Measured:
    graph = square_graph(60, _decades)
    colors, weights = _rim_of_noise(60)
    double = inpainted(colors, weights, graph)
    single = inpainted(colors.astype(np.float32).astype(np.float64), weights, graph)
    return Measured(float(np.abs(double.colors - single.colors).max()), _told(single))


def _condition() -> Measured:
    """The condition that is told against that of the whole matrix, inverted."""
    n = 16
    graph = square_graph(n, _decades)
    colors, weights = _rim_of_noise(n)
    found = inpainted(colors, weights, graph)
    i, j = graph.edges.T
    matrix = np.zeros((n * n, n * n))
    matrix[i, j] = matrix[j, i] = -graph.conductances
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    open_ = weights == 0
    scaled = matrix[open_][:, open_] / np.diag(matrix)[open_, None]
    true = np.linalg.cond(scaled, np.inf)
    return Measured(abs(found.condition / true - 1.0), f"condition {found.condition:.5g}")


def _many_unknowns(n: int) -> Measured | Refused:
    """A linear ramp around a square hole, which the diffusion must go on with."""
    graph = square_graph(n, np.ones)
    row, column = np.divmod(np.arange(n * n), n)
    ramp = (row + 2.0 * column) / (3.0 * (n - 1))
    edge = (row % (n - 1) == 0) | (column % (n - 1) == 0)
    colors = np.where(edge[:, None], ramp[:, None], np.nan).repeat(3, axis=1)
    found = inpainted(colors[:, :3], edge.astype(float), graph)
    if not found.converged:
        return Refused(f"not converged: {_told(found)}")
    falling = (np.diff(found.residuals.max(axis=1)) < 0).all()
    error = float(np.abs(found.colors - ramp[:, None]).max())
    return Measured(error if falling else np.inf, f"{found.unknowns} unknowns, {_told(found)}")


def _many_stiff(n: int) -> Measured | Refused:
    """The change that a thousand times more exactness makes, over the error that is told."""
    graph = square_graph(n, _decades)
    colors, weights = _rim_of_noise(n)
    found = inpainted(colors, weights, graph)
    exact = inpainted(colors, weights, graph, InpaintingSettings(tolerance=1e-11, max_cycles=200))
    if not (found.converged and exact.converged):
        return Refused(f"not converged: {_told(found)}")
    change = np.abs(found.colors - exact.colors).max()
    return Measured(float(change / found.error), f"{found.unknowns} unknowns, {_told(found)}")


def _coincident_cloud() -> Measured:
    """Samples of a cloud of which half lie at one place."""
    rng = np.random.default_rng(3)
    points = np.concatenate([rng.uniform(0, 1, (300, 3)), np.full((300, 3), 0.5)])
    graph = sample_graph(edges_of_cloud(points), points)
    colors, weights = rng.uniform(0.2, 0.6, (600, 3)), np.ones(600)
    weights[::3] = 0
    found = inpainted(colors, weights, graph)
    painted = found.colors[found.flags == INPAINTED]
    low, high = colors[weights > 0].min(axis=0), colors[weights > 0].max(axis=0)
    return Measured(float(np.maximum(low - painted, painted - high).max()), _told(found))


def _case(
    name: str, stiff: str, run: Callable[[], Measured | Refused], bound: Bound, quick: bool = True
) -> Case:
    return Case(f"color/{name}", _METHOD, stiff, run, bound, quick=quick)


_TOLERANCE = Bound(1e-6, "", "the tolerance of 1e-8, times what the estimate of the error allows")
_NONE = Bound(0.0, "", "none is allowed")

DIFFUSION_CASES = (
    _case("conductances 1e-8 to 1", "Conductances over eight decades, at random.",
          _random_conductances, _TOLERANCE),
    _case("conductance 1e-8 across", "Rows conduct 1e8 times as well as columns.",
          _one_way, _TOLERANCE),
    _case("inclusions 1e-8", "A checkerboard of good and very bad conductors.",
          _inclusions, _TOLERANCE),
    _case("denormal conductances", "Conductances of 5e-324.",
          _denormal_conductances, _TOLERANCE),
    _case("islands", "Three of four parts have no colour to start from.", _islands,
          Bound(1e-12, "", "a constant rim gives that constant; no flag may be wrong")),
    _case("nothing known", "No sample has a colour.", _all_unknown, _NONE),
    _case("float32 against float64", "The same problem from colours in float32.",
          _single_precision, Bound(6e-8, "", "half a step of float32: a mean magnifies nothing")),
    _case("condition told", "Condition as told against the inverted matrix.",
          _condition, Bound(0.01, "relative", "the estimate's own tolerance of 1e-3, ten times")),
    _case("2.5e5 unknowns", "A hole of 500 × 500 samples.",
          partial(_many_unknowns, 502), _TOLERANCE, quick=False),
    _case("1e6 unknowns", "A hole of 1000 × 1000 samples.",
          partial(_many_unknowns, 1002), _TOLERANCE, quick=False),
    _case("1e6 unknowns, 1e-8 to 1", "A million samples that conduct anyhow.",
          partial(_many_stiff, 1002),
          Bound(1.0, "of the error told", "the estimate says how far the solution may be off"),
          quick=False),
    _case("coincident samples", "Half of a cloud lies at one place.",
          _coincident_cloud, Bound(1e-12, "", "the maximum principle")),
)  # fmt: skip
