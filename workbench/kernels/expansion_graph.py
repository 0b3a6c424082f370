"""The graph of one expansion move: keep the photograph, or take the new one.

Source: Kolmogorov and Zabih 2004, the table of a submodular pair of two states. The arrays are as
in `workbench.kernels.pair_costs`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.pair_costs import difference, row_of


@njit(cache=True, nogil=True)
def expansion_graph(
    alpha_rows: NDArray[np.int64],
    edge_of_row: NDArray[np.int32],
    edges: NDArray[np.int32],
    weights: NDArray[np.float64],
    colors: NDArray[np.uint16],
    current: NDArray[np.int64],
    node: NDArray[np.int32],
    gain: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Edges (n, 2) of nodes, their capacities (n,) from first to second, the worst excess.

    Parameters
    ----------
    alpha_rows : (r,) rows of the new photograph's colours, one for each edge it is seen at.
    edge_of_row : (d,) which edge a row belongs to.
    edges : (e, 2) triangles.
    weights : (e,).
    colors : (d, s, 3).
    current : (e, 2) rows of both triangles' present photographs, −1 for none.
    node : (m,) number of a triangle that may change; −1 for one that may not.
    gain : (nodes,) cost of taking minus cost of keeping; the pairs' part is added in place.

    The worst excess is how far rounding broke the triangle inequality, relative; 0 mostly.
    """
    pairs = np.empty((len(alpha_rows), 2), np.int32)
    capacities = np.empty(len(alpha_rows))
    count = 0
    worst = 0.0
    for i in range(len(alpha_rows)):
        row = alpha_rows[i]
        e = edge_of_row[row]
        p, q = node[edges[e, 0]], node[edges[e, 1]]
        if p < 0 and q < 0:
            continue
        here, there = current[e, 0], current[e, 1]
        if here < 0 or there < 0:
            continue
        w = weights[e]
        both = w * difference(colors, here, there)
        if q < 0:
            gain[p] += w * difference(colors, row, there) - both
        elif p < 0:
            gain[q] += w * difference(colors, row, here) - both
        else:
            first = w * difference(colors, row, there)
            # Mostly both have the same photograph: colours are what takes time to compare.
            second = first if here == there else w * difference(colors, here, row)
            gain[p] += first - both
            gain[q] -= first
            capacity = first + second - both
            if capacity < 0.0:
                worst = max(worst, -capacity / (first + second + both))
                capacity = 0.0
            if capacity > 0.0:
                pairs[count, 0], pairs[count, 1] = p, q
                capacities[count] = capacity
                count += 1
    return pairs[:count], capacities[:count], worst


@njit(cache=True, nogil=True)
def take(
    alpha_rows: NDArray[np.int64],
    edge_of_row: NDArray[np.int32],
    edges: NDArray[np.int32],
    taken: NDArray[np.bool_],
    current: NDArray[np.int64],
) -> None:
    """Note the new photograph's rows in ``current`` where triangles (m,) have ``taken`` it."""
    for i in range(len(alpha_rows)):
        e = edge_of_row[alpha_rows[i]]
        for k in range(2):
            if taken[edges[e, k]]:
                current[e, k] = alpha_rows[i]


@njit(cache=True, nogil=True)
def undominated(
    starts: NDArray[np.int64],
    labels: NDArray[np.int32],
    costs: NDArray[np.float64],
    triangle_starts: NDArray[np.int64],
    triangle_edges: NDArray[np.int32],
    edge_starts: NDArray[np.int64],
    edge_labels: NDArray[np.int32],
    colors: NDArray[np.uint16],
    weights: NDArray[np.float64],
    keep: NDArray[np.bool_],
) -> None:
    """Clear ``keep`` (c,) of candidates for which another is better whatever is chosen around.

    Taking ``a`` instead of ``b`` changes the cost of an edge by no more than that of the seam
    between the two, by the triangle inequality: where that, over all edges, is less than what
    ``a`` is cheaper by, no best labelling has ``b``.

    ``triangle_edges`` from ``triangle_starts[t]`` on are the edges of triangle t.
    """
    for t in range(len(starts) - 1):
        first, last = starts[t], starts[t + 1]
        if last - first < 2:
            continue
        best = first
        for c in range(first + 1, last):
            if costs[c] < costs[best]:
                best = c
        sides = triangle_starts[t + 1] - triangle_starts[t]
        at, row = np.empty(sides, np.int64), np.empty(sides, np.int64)
        for k in range(sides):
            e = triangle_edges[triangle_starts[t] + k]
            at[k], row[k] = row_of(edge_starts, edge_labels, e, labels[best]), edge_starts[e]
        for c in range(first, last):
            spare = costs[c] - costs[best]
            # Both lists rise: rows are found by going on.
            for k in range(sides):
                while edge_labels[row[k]] < labels[c]:
                    row[k] += 1
            for k in range(sides):
                if spare <= 0.0:
                    break
                e = triangle_edges[triangle_starts[t] + k]
                spare -= weights[e] * difference(colors, row[k], at[k])
            if c != best and spare > 1e-12 * costs[c]:
                keep[c] = False
