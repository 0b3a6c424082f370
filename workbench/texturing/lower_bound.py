"""A bound that no labelling's energy is below, to say how good a labelling is at least.

Source: Kolmogorov 2006, sequential tree-reweighted message passing: chains of triangles, each
solved exactly, share the costs so that the sum of their minima rises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.tree_messages import seam_table, swept
from workbench.texturing.labelling import LabellingProblem


def lower_bound(problem: LabellingProblem, sweeps: int = 10) -> float:
    """No labelling of the problem costs less; exact where the triangles make a chain.

    Parameters
    ----------
    sweeps : there and back; time and memory grow with edges times candidates squared. With none
        it is the sum of the least data costs.
    """
    count = np.diff(problem.starts)
    some = np.flatnonzero(count)
    if not len(some):
        return 0.0
    best = float(np.minimum.reduceat(problem.costs, problem.starts[some]).sum())
    if sweeps <= 0:
        return best
    # An edge to a triangle without candidates costs nothing, whatever it is told.
    told = (count[problem.edges] > 0).all(axis=1)
    edges = problem.edges[told]
    sides = edges.ravel()
    by_side = np.argsort(sides, kind="stable")
    triangle_starts = _starts(np.bincount(sides, minlength=problem.triangles))
    message_starts = _starts(count[sides])
    messages = np.zeros(message_starts[-1])
    table_starts = _starts(count[edges].prod(axis=1))
    table = seam_table(
        problem.starts, problem.labels, edges, problem.edge_starts[:-1][told], problem.edge_labels,
        problem.edge_colors, problem.edge_weights[told], table_starts,
    )  # fmt: skip
    forward = np.arange(problem.triangles)
    for _ in range(sweeps):
        for order in (forward, forward[::-1].copy()):
            # Either order is its own inverse: it is the ranks, too.
            bound = swept(
                order, order, problem.starts, problem.costs, edges, triangle_starts, by_side,
                table_starts, table, message_starts, messages,
            )  # fmt: skip
            best = max(best, bound)
    return best


def _starts(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
