"""Messages between triangles that share an edge, and the bound they prove.

Source: Kolmogorov 2006, sequential tree-reweighted message passing; arrays are as in
`workbench.kernels.pair_costs`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.pair_costs import difference

# Single precision rounds by less than this; what is rounded down is no more than it was.
_DOWN = 1.0 - 2e-7


@njit(cache=True, nogil=True)
def seam_table(
    starts: NDArray[np.int64],
    labels: NDArray[np.int32],
    edges: NDArray[np.int32],
    edge_starts: NDArray[np.int64],
    edge_labels: NDArray[np.int32],
    colors: NDArray[np.uint16],
    weights: NDArray[np.float64],
    table_starts: NDArray[np.int64],
) -> NDArray[np.float32]:
    """What seams cost, never more, for every edge and pair of candidates of its triangles.

    Edge e's, the first triangle's candidates by the second's, begin at ``table_starts[e]``.
    """
    table = np.empty(table_starts[len(edges)], np.float32)
    most = 1
    for t in range(len(starts) - 1):
        most = max(most, starts[t + 1] - starts[t])
    ones, others = np.empty(most, np.int64), np.empty(most, np.int64)
    for e in range(len(edges)):
        p, q = edges[e, 0], edges[e, 1]
        rows, columns = starts[p + 1] - starts[p], starts[q + 1] - starts[q]
        _find_rows(edge_starts[e], edge_labels, labels, starts[p], rows, ones)
        _find_rows(edge_starts[e], edge_labels, labels, starts[q], columns, others)
        at = table_starts[e]
        for c in range(rows):
            for d in range(columns):
                cost = weights[e] * difference(colors, ones[c], others[d])
                table[at] = np.float32(cost * _DOWN)
                at += 1
    return table


@njit(cache=True, nogil=True)
def swept(
    order: NDArray[np.int64],
    rank: NDArray[np.int64],
    starts: NDArray[np.int64],
    costs: NDArray[np.float64],
    edges: NDArray[np.int32],
    triangle_starts: NDArray[np.int64],
    triangle_sides: NDArray[np.int64],
    table_starts: NDArray[np.int64],
    table: NDArray[np.float32],
    message_starts: NDArray[np.int64],
    messages: NDArray[np.float64],
) -> float:
    """Visit triangles in ``order``, each telling those that come later; the bound this proves.

    The bound holds for the sum of all costs whatever the messages were before; it is good after
    visits in the other direction.

    Parameters
    ----------
    order, rank : (m,) the triangles in turn, and the place of each in it.
    triangle_starts, triangle_sides : sides of triangle t: 2 · edge + k, where t is
        ``edges[edge, k]``.
    table_starts, table : of `seam_table`.
    message_starts, messages : what side 2 · edge + k is told from across the edge, one number for
        each candidate of its triangle; changed in place.
    """
    bound = 0.0
    most = 1
    for t in range(len(starts) - 1):
        most = max(most, starts[t + 1] - starts[t])
    belief = np.empty(most)
    for i in range(len(order)):
        t = order[i]
        first, count = starts[t], starts[t + 1] - starts[t]
        if count == 0:
            continue
        for c in range(count):
            belief[c] = costs[first + c]
        before, after = 0, 0
        for s in range(triangle_starts[t], triangle_starts[t + 1]):
            side = triangle_sides[s]
            for c in range(count):
                belief[c] += messages[message_starts[side] + c]
            other = edges[side >> 1, 1 - (side & 1)]
            if rank[other] > rank[t]:
                after += 1
            else:
                before += 1
        least = belief[:count].min()
        bound += least
        belief[:count] -= least
        share = 1.0 / max(before, after, 1)
        for s in range(triangle_starts[t], triangle_starts[t + 1]):
            side = triangle_sides[s]
            e = side >> 1
            other = edges[e, 1 - (side & 1)]
            if rank[other] < rank[t]:
                continue
            told, tell = message_starts[side], message_starts[side ^ 1]
            others = starts[other + 1] - starts[other]
            # Seams from candidate c to d stand ``c * along + d * across`` from the edge's first.
            along, across = (others, 1) if side & 1 == 0 else (1, count)
            lowest = np.inf
            for d in range(others):
                best = np.inf
                at = table_starts[e] + d * across
                for c in range(count):
                    value = share * belief[c] - messages[told + c] + table[at + c * along]
                    best = min(best, value)
                messages[tell + d] = best
                lowest = min(lowest, best)
            for d in range(others):
                messages[tell + d] -= lowest
            bound += lowest
    return bound


@njit(cache=True, nogil=True)
def _find_rows(
    edge_start: int,
    edge_labels: NDArray[np.int32],
    labels: NDArray[np.int32],
    first: int,
    count: int,
    rows: NDArray[np.int64],
) -> None:
    """Rows of colours along an edge of ``count`` candidates from ``first`` on; both lists rise."""
    row = edge_start
    for c in range(count):
        while edge_labels[row] < labels[first + c]:
            row += 1
        rows[c] = row
