"""Nodes of voxel graphs as words and half-words (Jaspe 2018, 5.4.3), and back.

A plain node is one 32-bit word, the children's mask in its low byte and three mirror bits per
child above, and a 32-bit word per child: where in the array that child is. A compact node is a
16-bit header with two bits per child, child 0 lowest, and one or two half-words per child:

====  =========================================================================
code  child
====  =========================================================================
0     none
1     one half-word: 3 mirror bits, 13 bits of offset
2, 3  two half-words, high one first: 3 mirror bits, the low 29 bits of the
      offset; its 30th bit is the code's low bit
====  =========================================================================

A compact offset counts from the beginning of the next depth, in half-words, or in bricks of
64 bits where that depth is the bricks'.
"""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.cube_turns import turned_mask
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS, TURN_MASK

SHORT_OFFSETS, LONG_OFFSETS = 1 << 13, 1 << 30
_LOW_29, _LOW_16 = (1 << 29) - 1, (1 << 16) - 1


@njit(cache=True, nogil=True)
def bricks_of_rows(
    rows: NDArray[np.uint32], order: NDArray[np.int64], out: NDArray[np.uint64]
) -> None:
    """Fill ``out`` (n,) with the 4³ voxels of the bricks, bit 8 child + grandchild, in order."""
    for k in range(len(order)):
        bits = np.uint64(0)
        for c in range(8):
            word = rows[order[k], c]
            if word != NO_CHILD:
                mask = turned_mask(int64(word >> TURN_BITS), int64(word & TURN_MASK))
                bits |= np.uint64(mask) << np.uint64(8 * c)
        out[k] = bits


@njit(cache=True, nogil=True)
def rows_of_bricks(bricks: NDArray[np.uint64], out: NDArray[np.uint32]) -> None:
    """Fill the rows (n, 8) of bricks (n,), children not mirrored."""
    for i in range(len(bricks)):
        for c in range(8):
            mask = int64((bricks[i] >> np.uint64(8 * c)) & np.uint64(255))
            out[i, c] = np.uint32(mask << TURN_BITS) if mask else NO_CHILD


@njit(cache=True, nogil=True)
def put_plain(
    rows: NDArray[np.uint32],
    child_at: NDArray[np.int64],
    at: int,
    words: NDArray[np.uint32],
    node_at: NDArray[np.int64],
) -> int:
    """Write nodes (n, 8) into ``words`` from ``at`` on and fill where each one is.

    Parameters
    ----------
    rows : words of the children.
    child_at : (m,) where in ``words`` the children will be.
    at : first word to write.
    words : of the whole graph.
    node_at : (n,) filled.

    Returns
    -------
    The word after the last.
    """
    for i in range(len(rows)):
        node_at[i] = at
        head, mask = at, 0
        at += 1
        for c in range(8):
            word = rows[i, c]
            if word != NO_CHILD:
                mask |= 1 << c
                mask |= int64(word & TURN_MASK) << (8 + 3 * c)
                words[at] = child_at[word >> TURN_BITS]
                at += 1
        words[head] = mask
    return at


@njit(cache=True, nogil=True)
def plain_rows(
    words: NDArray[np.uint32],
    first: int,
    end: int,
    place_of: NDArray[np.uint32],
    out: NDArray[np.uint32],
    own: NDArray[np.uint32],
) -> int:
    """Rows of the plain nodes in ``words[first:end]``; −1 where they are not whole.

    Parameters
    ----------
    place_of : for each word of the array, which child begins there; `NO_CHILD` for none.
    out : (n, 8) filled with the rows.
    own : like ``place_of``, filled at the nodes' own heads.
    """
    at, count = first, 0
    while at < end:
        if count == len(out):
            return -1
        own[at] = count
        head = words[at]
        at += 1
        for c in range(8):
            out[count, c] = NO_CHILD
            if head >> c & 1:
                if at >= end or words[at] >= len(place_of):
                    return -1
                place = place_of[words[at]]
                if place == NO_CHILD:
                    return -1
                out[count, c] = np.uint32(place << TURN_BITS) | np.uint32(head >> (8 + 3 * c) & 7)
                at += 1
        count += 1
    return count


@njit(cache=True, nogil=True)
def compact_sizes(
    rows: NDArray[np.uint32], child_at: NDArray[np.int64], out: NDArray[np.int64]
) -> None:
    """Fill the half-words (n,) of nodes (n, 8) whose children are at the offsets (m,)."""
    for i in range(len(rows)):
        out[i] = 1
        for c in range(8):
            word = rows[i, c]
            if word != NO_CHILD:
                out[i] += 1 if child_at[word >> TURN_BITS] < SHORT_OFFSETS else 2


@njit(cache=True, nogil=True)
def put_compact(
    rows: NDArray[np.uint32],
    order: NDArray[np.int64],
    child_at: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> None:
    """Write nodes (n, 8) one after another in ``order`` (n,)."""
    at = 0
    for k in range(len(order)):
        head, header = at, 0
        at += 1
        for c in range(8):
            word = rows[order[k], c]
            if word == NO_CHILD:
                continue
            offset, tag = child_at[word >> TURN_BITS], int64(word & TURN_MASK)
            if offset < SHORT_OFFSETS:
                header |= 1 << (2 * c)
                out[at] = tag << 13 | offset
                at += 1
            else:
                header |= (2 | offset >> 29) << (2 * c)
                long = tag << 29 | offset & _LOW_29
                out[at] = long >> 16
                out[at + 1] = long & _LOW_16
                at += 2
        out[head] = header


@njit(cache=True, nogil=True)
def compact_rows(
    words: NDArray[np.uint16],
    place_of: NDArray[np.uint32],
    out: NDArray[np.uint32],
    own: NDArray[np.uint32],
) -> int:
    """Rows of the compact nodes of one depth; −1 where they are not whole.

    Parameters
    ----------
    words : (k,) half-words of this depth.
    place_of : for each offset into the next depth, which child begins there; `NO_CHILD`
        for none.
    out : filled with the rows; one for each half-word is enough.
    own : (k,) filled like ``place_of`` for this depth.
    """
    at, count = 0, 0
    while at < len(words):
        own[at] = count
        header = int64(words[at])
        at += 1
        for c in range(8):
            code = header >> (2 * c) & 3
            out[count, c] = NO_CHILD
            if code == 0:
                continue
            if at + (code > 1) >= len(words):
                return -1
            if code == 1:
                tag, offset = int64(words[at]) >> 13, int64(words[at]) & (SHORT_OFFSETS - 1)
                at += 1
            else:
                long = int64(words[at]) << 16 | int64(words[at + 1])
                tag, offset = long >> 29, long & _LOW_29 | (code & 1) << 29
                at += 2
            if offset >= len(place_of) or place_of[offset] == NO_CHILD:
                return -1
            out[count, c] = np.uint32(place_of[offset] << TURN_BITS | tag)
        count += 1
    return count


@njit(cache=True, nogil=True)
def octree_words(masks: NDArray[np.uint8], level: int, out: NDArray[np.uint32]) -> int:
    """Plain nodes, none shared, of an octree's masks, parents first; the word after the last."""
    at_of, child = np.zeros(level, np.int64), np.zeros(level, np.int64)
    told = np.zeros(level, np.int64)
    mask = np.zeros(level, np.int64)
    taken, used, depth = 0, 0, 0
    while depth >= 0:
        c = child[depth]
        if c == 0:
            mask[depth] = masks[taken]
            taken += 1
            at_of[depth] = used
            out[used] = mask[depth]
            used += 1
            told[depth] = used
            if depth < level - 1:
                for k in range(8):
                    used += mask[depth] >> k & 1
        if c == 8 or depth == level - 1:
            depth -= 1
            continue
        child[depth] += 1
        if mask[depth] >> c & 1:
            out[told[depth]] = used
            told[depth] += 1
            depth += 1
            child[depth] = 0
    return used
