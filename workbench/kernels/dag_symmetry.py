"""Nodes that a turn or a mirror makes of one another, told by one row for all of them."""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.cube_turns import COMPOSED, INVERSE, SLOT
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS, TURN_MASK


@njit(cache=True, nogil=True)
def canonical_rows(
    rows: NDArray[np.uint32],
    words: NDArray[np.uint32],
    least_turns: NDArray[np.int8],
    groups: NDArray[np.int64],
    order: int,
    out: NDArray[np.uint32],
    turns: NDArray[np.uint8],
    invariants: NDArray[np.uint64],
) -> None:
    """The smallest of all images of every node, and the turn back from it.

    Nodes are images of one another exactly when their smallest rows are equal: the children's
    representatives are known to be no images of each other, and of the turns that do the same
    to a child only the least is written.

    Parameters
    ----------
    rows : (n, 8) words of children before; their turns count.
    words : (m,) word of each such child's representative and the turn that makes the child
        of it.
    least_turns : (k, 48) for each group of turns that map a node onto itself, the least turn
        that does to that node what a turn does.
    groups : which such group each representative has.
    order : 8 for mirrors alone, 48 for all turns.
    out : (n, 8) filled with the canonical rows.
    turns : (n,) filled with the turn that makes the node of its canonical row.
    invariants : (n,) filled with the turns that map the canonical node onto itself, bits.
    """
    place, turn = np.empty(8, np.int64), np.empty(8, np.int64)
    image = np.empty(8, np.uint32)
    for i in range(len(rows)):
        for c in range(8):
            place[c] = -1
            if rows[i, c] != NO_CHILD:
                word = words[rows[i, c] >> TURN_BITS]
                place[c] = word >> TURN_BITS
                turn[c] = COMPOSED[rows[i, c] & TURN_MASK, word & TURN_MASK]
        first = 0
        for g in range(order):
            sign = 0
            for c in range(8):
                k = SLOT[g, c]
                image[c] = NO_CHILD
                if place[k] >= 0:
                    least = least_turns[groups[place[k]], COMPOSED[g, turn[k]]]
                    image[c] = np.uint32(place[k] << TURN_BITS | int64(least))
                if sign == 0 and g > 0 and image[c] != out[i, c]:
                    sign = -1 if image[c] < out[i, c] else 1
                    if sign > 0:
                        break
            if g == 0 or sign < 0:
                out[i] = image
                first, sign = g, 0
                turns[i] = INVERSE[g]
                invariants[i] = 0
            if sign == 0:
                invariants[i] |= np.uint64(1) << np.uint64(COMPOSED[g, INVERSE[first]])
