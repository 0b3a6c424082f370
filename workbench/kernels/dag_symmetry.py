"""Nodes that are mirror images of one another, told by one row for all of them."""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.dag_rows import NO_CHILD

_TAG, _UNTAG = np.uint32(7), np.uint32(0xFFFFFFF8)


@njit(cache=True, nogil=True)
def mirrored_mask(mask: int, mirror: int) -> int:
    """The 2³ voxels of ``mask`` mirrored along the axes of ``mirror``, both as bits."""
    out = 0
    for c in range(8):
        if mask >> c & 1:
            out |= 1 << (c ^ mirror)
    return out


@njit(cache=True, nogil=True)
def smallest_tag(tag: int, invariant: int) -> int:
    """The smallest mirror that does the same as ``tag`` to a node.

    Parameters
    ----------
    tag : three bits, one for each axis.
    invariant : bit T is set where mirror T maps the node onto itself; bit 0 always is.
    """
    least = tag
    for t in range(1, 8):
        if invariant >> t & 1 and tag ^ t < least:
            least = tag ^ t
    return least


@njit(cache=True, nogil=True)
def canonical_rows(
    rows: NDArray[np.uint32],
    words: NDArray[np.uint32],
    invariants: NDArray[np.uint8],
    out: NDArray[np.uint32],
    tags: NDArray[np.uint8],
    out_invariants: NDArray[np.uint8],
) -> None:
    """The smallest of the eight mirror images of every node, and the way back from it.

    Nodes are mirror images of one another exactly when their smallest rows are equal: the
    children's representatives are known to be different from each other under all mirrors,
    and of the mirrors that do the same to a child only the smallest is written.

    Parameters
    ----------
    rows : (n, 8) words of children before; their mirror bits count.
    words : (m,) word of each such child's representative: place times eight plus the mirror
        that makes the child of it.
    invariants : (k,) of the representatives, one bit per mirror that changes nothing.
    out : (n, 8) filled with the canonical rows.
    tags : (n,) filled with the mirror that makes the node of its canonical row.
    out_invariants : (n,) filled with the mirrors that map the node onto itself, bits.
    """
    row = np.empty(8, np.uint32)
    image = np.empty(8, np.uint32)
    for i in range(len(rows)):
        for c in range(8):
            row[c] = NO_CHILD
            if rows[i, c] != NO_CHILD:
                row[c] = words[rows[i, c] >> 3] ^ (rows[i, c] & _TAG)
        tags[i] = 0
        for t in range(8):
            order = 0
            for c in range(8):
                word = row[c ^ t]
                if word != NO_CHILD:
                    place = word >> 3
                    tag = smallest_tag(int64((word & _TAG) ^ t), int64(invariants[place]))
                    word = (word & _UNTAG) | np.uint32(tag)
                image[c] = word
                if order == 0 and t > 0 and word != out[i, c]:
                    order = -1 if word < out[i, c] else 1
                    if order > 0:
                        break
            if t == 0 or order < 0:
                out[i] = image
                tags[i] = t
                out_invariants[i] = 0
                first = t
            if order == 0:
                out_invariants[i] |= np.uint8(1 << (t ^ first))
            elif order < 0:
                out_invariants[i] |= np.uint8(1)
