"""The smallest of the encodings: all turns of the cube and near pointers.

Two of the papers' open ends are taken up here (Jaspe 2018, 5.7): symmetries beyond mirrors,
and an order of nodes that helps where sharing is low. Frequent nodes come first, as in the
paper; all others in the order in which their parents name them, so that a pointer need only
tell how far they are from where their parents' siblings point. Of scans, a
fifth of the bytes of ssvdag is saved at 2048³ and more than a quarter at 8192³; rays take 1.35
to 1.45 times as long as through svdag, of which turns alone are less than a tenth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.dag_near_words import (
    BLOCK_BITS,
    FAR_OFFSETS,
    NEAR_OFFSETS,
    near_order,
    put_near,
)
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS
from workbench.kernels.dag_words import bricks_of_rows
from workbench.voxels.voxel_dag import VoxelDag

_BLOCK = 1 << BLOCK_BITS


def near_arrays(
    dag: VoxelDag,
) -> tuple[NDArray[np.uint64], NDArray[np.uint16], NDArray[np.uint32], NDArray[np.uint64]]:
    """Where depths begin, nodes, anchors and bricks of a graph, see `EncodedGraph`.

    Raises
    ------
    InputError : a depth is larger than pointers reach.
    """
    orders, tails = _orders(dag)
    bricks = np.empty(len(orders[-1]), np.uint64)
    bricks_of_rows(dag.rows[-1], orders[-1], bricks)
    child_at = _places(orders[-1])
    levels: list[NDArray[np.uint16]] = []
    anchors: list[NDArray[np.uint32]] = []
    for depth in range(dag.level - 3, -1, -1):
        rows, ranks = dag.rows[depth], _places(orders[depth + 1])
        if child_at.max(initial=0) >= FAR_OFFSETS:
            raise InputError(
                "The graph is larger than its encoding can point to.",
                expected=f"at most {FAR_OFFSETS:,} half-words or bricks of one depth",
                found=f"{child_at.max():,}",
                fix="Choose a lower resolution, or ssvdag.",
            )
        room = len(rows) + 2 * int((rows != NO_CHILD).sum())
        words = np.zeros((room // _BLOCK + 1) * _BLOCK, np.uint16)
        own_anchors = np.zeros(len(words) >> BLOCK_BITS, np.uint32)
        node_at = np.empty(len(rows), np.int64)
        used = put_near(
            rows,
            orders[depth],
            child_at,
            ranks,
            child_at[orders[depth + 1]],
            tails[depth + 1],
            depth == dag.level - 3,
            words,
            own_anchors,
            node_at,
        )
        blocks = used // _BLOCK + 1
        levels.insert(0, words[: blocks * _BLOCK])
        anchors.insert(0, own_anchors[:blocks])
        child_at = node_at
    starts = np.cumsum([0, *(len(words) for words in levels), 0, 0], dtype=np.uint64)
    if not levels:
        return starts, np.empty(0, np.uint16), np.empty(0, np.uint32), bricks
    return starts, np.concatenate(levels), np.concatenate(anchors), bricks


def _orders(dag: VoxelDag) -> tuple[list[NDArray[np.int64]], list[int]]:
    """The order of each depth's nodes, and how many of them are there for being named often."""
    orders = [np.arange(len(dag.rows[0]))]
    tails = [0]
    for depth in range(1, dag.level - 1):
        above, count = dag.rows[depth - 1], len(dag.rows[depth])
        words = above.ravel()
        named = np.bincount(words[words != NO_CHILD] >> np.uint32(TURN_BITS), minlength=count)
        frequent = np.argsort(-named, kind="stable")
        if depth == dag.level - 2:
            orders.append(frequent)
            tails.append(count)
            continue
        # As many as one half-word reaches, if all their own pointers are short.
        sizes = 1 + (dag.rows[depth] != NO_CHILD).sum(axis=1)
        ends = np.cumsum(sizes[frequent])
        tail = int(np.searchsorted(ends - sizes[frequent], NEAR_OFFSETS))
        tail = min(tail, int((named > 1).sum()))
        order, popular = np.empty(count, np.int64), np.zeros(count, bool)
        order[:tail] = frequent[:tail]
        popular[frequent[:tail]] = True
        near_order(above, orders[-1], popular, order, tail)
        orders.append(order)
        tails.append(tail)
    return orders, tails


def _places(order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each node stands in an order."""
    places = np.empty(len(order), np.int64)
    places[order] = np.arange(len(order))
    return places
