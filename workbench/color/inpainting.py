"""Colour for the samples no photograph shows, spread from those around them.

Nothing is invented: the colours of a hole are the smoothest that meet those at its rim, under a
diffusion that is slow across creases (`workbench.color.diffusion_graph`). None is lighter or
darker than the rim. What no coloured sample can be reached from stays without colour.

Only the samples of holes and the ring of coloured ones around them enter, and those keep their
colours to the last bit. How far a ring sample is heard depends on its weight: the rim of a hole
is where photographs are seen at a slant, through mask borders or in half-shadow, and the worst
of them should not tint what better ones are near. So the conductance of its edges falls in
proportion to its weight below ``trusted`` times the median weight around the same hole. Weights
are compared within a hole: where all are small, all count in full.

Sources: Jaspe 2018, 3.4.6; Perona and Malik 1990.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from workbench.color.diffusion_graph import SampleGraph
from workbench.color.diffusion_hierarchy import Graph, Hierarchy
from workbench.color.diffusion_solver import solved
from workbench.errors import InputError, SettingsError
from workbench.kernels.diffusion_aggregation import rows_of_edges

PHOTOGRAPHED, INPAINTED, UNPAINTED = 0, 1, 2

# Below, products of conductances would leave the range of numbers.
_LEAST = 1e-60
# A cycle's change was never less than a quarter of the error it left, in trials of all kinds.
_ERROR_OVER_CHANGE = 4.0
_CONDITION_TOLERANCE = 1e-3
_GIVEN = "colour of a sample with weight"


@dataclass(frozen=True)
class InpaintingSettings:
    """How colour is spread.

    Attributes
    ----------
    tolerance : of the residual, relative to the right-hand side, and of the last cycle's
        largest change, relative to the range of the colours around the holes.
    max_cycles : multigrid cycles at most; 10 in Jaspe 2018.
    trusted : a ring sample counts in full from this share of the median weight around its hole
        on; 0 lets all count in full.
    """

    tolerance: float = 1e-8
    max_cycles: int = 60
    trusted: float = 0.5

    def __post_init__(self) -> None:
        """Raise `SettingsError` for what no run can meet."""
        if not (self.tolerance > 0.0 and self.max_cycles >= 1 and self.trusted >= 0.0):
            raise SettingsError(
                "these settings of the inpainting cannot be met",
                expected="tolerance > 0, max_cycles ≥ 1 and trusted ≥ 0",
                found=f"{self}",
            )


@dataclass(frozen=True)
class Inpainting:
    """Colours and how they were found.

    Attributes
    ----------
    colors : (n, 3) float64; as given where photographed, NaN where unpainted.
    flags : (n,) uint8, ``PHOTOGRAPHED``, ``INPAINTED`` or ``UNPAINTED``.
    converged : whether the tolerance was met; if not, ``error`` tells what that means.
    residuals : (cycles + 1, 3) norm of the residual per channel over that of the right-hand
        side: before the first and after every cycle.
    corrections : (cycles, 3) largest change a cycle proposed, over the colours' range.
    error : how far an inpainted colour may be from the exact solution, in units of the colours,
        by an estimate from the last cycle's largest change.
    condition : of the matrix divided by its diagonal, in the maximum norm, as estimated; 1
        without unknowns.
    unknowns : samples that were solved for.
    islands, islands_unpainted : connected holes, and those no coloured sample touches.
    sizes : nodes of the hierarchy's graphs, the finest first.
    complexity : entries of all their matrices over those of the finest.
    """

    colors: NDArray[np.float64]
    flags: NDArray[np.uint8]
    converged: bool
    residuals: NDArray[np.float64]
    corrections: NDArray[np.float64]
    error: float
    condition: float
    unknowns: int
    islands: int
    islands_unpainted: int
    sizes: tuple[int, ...]
    complexity: float

    @property
    def cycles(self) -> int:
        """Multigrid cycles used."""
        return len(self.corrections)

    @property
    def unpainted(self) -> NDArray[np.bool_]:
        """(n,) samples left without colour."""
        return np.asarray(self.flags == UNPAINTED)

    @property
    def factors(self) -> NDArray[np.float64]:
        """(cycles,) by how much each cycle reduced the residual of all channels together."""
        norm = np.sqrt((self.residuals**2).sum(axis=1))
        ratio = np.zeros(self.cycles)
        np.divide(norm[1:], norm[:-1], out=ratio, where=norm[:-1] > 0.0)
        return ratio

    @property
    def factor(self) -> float:
        """Geometric mean of `factors`; 0 without cycles or where the last leaves nothing."""
        return float(np.prod(self.factors ** (1.0 / max(self.cycles, 1)))) if self.cycles else 0.0


def inpainted(
    colors: NDArray[np.float64],
    weights: NDArray[np.float64],
    graph: SampleGraph,
    settings: InpaintingSettings | None = None,
) -> Inpainting:
    """Colours (n, 3) with those of weight 0 filled in.

    Deterministic: the same bits whatever the number of threads.

    Parameters
    ----------
    colors : (n, 3) float, linear light; where the weight is 0 anything, NaN too.
    weights : (n,) ≥ 0 from blending; samples with any weight keep their colours.
    graph : neighbours; edges between two coloured samples may be there or not.

    Raises
    ------
    InputError
        Colours of samples with weight, weights or conductances that are no finite numbers;
        weights or conductances below 0; arrays or edges that do not fit each other.
    """
    settings = settings or InpaintingSettings()
    colors = np.array(colors, np.float64)
    weights = np.asarray(weights, np.float64)
    _check(colors, weights, graph)
    open_ = weights == 0.0
    hole = _Hole(open_, graph)
    flags = np.where(open_, UNPAINTED, PHOTOGRAPHED).astype(np.uint8)
    colors[open_] = np.nan
    flags[hole.samples] = INPAINTED
    if not len(hole.samples):
        return _nothing_to_solve(colors, flags, hole)
    system = _System(hole, colors, weights, settings.trusted)
    hierarchy = Hierarchy(system.graph)
    solution = solved(
        system.graph,
        hierarchy,
        system.right,
        tolerance=np.array([settings.tolerance] * 3 + [_CONDITION_TOLERANCE]),
        last_change=np.array([settings.tolerance] * 3 + [np.inf]),
        max_cycles=settings.max_cycles,
    )
    colors[hole.samples] = system.colors_of(solution.values)
    return Inpainting(
        colors=colors,
        flags=flags,
        converged=solution.converged,
        residuals=solution.residuals[:, :3],
        corrections=solution.corrections[:, :3],
        error=_ERROR_OVER_CHANGE * float((solution.corrections[-1, :3] * system.unit).max()),
        condition=system.condition(solution.values),
        unknowns=len(hole.samples),
        islands=hole.islands,
        islands_unpainted=hole.islands_unpainted,
        sizes=tuple(hierarchy.sizes),
        complexity=hierarchy.complexity,
    )


def _nothing_to_solve(
    colors: NDArray[np.float64], flags: NDArray[np.uint8], hole: _Hole
) -> Inpainting:
    return Inpainting(
        colors=colors,
        flags=flags,
        converged=True,
        residuals=np.zeros((1, 3)),
        corrections=np.zeros((0, 3)),
        error=0.0,
        condition=1.0,
        unknowns=0,
        islands=hole.islands,
        islands_unpainted=hole.islands_unpainted,
        sizes=(),
        complexity=0.0,
    )


class _Hole:
    """The uncoloured samples that can be reached from coloured ones.

    Attributes
    ----------
    samples : (u,) the samples.
    island : (u,) which hole each belongs to, numbered from 0 without gaps.
    edges, conductances : (e, 2) int32 among ``samples`` and (e,), the largest 1.
    rim : (r,) which of ``samples`` each edge to a coloured one starts from.
    ring, rim_conductances : (r,) the coloured sample at its other end, and (r,).
    islands, islands_unpainted : all holes, and those that touch no coloured sample.
    """

    def __init__(self, open_: NDArray[np.bool_], graph: SampleGraph) -> None:
        start, end = graph.edges.T
        used = (graph.conductances > 0.0) & (start != end) & (open_[start] | open_[end])
        start, end, conductances = start[used], end[used], graph.conductances[used]
        if len(conductances):
            conductances = np.maximum(conductances / conductances.max(), _LEAST)
        inner = open_[start] & open_[end]
        number = np.cumsum(open_) - 1
        count = int(open_.sum())
        joined = coo_array(
            (np.ones(int(inner.sum()), bool), (number[start[inner]], number[end[inner]])),
            shape=(count, count),
        )
        self.islands, island = connected_components(joined, directed=False)
        outer = ~inner
        first = np.where(open_[start[outer]], start[outer], end[outer])
        ring = start[outer] + end[outer] - first
        reached = np.zeros(self.islands, bool)
        reached[island[number[first]]] = True
        self.islands_unpainted = int((~reached).sum())
        kept = reached[island]
        self.samples = np.flatnonzero(open_)[kept]
        self.island = (np.cumsum(reached) - 1)[island[kept]]
        new = np.zeros(len(open_), np.int64)
        new[self.samples] = np.arange(len(self.samples))
        inside = inner.copy()
        inside[inner] = kept[number[start[inner]]]
        self.edges = np.stack([new[start[inside]], new[end[inside]]], axis=1).astype(np.int32)
        self.conductances = conductances[inside]
        self.rim, self.ring = new[first], ring
        self.rim_conductances = conductances[outer]


class _System:
    """The equations of all holes: colours relative to each rim's mean, in units of the range.

    Attributes
    ----------
    graph, right : the matrix and the right-hand sides (u, 4): three channels and the diagonal.
    unit : (3,) the largest range of each channel around a hole.
    """

    def __init__(
        self,
        hole: _Hole,
        colors: NDArray[np.float64],
        weights: NDArray[np.float64],
        trusted: float,
    ) -> None:
        self._island = hole.island
        count = len(hole.samples)
        rim_island = hole.island[hole.rim]
        order = np.argsort(rim_island, kind="stable")
        begins = np.flatnonzero(np.diff(rim_island[order], prepend=-1))
        given = colors[hole.ring]
        self._lowest = np.minimum.reduceat(given[order], begins, axis=0)
        self._highest = np.maximum.reduceat(given[order], begins, axis=0)
        held = np.maximum(
            hole.rim_conductances * _trust(weights[hole.ring], rim_island, trusted), _LEAST
        )
        share = held / np.bincount(rim_island, held)[rim_island]
        mean = np.stack([np.bincount(rim_island, share * given[:, c]) for c in range(3)], axis=1)
        # Rounding must not make a rim of one colour into one of two.
        self._mean = np.clip(mean, self._lowest, self._highest)
        span = (self._highest - self._lowest).max(axis=0)
        self.unit = np.where(span > 0.0, span, 1.0)
        relative = (given - self._mean[rim_island]) / self.unit
        excess = np.asarray(np.bincount(hole.rim, held, count), np.float64)
        starts, neighbours, conductances = rows_of_edges(hole.edges, hole.conductances, count)
        self.graph = Graph(starts, neighbours, conductances, excess)
        self._diagonal = self.graph.diagonal()
        self.right = np.stack(
            [*(np.bincount(hole.rim, held * relative[:, c], count) for c in range(3)),
             self._diagonal], axis=1,
        )  # fmt: skip

    def condition(self, values: NDArray[np.float64]) -> float:
        """Norm of D⁻¹ A times that of its inverse, from the solution for D, the fourth.

        A has an inverse without negative numbers, so the norm of (D⁻¹ A)⁻¹ is the maximum of
        A⁻¹ D 1.
        """
        norm = (2.0 - self.graph.excess / self._diagonal).max()
        return float(norm * values[:, 3].max())

    def colors_of(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Colours (u, 3), brought into the range of each rim, which the exact ones keep to."""
        found = values[:, :3] * self.unit + self._mean[self._island]
        found = np.minimum(found, self._highest[self._island])
        return np.asarray(np.maximum(found, self._lowest[self._island]))


def _trust(
    weights: NDArray[np.float64], island: NDArray[np.int64], trusted: float
) -> NDArray[np.float64]:
    """(r,) in (0, 1], how far ring samples of these weights around these holes are heard."""
    order = np.lexsort((weights, island))
    begins = np.flatnonzero(np.diff(island[order], prepend=-1))
    sizes = np.diff(np.append(begins, len(island)))
    median = weights[order][begins + sizes // 2]
    full = trusted * median[island]
    trust = np.ones_like(weights)
    np.divide(weights, full, out=trust, where=weights < full)
    return trust


def _check(colors: NDArray[np.float64], weights: NDArray[np.float64], graph: SampleGraph) -> None:
    """Raise where the input cannot be meant."""
    n = len(weights)
    if weights.ndim != 1 or colors.shape != (n, 3) or graph.count != n:
        raise InputError(
            "colours, weights and graph are not of the same samples",
            expected="colours (n, 3), weights (n,) and a graph of n samples",
            found=f"{colors.shape}, {weights.shape} and {graph.count} samples",
        )
    edges = graph.edges
    if edges.shape != (len(graph.conductances), 2) or not (
        len(edges) == 0 or (edges.min() >= 0 and edges.max() < n)
    ):
        raise InputError(
            "the edges do not fit the samples",
            expected=f"pairs of numbers from 0 to {n - 1}, with a conductance each",
            found=f"edges {edges.shape}, conductances {graph.conductances.shape}",
        )
    wrong = (
        ("weight", ~(np.isfinite(weights) & (weights >= 0.0))),
        ("conductance", ~(np.isfinite(graph.conductances) & (graph.conductances >= 0.0))),
        (_GIVEN, (weights > 0.0) & ~np.isfinite(colors).all(axis=1)),
    )
    for name, bad in wrong:
        if bad.any():
            raise InputError(
                f"{int(bad.sum())} × {name}: no number that can be used",
                where=f"number {int(np.argmax(bad))}",
                expected="a finite number" if name == _GIVEN else "a finite number from 0 on",
                fix="give samples whose colour is not known the weight 0",
            )
