"""An order of unknowns in which equations between neighbours fill up little when factorised.

Halves of the points come first, then the few of the second half that touch the first: nothing is
eliminated across such a separator before it. Orders by degree, which libraries offer, do without
places, but fill up many times as much on meshes as regular as a divided icosahedron.

Source: George, *Nested dissection of a regular finite element mesh* (1973), by coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

_LEAF = 64


def dissected(matrix: csr_array, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) the order for a matrix (n, n) of symmetric pattern between places (n, 3)."""
    starts, columns = np.asarray(matrix.indptr, np.int64), matrix.indices
    order = np.empty(len(points), np.int64)
    in_first = np.zeros(len(points), bool)
    waiting = [(np.arange(len(points)), 0)]
    while waiting:
        members, place = waiting.pop()
        if len(members) <= _LEAF:
            order[place : place + len(members)] = members
            continue
        along = points[members, np.ptp(points[members], axis=0).argmax()]
        half = len(members) // 2
        ranked = np.argpartition(along, half)
        first, second = members[ranked[:half]], members[ranked[half:]]
        in_first[first] = True
        count = starts[second + 1] - starts[second]
        row = np.repeat(np.arange(len(second)), count)
        entry = np.arange(len(row)) + np.repeat(starts[second] - np.cumsum(count) + count, count)
        touching = np.zeros(len(second), bool)
        touching[row[in_first[columns[entry]]]] = True
        in_first[first] = False
        separator = second[touching]
        order[place + len(members) - len(separator) : place + len(members)] = separator
        waiting += [(first, place), (second[~touching], place + half)]
    return order
