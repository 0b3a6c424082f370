"""α-expansion: photograph by photograph, the best set of triangles to take it.

Source: Boykov, Veksler and Zabih 2001; the max-flow is PyMaxflow's (Boykov and Kolmogorov 2004).
Costs are those of every edge and every pair of photographs: seams where both look alike are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, WorkbenchError
from workbench.kernels.expansion_graph import expansion_graph, take, undominated
from workbench.kernels.pair_costs import rows_of_labels
from workbench.texturing.labelling import Energy, Labelling, LabellingProblem, by_photo
from workbench.texturing.lower_bound import lower_bound

# Rounding breaks the triangle inequality by this share at the most.
_ROUNDING = 1e-9
# A move must lower the energy by more than rounding does.
_LEAST_GAIN = 1e-12


def expanded(
    problem: LabellingProblem,
    max_cycles: int = 2,
    order: Sequence[int] | None = None,
    bound_sweeps: int = 0,
) -> Labelling:
    """A labelling that few moves could better, found from the cheapest data costs.

    Parameters
    ----------
    max_cycles : each tries every photograph once; it ends before if a cycle changes nothing.
    order : photographs in the order they are tried; rising by default. Those that it lacks are
        not tried.
    bound_sweeps : of `lower_bound`; 0 leaves the bound at the least data costs.

    Raises
    ------
    InputError : the number of cycles is negative.
    """
    if max_cycles < 0:
        raise InputError("cycles of expansion cannot be negative", found=str(max_cycles))
    work = without_dominated(problem)
    state = _State(work)
    photos = np.unique(work.labels).tolist() if order is None else list(order)
    before = work.energy(state.labels)
    cycles: list[Energy] = []
    converged = not photos
    while len(cycles) < max_cycles and not converged:
        taken = [state.expand(photo) for photo in photos]
        converged = not any(taken)
        cycles.append(work.energy(state.labels))
    bound = lower_bound(work, bound_sweeps)
    return Labelling(
        state.labels, before, tuple(cycles), converged, bound,
        (state.solved, state.taken), state.flow_seconds,
    )  # fmt: skip


def without_dominated(problem: LabellingProblem) -> LabellingProblem:
    """The same without candidates that no best labelling has; their colours stay."""
    keep = np.ones(len(problem.labels), bool)
    sides = problem.edges.ravel()
    by_triangle = np.argsort(sides, kind="stable")
    starts = np.zeros(problem.triangles + 1, np.int64)
    np.cumsum(np.bincount(sides, minlength=problem.triangles), out=starts[1:])
    undominated(
        problem.starts, problem.labels, problem.costs, starts, (by_triangle >> 1).astype(np.int32),
        problem.edge_starts, problem.edge_labels, problem.edge_colors, problem.edge_weights, keep,
    )  # fmt: skip
    if keep.all():
        return problem
    kept = np.zeros(len(keep) + 1, np.int64)
    np.cumsum(keep, out=kept[1:])
    return replace(
        problem,
        starts=kept[problem.starts],
        labels=problem.labels[keep],
        costs=problem.costs[keep],
    )


@dataclass(frozen=True)
class _Photo:
    """Where a photograph is a candidate: triangles, their costs, and its rows of colours."""

    triangles: NDArray[np.int64]
    costs: NDArray[np.float64]
    rows: NDArray[np.int64]


class _State:
    """The labelling under way."""

    def __init__(self, problem: LabellingProblem) -> None:
        self.problem = problem
        self.labels = problem.cheapest()
        self.solved, self.taken, self.flow_seconds = 0, 0, 0.0
        self._weights = problem.edge_weights
        self._edge_of_row = np.repeat(
            np.arange(len(problem.edges), dtype=np.int32), np.diff(problem.edge_starts)
        )
        self._rows = rows_of_labels(
            self.labels, problem.edges, problem.edge_starts, problem.edge_labels
        )
        chosen = problem.rows(self.labels)
        self._costs = np.where(chosen >= 0, problem.costs[chosen], 0.0) if len(problem.costs) else (
            np.zeros(problem.triangles)
        )  # fmt: skip
        self._node = np.full(problem.triangles, -1, np.int32)
        # When a triangle last changed, and when a photograph was last tried.
        self._now = 1
        self._changed = np.zeros(problem.triangles, np.int64)
        self._tried: dict[int, int] = {}
        self._photos = self._by_photo()

    def expand(self, photo: int) -> bool:
        """Try a photograph: whether it was taken anywhere."""
        if photo not in self._photos:
            return False
        own = self._photos[photo]
        self._now += 1
        tried, self._tried[photo] = self._tried.get(photo, 0), self._now
        # A move that was the best stays the best while nothing around it has changed.
        if tried and self._last_change(own) <= tried:
            return False
        free = self.labels[own.triangles] != photo
        triangles = own.triangles[free]
        self._node[triangles] = np.arange(len(triangles), dtype=np.int32)
        gain = own.costs[free] - self._costs[triangles]
        pairs, capacities, worst = expansion_graph(
            own.rows, self._edge_of_row, self.problem.edges, self._weights,
            self.problem.edge_colors, self._rows, self._node, gain,
        )  # fmt: skip
        self._node[triangles] = -1
        if worst > _ROUNDING:
            raise WorkbenchError(
                "costs of seams break the triangle inequality", found=f"by {worst:.1e} of a cost"
            )
        if (gain >= 0.0).all():
            return False
        chosen = self._cut(gain, pairs, capacities)
        seams = ~chosen[pairs[:, 0]] & chosen[pairs[:, 1]]
        change = float(gain[chosen].sum() + capacities[seams].sum())
        scale = float(np.abs(gain[chosen]).sum() + capacities[seams].sum())
        if not change < -_LEAST_GAIN * scale:
            return False
        self._take(photo, triangles[chosen], own.costs[free][chosen], own.rows)
        return True

    def _last_change(self, own: _Photo) -> int:
        around = self.problem.edges[self._edge_of_row[own.rows]]
        return int(
            max(self._changed[own.triangles].max(initial=0), self._changed[around].max(initial=0))
        )

    def _cut(
        self, gain: NDArray[np.float64], pairs: NDArray[np.int32], capacities: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(nodes,) which of them take the photograph."""
        import maxflow  # type: ignore[import-untyped]

        start = perf_counter()
        graph = maxflow.GraphFloat(len(gain), max(len(pairs), 1))
        nodes = np.asarray(graph.add_nodes(len(gain)))
        if len(pairs):
            graph.add_edges(
                nodes[pairs[:, 0]], nodes[pairs[:, 1]], capacities, np.zeros(len(pairs))
            )
        graph.add_grid_tedges(nodes, np.maximum(gain, 0.0), np.maximum(-gain, 0.0))
        graph.maxflow()
        self.solved += 1
        found = np.asarray(graph.get_grid_segments(nodes))
        self.flow_seconds += perf_counter() - start
        return found

    def _take(
        self,
        photo: int,
        triangles: NDArray[np.int64],
        costs: NDArray[np.float64],
        rows: NDArray[np.int64],
    ) -> None:
        self.labels[triangles] = photo
        self._costs[triangles] = costs
        self._changed[triangles] = self._now
        self.taken += 1
        mark = np.zeros(self.problem.triangles, bool)
        mark[triangles] = True
        take(rows, self._edge_of_row, self.problem.edges, mark, self._rows)

    def _by_photo(self) -> dict[int, _Photo]:
        problem = self.problem
        owner = np.repeat(np.arange(problem.triangles), np.diff(problem.starts))
        rows = by_photo(problem.edge_labels)
        none = np.zeros(0, np.int64)
        return {
            photo: _Photo(owner[which], problem.costs[which], rows.get(photo, none))
            for photo, which in by_photo(problem.labels).items()
        }
