"""Walks through a voxel graph, depth first, which is the order of Morton codes.

Graphs come flat here: the rows of all depths after one another, and ``starts`` (level,) int64
that say where each depth begins, one more for the end. Depth ``level − 2`` holds the bricks.
"""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.cube_turns import COMPOSED, SLOT, turned_mask
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS, TURN_MASK

# How many of eight bits are set.
POPCOUNT = np.array([bin(mask).count("1") for mask in range(256)], np.uint8)


@njit(cache=True, nogil=True)
def subtree_counts(
    rows: NDArray[np.uint32],
    starts: NDArray[np.int64],
    voxels: NDArray[np.uint64],
    nodes: NDArray[np.uint64],
) -> None:
    """Fill how many voxels (n,) and octree nodes (n,), itself too, stand below each node."""
    depths = len(starts) - 1
    for depth in range(depths - 1, -1, -1):
        for i in range(starts[depth], starts[depth + 1]):
            full, count = np.uint64(0), np.uint64(1)
            for c in range(8):
                word = rows[i, c]
                if word == NO_CHILD:
                    continue
                if depth == depths - 1:
                    full += np.uint64(POPCOUNT[word >> TURN_BITS])
                    count += np.uint64(1)
                else:
                    below = starts[depth + 1] + int64(word >> TURN_BITS)
                    full += voxels[below]
                    count += nodes[below]
            voxels[i] = full
            nodes[i] = count


@njit(cache=True, nogil=True)
def expanded_codes(
    rows: NDArray[np.uint32],
    starts: NDArray[np.int64],
    top: int,
    root: int,
    root_code: np.uint64,
    out: NDArray[np.uint64],
) -> int:
    """Fill ``out`` with the Morton codes of the voxels below a node, ascending; how many.

    Parameters
    ----------
    rows, starts : the graph.
    top, root, root_code : depth of the node, its word, and its own code.
    out : (n,) with room for all.
    """
    bricks = len(starts) - 2
    node, turn = np.zeros(bricks + 1, np.int64), np.zeros(bricks + 1, np.int64)
    child, code = np.zeros(bricks + 1, np.int64), np.zeros(bricks + 1, np.uint64)
    node[top], turn[top], code[top] = starts[top] + (root >> TURN_BITS), root & TURN_MASK, root_code
    depth, count = top, 0
    while depth >= top:
        c = child[depth]
        if c == 8:
            depth -= 1
            continue
        child[depth] += 1
        word = rows[node[depth], SLOT[turn[depth], c]]
        if word == NO_CHILD:
            continue
        own = int64(COMPOSED[turn[depth], word & TURN_MASK])
        at = (code[depth] << np.uint64(3)) | np.uint64(c)
        if depth == bricks:
            mask = turned_mask(int64(word >> TURN_BITS), own)
            for j in range(8):
                if mask >> j & 1:
                    out[count] = (at << np.uint64(3)) | np.uint64(j)
                    count += 1
        else:
            depth += 1
            node[depth] = starts[depth] + int64(word >> TURN_BITS)
            turn[depth], child[depth], code[depth] = own, 0, at
    return count


@njit(cache=True, nogil=True)
def expanded_masks(
    rows: NDArray[np.uint32], starts: NDArray[np.int64], root: int, out: NDArray[np.uint8]
) -> int:
    """Fill ``out`` (n,) with the children's mask of every octree node, parents first."""
    bricks = len(starts) - 2
    node, turn = np.zeros(bricks + 1, np.int64), np.zeros(bricks + 1, np.int64)
    child = np.zeros(bricks + 1, np.int64)
    node[0], turn[0] = starts[0] + (root >> TURN_BITS), root & TURN_MASK
    depth, count = 0, 0
    while depth >= 0:
        c = child[depth]
        if c == 0:
            mask = 0
            for k in range(8):
                if rows[node[depth], SLOT[turn[depth], k]] != NO_CHILD:
                    mask |= 1 << k
            out[count] = mask
            count += 1
        if c == 8:
            depth -= 1
            continue
        child[depth] += 1
        word = rows[node[depth], SLOT[turn[depth], c]]
        if word == NO_CHILD:
            continue
        own = int64(COMPOSED[turn[depth], word & TURN_MASK])
        if depth == bricks:
            out[count] = turned_mask(int64(word >> TURN_BITS), own)
            count += 1
        else:
            depth += 1
            node[depth] = starts[depth] + int64(word >> TURN_BITS)
            turn[depth], child[depth] = own, 0
    return count


@njit(cache=True, nogil=True)
def codes_of_masks(masks: NDArray[np.uint8], level: int, out: NDArray[np.uint64]) -> int:
    """Fill ``out`` with the Morton codes of an octree of masks, parents first.

    Returns
    -------
    How many voxels there are, or −1 where the masks end too early, go on after the root's
    last descendant, or have a node without children.
    """
    if len(masks) == 0:
        return 0
    mask, child = np.zeros(level, np.int64), np.zeros(level, np.int64)
    code = np.zeros(level + 1, np.uint64)
    mask[0] = masks[0]
    at, depth, count = 1, 0, 0
    while depth >= 0:
        if mask[depth] == 0:
            return -1
        c = child[depth]
        if c == 8:
            depth -= 1
            continue
        child[depth] += 1
        if not mask[depth] >> c & 1:
            continue
        below = (code[depth] << np.uint64(3)) | np.uint64(c)
        if depth == level - 1:
            out[count] = below
            count += 1
        else:
            if at == len(masks):
                return -1
            depth += 1
            mask[depth], child[depth], code[depth] = masks[at], 0, below
            at += 1
    return count if at == len(masks) else -1


@njit(cache=True, nogil=True)
def voxel_ranges(
    rows: NDArray[np.uint32],
    starts: NDArray[np.int64],
    voxels: NDArray[np.uint64],
    root: int,
    codes: NDArray[np.uint64],
    depths: NDArray[np.int64],
    first: NDArray[np.int64],
    count: NDArray[np.int64],
) -> None:
    """Which voxels, in depth-first order, stand below cells of the octree (Dado 2016).

    Parameters
    ----------
    rows, starts, root : the graph.
    voxels : (n,) uint64 below each node.
    codes, depths : (m,) Morton code of each asked cell and its depth, 0 … level.
    first, count : (m,) filled with the number of the first voxel and how many there are;
        −1 and 0 for a cell that is empty.
    """
    level = len(starts)
    for i in range(len(codes)):
        node, turn, before = starts[0] + (root >> TURN_BITS), root & TURN_MASK, 0
        mask, found = 0, int64(voxels[node])
        for depth in range(depths[i]):
            c = int64(codes[i] >> np.uint64(3 * (depths[i] - 1 - depth))) & 7
            if depth == level - 1:
                before += int64(POPCOUNT[mask & ((1 << c) - 1)])
                found = mask >> c & 1
                break
            for k in range(c):
                word = rows[node, SLOT[turn, k]]
                if word != NO_CHILD:
                    if depth == level - 2:
                        before += int64(POPCOUNT[word >> TURN_BITS])
                    else:
                        before += int64(voxels[starts[depth + 1] + int64(word >> TURN_BITS)])
            word = rows[node, SLOT[turn, c]]
            if word == NO_CHILD:
                found = 0
                break
            turn = int64(COMPOSED[turn, word & TURN_MASK])
            if depth == level - 2:
                mask = turned_mask(int64(word >> TURN_BITS), turn)
                found = int64(POPCOUNT[mask])
            else:
                node = starts[depth + 1] + int64(word >> TURN_BITS)
                found = int64(voxels[node])
        first[i] = before if found > 0 else -1
        count[i] = found
