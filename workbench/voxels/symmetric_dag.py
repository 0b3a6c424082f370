"""Graphs in which subtrees that are mirror images are one, too (Jaspe 2018, 5.4.1)."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.dag_rows import MIRROR_BITS
from workbench.kernels.dag_symmetry import canonical_rows, mirrored_mask
from workbench.voxels.dag_reduction import DistinctRows
from workbench.voxels.voxel_dag import VoxelDag

_BITS = np.uint32(MIRROR_BITS)


@cache
def leaf_table() -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """What mirrors do to the 256 masks of 2³ voxels.

    Returns
    -------
    words : (256,) the largest of a mask's mirror images times eight, plus the least mirror
        that makes the mask of it. There are 46 such images, the empty one among them.
    invariants : (256,) bit T is set where mirror T maps the mask onto itself.
    """
    words, invariants = np.empty(256, np.uint32), np.zeros(256, np.uint8)
    for mask in range(256):
        images = [mirrored_mask(mask, t) for t in range(8)]
        words[mask] = max(images) << MIRROR_BITS | images.index(max(images))
        invariants[mask] = sum(1 << t for t in range(8) if images[t] == mask)
    return words, invariants


def symmetric_dag(dag: VoxelDag) -> VoxelDag:
    """The smallest graph of the same voxels whose nodes may be mirrored along the axes.

    Each depth, from the finest up, keeps one node of all that are images of one another under
    the eight reflections. The mirrors that map a node onto itself form a group and are kept
    as one bit each, not as three bits for the axes: a node may be its own image under two
    mirrors at once and under neither alone.

    Parameters
    ----------
    dag
        A graph of equal subtrees, or one that is mirrored already.
    """
    words, invariants = leaf_table()
    levels = []
    for rows in reversed(dag.rows):
        image = np.empty_like(rows)
        tags, own = np.empty(len(rows), np.uint8), np.empty(len(rows), np.uint8)
        canonical_rows(rows, words, invariants, image, tags, own)
        distinct = DistinctRows()
        places = distinct.places_of(image)
        kept = distinct.rows
        invariants = np.empty(len(kept), np.uint8)
        invariants[places] = own
        words = places << _BITS | tags
        levels.append(kept)
    root = dag.root
    if not dag.empty:
        root = int(words[root >> MIRROR_BITS]) ^ (root & 7)
    return VoxelDag(dag.level, tuple(reversed(levels)), root)
