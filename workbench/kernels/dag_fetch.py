"""One step down an encoded voxel graph: plain words or compact half-words and bricks."""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.dag_walk import POPCOUNT
from workbench.kernels.dag_words import SHORT_OFFSETS

_LOW_29 = (1 << 29) - 1
_BYTE_ONES, _GATHER = np.uint64(0x0101010101010101), np.uint64(0x0102040810204080)


def _of_four_codes() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """For a byte of four two-bit codes: which are not 0, as bits, and their half-words."""
    there, length = np.zeros(256, np.uint8), np.zeros(256, np.uint8)
    for byte in range(256):
        for c in range(4):
            code = byte >> (2 * c) & 3
            there[byte] |= (code > 0) << c
            length[byte] += min(code, 2)
    return there, length


_THERE, _LENGTH = _of_four_codes()


@njit(cache=True, nogil=True)
def _header_mask(header: int) -> int:
    mask: int = int64(_THERE[header & 255]) | int64(_THERE[header >> 8]) << 4
    return mask


@njit(cache=True, nogil=True)
def _brick_mask(brick: np.uint64) -> int:
    """Which of the eight bytes are not zero."""
    brick |= brick >> np.uint64(4)
    brick |= brick >> np.uint64(2)
    brick |= brick >> np.uint64(1)
    mask: int = int64(((brick & _BYTE_ONES) * _GATHER) >> np.uint64(56))
    return mask


@njit(cache=True, nogil=True)
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
    words : plain nodes; empty for a compact graph.
    halves, bricks : compact nodes and bricks; empty for a plain graph.
    compact : which of the two it is.
    level : depth of the voxels.
    """
    if not compact:
        head = int64(words[0])
        return 0, head, np.uint64(0), head & 255
    if level == 2:
        return 0, 0, bricks[0], _brick_mask(bricks[0])
    head = int64(halves[0])
    return 0, head, np.uint64(0), _header_mask(head)


@njit(cache=True, nogil=True)
def child_node(
    words: NDArray[np.uint32],
    halves: NDArray[np.uint16],
    bricks: NDArray[np.uint64],
    compact: bool,
    starts: NDArray[np.int64],
    below: int,
    node: int,
    head: int,
    brick: np.uint64,
    slot: int,
) -> tuple[int, int, np.uint64, int, int]:
    """Like `root_node` for a child that is there, and the mirror it is seen through.

    Parameters
    ----------
    words, halves, bricks, compact : the graph.
    starts : (level + 1,) first half-word of each depth.
    below : depth of the child.
    node, head, brick : of its parent.
    slot : number of the child as the parent stores it, mirrors undone.
    """
    if not compact:
        before = int64(POPCOUNT[head & ((1 << slot) - 1) & 255])
        node, mirror = int64(words[node + 1 + before]), head >> (8 + 3 * slot) & 7
        head = int64(words[node])
        return node, head, brick, head & 255, mirror
    level = len(starts) - 1
    if below == level - 1:
        return node, head, brick, int64((brick >> np.uint64(8 * slot)) & np.uint64(255)), 0
    ahead = head & ((1 << (2 * slot)) - 1)
    at = node + 1 + int64(_LENGTH[ahead & 255]) + int64(_LENGTH[ahead >> 8])
    code = head >> (2 * slot) & 3
    first = int64(halves[at])
    if code == 1:
        mirror, offset = first >> 13, first & (SHORT_OFFSETS - 1)
    else:
        long = first << 16 | int64(halves[at + 1])
        mirror, offset = long >> 29, long & _LOW_29 | (code & 1) << 29
    if below == level - 2:
        brick = bricks[offset]
        return 0, 0, brick, _brick_mask(brick), mirror
    node = starts[below] + offset
    head = int64(halves[node])
    return node, head, brick, _header_mask(head), mirror
