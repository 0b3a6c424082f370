"""A hierarchy of ever smaller graphs for a graph's diffusion, and its multigrid cycle.

Each graph has about a quarter of the nodes of the one before: nodes are lumped with those they
are joined to most strongly, in pairs and then pairs of pairs, so that coarse corrections follow
creases and never jump them. A correction is one number per group; the graph of the groups
has the sums of the conductances between them (Galerkin's operator), hence is a graph again.

Corrections that are constant within groups converge ever slower in plain V-cycles as graphs
grow. So each coarse graph is solved by two steps of conjugate gradients whose preconditioner is
the next cycle (a K-cycle): the cost stays within about twice the finest graph's, and the factor
hardly depends on the size.

Sources: Jaspe 2018, 3.4.6 (quarter coarsening to fewer than 1000 nodes); Napov and Notay 2012
(groups with a guaranteed two-grid bound); Notay and Vassilevski 2008 (K-cycle).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.diffusion_aggregation import (
    LEFT_OUT,
    diagonal_of,
    merged,
    pairs,
    smaller_graph,
)
from workbench.kernels.diffusion_relaxation import (
    CHANNELS,
    added,
    applied,
    back_substituted,
    eliminated,
    products,
    swept_down,
    swept_up,
    uppers,
)

Values = NDArray[np.float64]

# Napov and Notay's: the two-grid condition number stays below it, whatever the conductances.
_QUALITY = 8.0
_DIRECT = 400
# Where the bound forbids many mergings, groups are merged again, until a quarter is near.
_MERGINGS, _QUARTER = 3, 0.3
_STALLED = 0.9
# A second step where the first left more than this of the residual: Notay and Vassilevski's.
_ENOUGH = 0.25


@dataclass(frozen=True)
class Graph:
    """A weighted graph by rows, some of its nodes joined to given values.

    Attributes
    ----------
    starts : (n + 1,) int64, where each row begins.
    neighbours : (e,) int32, ascending within a row; every edge is in both rows.
    conductances : (e,) float64 > 0.
    excess : (n,) float64 ≥ 0, conductance to given values.
    """

    starts: NDArray[np.int64]
    neighbours: NDArray[np.int32]
    conductances: NDArray[np.float64]
    excess: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.excess)

    def applied(self, values: Values) -> Values:
        """The diffusion's matrix times (n, 4)."""
        out = np.empty_like(values)
        applied(self.starts, self.neighbours, self.conductances, self.excess, values, out)
        return out

    def diagonal(self) -> NDArray[np.float64]:
        """(n,) sum of the conductances at each node."""
        return np.asarray(diagonal_of(self.starts, self.conductances, self.excess))


class _Level:
    """A graph, the groups of its nodes, and memory for a sweep."""

    def __init__(
        self, graph: Graph, diagonal: NDArray[np.float64], group: NDArray[np.int32], groups: int
    ) -> None:
        self.graph, self.group = graph, group
        self._diagonal = diagonal
        self._upper = uppers(graph.starts, graph.neighbours)
        self._coarse_right = np.empty((groups, CHANNELS))

    def down(self, right: Values) -> tuple[Values, Values]:
        """Values after a forward sweep from zero, and the groups' right-hand sides."""
        g = self.graph
        values = np.empty_like(right)
        coarse = np.empty_like(self._coarse_right)
        swept_down(
            g.starts, self._upper, g.neighbours, g.conductances, self._diagonal, right,
            self.group, values, coarse,
        )  # fmt: skip
        return values, coarse

    def up(self, right: Values, values: Values, coarse: Values) -> None:
        """Add the groups' corrections to the values and sweep backward."""
        g = self.graph
        swept_up(
            g.starts, g.neighbours, g.conductances, self._diagonal, right, self.group, coarse,
            values,
        )  # fmt: skip


class Hierarchy:
    """Smaller graphs of one graph, in each of whose pieces some node has excess.

    Attributes
    ----------
    sizes : nodes of each graph, the finest first.
    complexity : entries of all graphs' matrices over those of the finest.
    """

    def __init__(self, graph: Graph) -> None:
        self._levels: list[_Level] = []
        self.sizes = [len(graph)]
        entries = [len(graph.neighbours) + len(graph)]
        while len(graph) > _DIRECT:
            diagonal = graph.diagonal()
            group, count, coarse = _grouped(graph, diagonal)
            if count > _STALLED * len(graph):
                break
            self._levels.append(_Level(graph, diagonal, group, count))
            graph = coarse
            self.sizes.append(len(graph))
            entries.append(len(graph.neighbours) + len(graph))
        self.complexity = sum(entries) / entries[0]
        self._factors: tuple[Values, NDArray[np.float64]] | None = None
        if len(graph) <= _DIRECT:
            self._factors = eliminated(
                graph.starts, graph.neighbours, graph.conductances, graph.excess
            )
        else:
            # Nothing can be lumped any further: sweeps must do.
            nothing = np.full(len(graph), LEFT_OUT, np.int32)
            self._last = _Level(graph, graph.diagonal(), nothing, 0)

    def cycle(self, right: Values) -> Values:
        """An approximate solution (n, 4) for a right-hand side, from zero."""
        return self._cycle(0, right)

    def _cycle(self, depth: int, right: Values) -> Values:
        if depth == len(self._levels):
            return self._solved_last(right)
        level = self._levels[depth]
        values, coarse_right = level.down(right)
        level.up(right, values, self._coarse(depth + 1, coarse_right))
        return values

    def _coarse(self, depth: int, right: Values) -> Values:
        """Two steps of conjugate gradients on a coarse graph; ``right`` is used up."""
        first = self._cycle(depth, right)
        if depth == len(self._levels):
            return first
        graph = self._levels[depth].graph
        image = graph.applied(first)
        energy, gain = products(first, image), products(first, right)
        step = quotient(gain, energy)
        before = products(right, right)
        added(right, -step, image)
        if (products(right, right) <= _ENOUGH**2 * before).all():
            first *= step
            return first
        second = self._cycle(depth, right)
        image_2 = graph.applied(second)
        mixed = products(second, image)
        energy_2 = products(second, image_2) - mixed * quotient(mixed, energy)
        step_2 = quotient(products(second, right), energy_2)
        first *= step - step_2 * quotient(mixed, energy)
        added(first, step_2, second)
        return first

    def _solved_last(self, right: Values) -> Values:
        if self._factors is None:
            values, nothing = self._last.down(right)
            self._last.up(right, values, nothing)
            return values
        values = np.empty_like(right)
        back_substituted(*self._factors, right, values)
        return values


def quotient(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of a and b, 0 where b is not positive: a right-hand side that is solved takes no step."""
    result = np.zeros_like(a)
    np.divide(a, b, out=result, where=b > 0.0)
    return result


def _grouped(graph: Graph, diagonal: NDArray[np.float64]) -> tuple[NDArray[np.int32], int, Graph]:
    """Group of each node, their number, and their graph."""
    rows = (graph.starts, graph.neighbours, graph.conductances, graph.excess)
    group, count = pairs(*rows, diagonal, _QUALITY)
    lumped = int((group >= 0).sum())
    for _ in range(_MERGINGS):
        if count <= _QUARTER * lumped:
            break
        starts, neighbours, conductances, _ = smaller_graph(*rows, group, count)
        group, count = merged(
            *rows, diagonal, group, count, starts, neighbours, conductances, _QUALITY
        )
    return group, count, Graph(*smaller_graph(*rows, group, count))
