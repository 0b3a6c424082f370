"""What it costs that two triangles side by side are textured with different photographs.

Colours along edges are (d, s, 3) uint16, 65535 for 1; rows ``edge_starts[e]`` to
``edge_starts[e + 1]`` belong to edge e, one for each photograph of ``edge_labels``, rising.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_FULL = 65535.0


@njit(cache=True, nogil=True)
def row_of(
    edge_starts: NDArray[np.int64], edge_labels: NDArray[np.int32], edge: int, label: int
) -> int:
    """Row of a photograph's colours along an edge; −1 where it has none there."""
    for row in range(edge_starts[edge], edge_starts[edge + 1]):
        if edge_labels[row] == label:
            return row
    return -1


@njit(cache=True, nogil=True)
def difference(colors: NDArray[np.uint16], one: int, other: int) -> float:
    """Mean over samples of the length of the colours' difference, in [0, √3]."""
    if one == other:
        return 0.0
    total = 0.0
    samples = colors.shape[1]
    for s in range(samples):
        r = float(colors[one, s, 0]) - float(colors[other, s, 0])
        g = float(colors[one, s, 1]) - float(colors[other, s, 1])
        b = float(colors[one, s, 2]) - float(colors[other, s, 2])
        total += math.sqrt(r * r + g * g + b * b)
    return float(total / (samples * _FULL))


@njit(cache=True, nogil=True)
def rows_of_labels(
    labels: NDArray[np.int32],
    edges: NDArray[np.int32],
    edge_starts: NDArray[np.int64],
    edge_labels: NDArray[np.int32],
) -> NDArray[np.int64]:
    """(e, 2) rows of the colours of both triangles' photographs; −1 for no photograph."""
    rows = np.full((len(edges), 2), -1, np.int64)
    for e in range(len(edges)):
        for k in range(2):
            label = labels[edges[e, k]]
            if label >= 0:
                rows[e, k] = row_of(edge_starts, edge_labels, e, label)
    return rows


@njit(cache=True, nogil=True)
def seam_costs(
    rows: NDArray[np.int64], weights: NDArray[np.float64], colors: NDArray[np.uint16]
) -> NDArray[np.float64]:
    """(e,) weighted differences along edges of which both rows (e, 2) are there; else 0."""
    costs = np.zeros(len(rows))
    for e in range(len(rows)):
        if rows[e, 0] >= 0 and rows[e, 1] >= 0:
            costs[e] = weights[e] * difference(colors, rows[e, 0], rows[e, 1])
    return costs
