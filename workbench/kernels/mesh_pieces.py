"""Connected pieces of a mesh by union–find, in memory of one number per vertex."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], vertex: int) -> int:
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]
        vertex = parent[vertex]
    return vertex


@njit(cache=True, nogil=True)
def pieces_of(triangles: NDArray[np.int32], vertices: int) -> NDArray[np.int32]:
    """The smallest vertex (n,) of each vertex's piece.

    ``triangles`` (m, 3) join their corners; a vertex without a triangle is a piece by itself.
    """
    parent = np.arange(vertices).astype(np.int32)
    for t in range(len(triangles)):
        a = _root(parent, triangles[t, 0])
        for corner in range(1, 3):
            b = _root(parent, triangles[t, corner])
            # The smaller one stays root, so that the names do not depend on the order.
            low, high = min(a, b), max(a, b)
            parent[high] = low
            a = low
    for v in range(vertices):
        parent[v] = _root(parent, v)
    return parent
