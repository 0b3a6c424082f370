"""A bound that no labelling's energy is below, to say how good a labelling is at least.

Source: Kolmogorov 2006, sequential tree-reweighted message passing: chains of triangles, each
solved exactly, share the costs so that the sum of their minima rises.
"""

from __future__ import annotations

import numpy as np

from workbench.kernels.tree_messages import swept
from workbench.texturing.labelling import LabellingProblem


def lower_bound(problem: LabellingProblem, sweeps: int = 10) -> float:
    """No labelling of the problem costs less; exact where the triangles make a chain.

    Parameters
    ----------
    sweeps : there and back; each takes time by edges times candidates squared. With none it is
        the sum of the least data costs.
    """
    count = np.diff(problem.starts)
    some = np.flatnonzero(count)
    if not len(some):
        return 0.0
    best = float(np.minimum.reduceat(problem.costs, problem.starts[some]).sum())
    # An edge to a triangle without candidates costs nothing, whatever it is told.
    told = (count[problem.edges] > 0).all(axis=1)
    edges = problem.edges[told]
    sides = edges.ravel()
    triangle_starts = np.zeros(problem.triangles + 1, np.int64)
    np.cumsum(np.bincount(sides, minlength=problem.triangles), out=triangle_starts[1:])
    message_starts = np.zeros(len(sides) + 1, np.int64)
    np.cumsum(count[sides], out=message_starts[1:])
    messages = np.zeros(message_starts[-1])
    forward = np.arange(problem.triangles)
    edge_starts = problem.edge_starts[:-1][told]
    weights = problem.edge_weights[told]
    for _ in range(sweeps):
        for order in (forward, forward[::-1].copy()):
            bound = swept(
                order, order, problem.starts, problem.labels, problem.costs, edges,
                triangle_starts, np.argsort(sides, kind="stable"), edge_starts,
                problem.edge_labels, problem.edge_colors, weights, message_starts, messages,
            )  # fmt: skip
            best = max(best, bound)
    return best
