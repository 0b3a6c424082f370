"""One step down an encoded voxel graph: plain words, or half-words and bricks.

A graph is near, as `workbench.kernels.dag_near_words` tells, when it has anchors. Where they
are None, kernels are compiled without what only turns and near pointers need: that would make
a third of a ray's time.
"""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.dag_near_words import BLOCK_BITS, NEAR_OFFSETS
from workbench.kernels.dag_walk import POPCOUNT
from workbench.kernels.dag_words import SHORT_OFFSETS

_LOW_29 = (1 << 29) - 1
_BYTE_ONES, _GATHER = np.uint64(0x0101010101010101), np.uint64(0x0102040810204080)


def _of_four_codes(values: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    """For a byte of four two-bit codes, child 0 lowest: the sum of what each is worth."""
    bytes_ = np.arange(256)
    return np.asarray(sum(np.take(values, bytes_ >> (2 * c) & 3) for c in range(4)), np.uint8)


# Half-words of children's pointers by their codes.
_LENGTH, _NEAR_LENGTH = _of_four_codes((0, 1, 2, 2)), _of_four_codes((0, 1, 1, 2))
# Which of four codes are not 0, as bits.
_THERE = np.array(
    [sum((byte >> (2 * c) & 3 > 0) << c for c in range(4)) for byte in range(256)], np.uint8
)


@njit(cache=True, nogil=True, inline="always")
def _header_mask(header: int) -> int:
    mask: int = int64(_THERE[header & 255]) | int64(_THERE[header >> 8]) << 4
    return mask


@njit(cache=True, nogil=True, inline="always")
def _brick_mask(brick: np.uint64) -> int:
    """Which of the eight bytes are not zero."""
    brick |= brick >> np.uint64(4)
    brick |= brick >> np.uint64(2)
    brick |= brick >> np.uint64(1)
    mask: int = int64(((brick & _BYTE_ONES) * _GATHER) >> np.uint64(56))
    return mask


@njit(cache=True, nogil=True, inline="always")
def root_node(
    words: NDArray[np.uint32],
    halves: NDArray[np.uint16],
    bricks: NDArray[np.uint64],
    compact: bool,
    level: int,
) -> tuple[int, int, np.uint64, int]:
    """Where the root is, its header, its brick, and the mask of its children.

    Parameters
    ----------
    words : plain nodes; empty for other graphs.
    halves, bricks : compact or near nodes, and bricks; empty for a plain graph.
    compact : whether nodes are half-words.
    level : depth of the voxels.
    """
    if not compact:
        head = int64(words[0])
        return 0, head, np.uint64(0), head & 255
    if level == 2:
        return 0, 0, bricks[0], _brick_mask(bricks[0])
    head = int64(halves[0])
    return 0, head, np.uint64(0), _header_mask(head)


@njit(cache=True, nogil=True, inline="always")
def _near_pointer(
    halves: NDArray[np.uint16], anchors: NDArray[np.uint32], node: int, at: int, code: int
) -> tuple[int, int]:
    """Offset and turn of a child whose pointer is at ``at``."""
    first = int64(halves[at])
    turn, offset = first >> 10, first & (NEAR_OFFSETS - 1)
    # Both are fetched always: what a pointer is cannot be foreseen, and a depth ends with a zero.
    far = offset << 16 | int64(halves[at + 1])
    anchor = int64(anchors[np.uint64(node) >> np.uint64(BLOCK_BITS)])
    offset += anchor if code == 2 else 0
    offset = far if code == 3 else offset
    return offset, turn


@njit(cache=True, nogil=True, inline="always")
def _compact_pointer(halves: NDArray[np.uint16], at: int, code: int) -> tuple[int, int]:
    """Offset and mirror of a child whose pointer is at ``at``."""
    first = int64(halves[at])
    if code == 1:
        return first & (SHORT_OFFSETS - 1), first >> 13
    long = first << 16 | int64(halves[at + 1])
    return long & _LOW_29 | (code & 1) << 29, long >> 29


@njit(cache=True, nogil=True, inline="always")
def child_node(
    words: NDArray[np.uint32],
    halves: NDArray[np.uint16],
    bricks: NDArray[np.uint64],
    anchors: NDArray[np.uint32] | None,
    compact: bool,
    starts: NDArray[np.int64],
    below: int,
    node: int,
    head: int,
    brick: np.uint64,
    slot: int,
) -> tuple[int, int, np.uint64, int, int]:
    """Like `root_node` for a child that is there, and the turn it is seen through.

    Parameters
    ----------
    words, halves, bricks, anchors, compact : the graph.
    starts : (level + 1,) first half-word of each depth.
    below : depth of the child.
    node, head, brick : of its parent.
    slot : number of the child as the parent stores it, turns undone.
    """
    if not compact:
        before = int64(POPCOUNT[head & ((1 << slot) - 1) & 255])
        node, turn = int64(words[node + 1 + before]), head >> (8 + 3 * slot) & 7
        head = int64(words[node])
        return node, head, brick, head & 255, turn
    level = len(starts) - 1
    if below == level - 1:
        return node, head, brick, int64((brick >> np.uint64(8 * slot)) & np.uint64(255)), 0
    ahead, code = head & ((1 << (2 * slot)) - 1), head >> (2 * slot) & 3
    if anchors is not None:
        at = node + 1 + int64(_NEAR_LENGTH[ahead & 255]) + int64(_NEAR_LENGTH[ahead >> 8])
        offset, turn = _near_pointer(halves, anchors, node, at, code)
    else:
        at = node + 1 + int64(_LENGTH[ahead & 255]) + int64(_LENGTH[ahead >> 8])
        offset, turn = _compact_pointer(halves, at, code)
    if below == level - 2:
        brick = bricks[offset]
        return 0, 0, brick, _brick_mask(brick), turn
    node = starts[below] + offset
    head = int64(halves[node])
    return node, head, brick, _header_mask(head), turn
