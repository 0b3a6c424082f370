"""Compact nodes with turns and near pointers: smaller than the paper's, slower to trace.

Laid out as the compact nodes of `workbench.kernels.dag_words`, except for the children:

====  =========================================================================
code  child
====  =========================================================================
0     none
1     one half-word: 6 bits of turn, 10 bits of offset
2     one half-word: 6 bits of turn, 10 bits that an anchor is added to
3     two half-words, high one first: 6 bits of turn, 26 bits of offset
====  =========================================================================

Every 128 half-words of nodes have an anchor. Nodes that few others name stand in the order in
which those name them, so that most of them are near their parent's anchor: the first of them
that no earlier parent has named. The anchor of all bricks is 1024. Depths begin at multiples
of 128 half-words and are filled up with zeros, with one at least.
"""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS, TURN_MASK

NEAR_OFFSETS, FAR_OFFSETS = 1 << 10, 1 << 26
BLOCK_BITS = 7


@njit(cache=True, nogil=True)
def near_order(
    rows: NDArray[np.uint32],
    parents: NDArray[np.int64],
    popular: NDArray[np.bool_],
    order: NDArray[np.int64],
    count: int,
) -> int:
    """Append to ``order`` the children that are not popular, as their parents first name them.

    Parameters
    ----------
    rows : (n, 8) words of the parents' children.
    parents : (n,) order of the parents.
    popular : (m,) children that stand in ``order`` already; all become so.
    order : (m,) of the children; the first ``count`` are there.

    Returns
    -------
    The new count.
    """
    for k in range(len(parents)):
        for c in range(8):
            word = rows[parents[k], c]
            if word != NO_CHILD and not popular[word >> TURN_BITS]:
                popular[word >> TURN_BITS] = True
                order[count] = word >> TURN_BITS
                count += 1
    return count


@njit(cache=True, nogil=True)
def put_near(
    rows: NDArray[np.uint32],
    order: NDArray[np.int64],
    child_at: NDArray[np.int64],
    child_rank: NDArray[np.int64],
    child_by_rank: NDArray[np.int64],
    tail: int,
    bricks: bool,
    out: NDArray[np.uint16],
    anchors: NDArray[np.uint32],
    node_at: NDArray[np.int64],
) -> int:
    """Write nodes one after another and fill where they are.

    Parameters
    ----------
    rows : (n, 8) words of the children.
    order : (n,) in which to write.
    child_at : (m,) offset of each child in its depth.
    child_rank : (m,) which place in its depth's order each child has.
    child_by_rank : (m,) the offsets again, in that order.
    tail : rank of the first child in the order of first naming.
    bricks : whether children are bricks.
    out : filled with half-words, zero before.
    anchors : filled, one for every 128 half-words.
    node_at : (n,) filled with offsets.

    Returns
    -------
    Half-words used.
    """
    at, named, block = 0, tail, -1
    anchor = NEAR_OFFSETS
    for k in range(len(order)):
        if at >> BLOCK_BITS != block:
            block = at >> BLOCK_BITS
            if not bricks:
                anchor = child_by_rank[min(named, len(child_by_rank) - 1)]
            anchors[block] = anchor
        node_at[order[k]] = at
        head, header = at, 0
        at += 1
        for c in range(8):
            word = rows[order[k], c]
            if word == NO_CHILD:
                continue
            place, turn = int64(word >> TURN_BITS), int64(word & TURN_MASK)
            offset = child_at[place]
            named = max(named, child_rank[place] + 1)
            if offset < NEAR_OFFSETS:
                header |= 1 << (2 * c)
                out[at] = turn << 10 | offset
                at += 1
            elif 0 <= offset - anchor < NEAR_OFFSETS:
                header |= 2 << (2 * c)
                out[at] = turn << 10 | offset - anchor
                at += 1
            else:
                header |= 3 << (2 * c)
                out[at] = turn << 10 | offset >> 16
                out[at + 1] = offset & 0xFFFF
                at += 2
        out[head] = header
    return at


@njit(cache=True, nogil=True)
def near_rows(
    words: NDArray[np.uint16],
    anchors: NDArray[np.uint32],
    place_of: NDArray[np.uint32],
    out: NDArray[np.uint32],
    own: NDArray[np.uint32],
) -> int:
    """Rows of the nodes of one depth; −1 where they are not whole.

    Parameters
    ----------
    words : (k,) half-words of this depth.
    anchors : of its blocks.
    place_of : for each offset into the next depth, which child begins there; `NO_CHILD`
        for none.
    out : filled with the rows; one for each half-word is enough.
    own : (k,) filled like ``place_of`` for this depth.
    """
    at, count = 0, 0
    while at < len(words) and words[at] != 0:
        own[at] = count
        anchor = int64(anchors[at >> BLOCK_BITS])
        header = int64(words[at])
        at += 1
        for c in range(8):
            code = header >> (2 * c) & 3
            out[count, c] = NO_CHILD
            if code == 0:
                continue
            if at + (code > 2) >= len(words):
                return -1
            turn, offset = int64(words[at]) >> 10, int64(words[at]) & (NEAR_OFFSETS - 1)
            at += 1
            if code == 2:
                offset += anchor
            elif code == 3:
                offset = offset << 16 | int64(words[at])
                at += 1
            if offset >= len(place_of) or place_of[offset] == NO_CHILD or turn >= 48:
                return -1
            out[count, c] = np.uint32(place_of[offset] << TURN_BITS | turn)
        count += 1
    if at == len(words):
        return -1
    for rest in range(at, len(words)):
        if words[rest] != 0:
            return -1
    return count
