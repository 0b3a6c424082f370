"""Triangles of an isosurface by marching tetrahedra on a body-centred cubic lattice.

Nodes are integer triples of one parity (all even or all odd); the position of a node is
its triple times half the lattice spacing. Each tetrahedron holds one long edge between odd
nodes and one between even nodes. The lattice has nearly regular tetrahedra and no ambiguous
case, so the surface of a bounded solid is closed and edge-manifold whatever the values are
(Chan and Purisima 1998, "A new tetrahedral tesselation scheme for isosurface generation").
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Even permutations (a, b, c, d) of a tetrahedron for each mask of inside corners; the
# orientation of a, b, c, d is that of the tetrahedron, so triangles face outward.
_PERMUTATIONS = np.array(
    [
        [0, 1, 2, 3],
        [0, 1, 2, 3],
        [1, 0, 3, 2],
        [0, 1, 2, 3],
        [2, 0, 1, 3],
        [0, 2, 3, 1],
        [1, 2, 0, 3],
        [3, 0, 2, 1],
        [3, 0, 2, 1],
        [0, 3, 1, 2],
        [1, 3, 2, 0],
        [2, 0, 1, 3],
        [2, 3, 0, 1],
        [1, 0, 3, 2],
        [0, 1, 2, 3],
        [0, 1, 2, 3],
    ],
    dtype=np.int64,
)
_LEAST_FRACTION = 0.001
_INSIDE = np.array([0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4], dtype=np.int64)
_RING = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.int64)

EDGE_DIRECTIONS = np.array(
    [[2, 0, 0], [0, 2, 0], [0, 0, 2], [1, -1, -1], [1, 1, -1], [1, -1, 1], [1, 1, 1]],
    dtype=np.int64,
)


@njit(cache=True, nogil=True)
def _edge_key(p: NDArray[np.int64], q: NDArray[np.int64], stride: int) -> tuple[int, bool]:
    """The integer name of an edge and whether ``q`` is its lower node."""
    di, dj, dk = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    swapped = di < 0 or (di == 0 and (dj < 0 or (dj == 0 and dk < 0)))
    low = q if swapped else p
    if swapped:
        di, dj, dk = -di, -dj, -dk
    if di == 2:
        direction = 0
    elif di == 0:
        direction = 1 if dj == 2 else 2
    else:
        direction = 3 + (1 if dj > 0 else 0) + (2 if dk > 0 else 0)
    return ((low[0] * stride + low[1]) * stride + low[2]) * 7 + direction, swapped


@njit(cache=True, nogil=True)
def _emit(
    nodes: NDArray[np.int64],
    values: NDArray[np.float64],
    ends: tuple[int, int, int, int, int, int],
    stride: int,
    keys: NDArray[np.int64],
    fractions: NDArray[np.float64],
    count: int,
) -> int:
    """Write one triangle whose corners lie on three edges of a tetrahedron."""
    for corner in range(3):
        p, q = ends[2 * corner], ends[2 * corner + 1]
        key, swapped = _edge_key(nodes[p], nodes[q], stride)
        if swapped:
            p, q = q, p
        keys[count, corner] = key
        fractions[count, corner] = values[p] / (values[p] - values[q])
    return count + 1


@njit(cache=True, nogil=True)
def block_triangles(
    even: NDArray[np.float64],
    odd: NDArray[np.float64],
    first: NDArray[np.int64],
    stride: int,
    keys: NDArray[np.int64],
    fractions: NDArray[np.float64],
    count: int,
) -> int:
    """Append the triangles of one cubic block and return the new count.

    Parameters
    ----------
    even : (n + 1,)*3 values at nodes ``first + 2 (i, j, k)``, negative inside.
    odd : (n + 1,)*3 values at nodes ``first + 2 (i, j, k) + 1``.
    first : (3,) even node of the block's corner, non-negative.
    stride : larger than any node coordinate.
    keys, fractions : (m, 3) output, names of the crossed edges and where the surface
        crosses each, as a fraction from the edge's lower node; m must leave room for
        24 n³ further rows.
    count : rows already used.
    """
    n = odd.shape[0] - 1
    nodes = np.empty((4, 3), np.int64)
    values = np.empty(4)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                for axis in range(3):
                    b, c = (axis + 1) % 3, (axis + 2) % 3
                    nodes[0, 0], nodes[0, 1], nodes[0, 2] = 2 * i + 1, 2 * j + 1, 2 * k + 1
                    nodes[1] = nodes[0]
                    nodes[1, axis] += 2
                    values[0] = odd[i, j, k]
                    values[1] = odd[
                        (nodes[1, 0] - 1) // 2, (nodes[1, 1] - 1) // 2, (nodes[1, 2] - 1) // 2
                    ]
                    for side in range(4):
                        for step in range(2):
                            ring = (side + step) % 4
                            row = 2 + step
                            nodes[row] = nodes[0]
                            nodes[row, axis] += 1
                            nodes[row, b] += _RING[ring, 0]
                            nodes[row, c] += _RING[ring, 1]
                            values[row] = even[
                                nodes[row, 0] // 2, nodes[row, 1] // 2, nodes[row, 2] // 2
                            ]
                        mask = 0
                        for row in range(4):
                            if values[row] < 0.0:
                                mask |= 1 << row
                        if mask == 0 or mask == 15:
                            continue
                        shifted = nodes + first
                        a, e, f, g = (
                            _PERMUTATIONS[mask, 0],
                            _PERMUTATIONS[mask, 1],
                            _PERMUTATIONS[mask, 2],
                            _PERMUTATIONS[mask, 3],
                        )
                        if _INSIDE[mask] == 1:
                            count = _emit(
                                shifted, values, (a, e, a, f, a, g), stride, keys, fractions, count
                            )
                        elif _INSIDE[mask] == 3:
                            count = _emit(
                                shifted, values, (a, e, a, g, a, f), stride, keys, fractions, count
                            )
                        else:
                            count = _emit(
                                shifted, values, (a, f, a, g, e, g), stride, keys, fractions, count
                            )
                            count = _emit(
                                shifted, values, (a, f, e, g, e, f), stride, keys, fractions, count
                            )
    return count


@njit(cache=True, nogil=True)
def mixed_signs(even: NDArray[np.float64], odd: NDArray[np.float64]) -> bool:
    """Whether the values of one face of a block lie on both sides of the surface."""
    inside = even[0, 0] < 0.0
    for i in range(even.shape[0]):
        for j in range(even.shape[1]):
            if (even[i, j] < 0.0) != inside or (odd[i, j] < 0.0) != inside:
                return True
    return False


def edge_points(
    keys: NDArray[np.int64], fractions: NDArray[np.float64], stride: int
) -> NDArray[np.float64]:
    """Positions (n, 3) float64 on named edges, in half lattice spacings.

    Parameters
    ----------
    keys : (n,) int64 names made by ``block_triangles``.
    fractions : (n,) float64 in [0, 1] from each edge's lower node.
    stride : as given to ``block_triangles``.
    """
    node, direction = np.divmod(keys, 7)
    rest, k = np.divmod(node, stride)
    i, j = np.divmod(rest, stride)
    low = np.stack([i, j, k], axis=1).astype(np.float64)
    return low + fractions[:, None] * EDGE_DIRECTIONS[direction]


def indexed_triangles(
    keys: NDArray[np.int64], fractions: NDArray[np.float64], stride: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int32]]:
    """The triangles of ``block_triangles`` over vertices that are there once.

    Returns
    -------
    names : (n,) of the edges that the vertices lie on, sorted.
    vertices : (n, 3) in half lattice spacings.
    triangles : (m, 3) int32.
    """
    names, first, corners = np.unique(keys, return_index=True, return_inverse=True)
    # A crossing at a node itself would give faces without area.
    along = np.clip(fractions.reshape(-1)[first], _LEAST_FRACTION, 1.0 - _LEAST_FRACTION)
    return names, edge_points(names, along, stride), corners.reshape(-1, 3).astype(np.int32)
