"""Graphs in which subtrees that are images of one another are one (Jaspe 2018, 5.4.1).

The paper merges mirror images. The same reduction is done here for all 48 turns and mirrors
of the cube, too, which its discussion (5.7) leaves for later.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.cube_turns import COMPOSED, MIRRORS, TURNS, turned_mask
from workbench.kernels.dag_rows import TURN_BITS, TURN_MASK
from workbench.kernels.dag_symmetry import canonical_rows
from workbench.voxels.dag_reduction import DistinctRows
from workbench.voxels.voxel_dag import VoxelDag


@cache
def leaf_table(order: int = MIRRORS) -> tuple[NDArray[np.uint32], NDArray[np.uint64]]:
    """What turns do to the 256 masks of 2³ voxels.

    Parameters
    ----------
    order : 8 for mirrors alone, 48 for all turns of the cube.

    Returns
    -------
    words : (256,) the largest of a mask's images times 64, plus the least turn that makes the
        mask of it. There are 46 such images under mirrors, 22 under all turns, the empty one
        among them.
    invariants : (256,) bit g is set where turn g maps the mask onto itself.
    """
    words, invariants = np.empty(256, np.uint32), np.zeros(256, np.uint64)
    for mask in range(256):
        largest = max(turned_mask(mask, g) for g in range(order))
        back = next(g for g in range(order) if turned_mask(largest, g) == mask)
        words[mask] = largest << TURN_BITS | back
        invariants[mask] = sum(1 << g for g in range(order) if turned_mask(mask, g) == mask)
    return words, invariants


@cache
def _least_turns(group: int) -> tuple[int, ...]:
    """For each turn the least that does the same to what the turns in ``group``, bits, keep."""
    kept = [g for g in range(TURNS) if group >> g & 1]
    return tuple(int(COMPOSED[turn, kept].min()) for turn in range(TURNS))


def symmetric_dag(dag: VoxelDag, order: int = MIRRORS) -> VoxelDag:
    """The smallest graph of the same voxels whose nodes may be mirrored, or turned as well.

    Each depth, from the finest up, keeps one node of all that are images of one another. The
    turns that map a node onto itself form a group and are kept one by one, not as three bits
    for the axes: a node may be its own image under two mirrors at once and under neither alone.

    Parameters
    ----------
    dag
        A graph of equal subtrees, or one that is mirrored already.
    order
        8 to merge mirror images along the axes, 48 to merge what any turn makes equal.
    """
    words, invariants = leaf_table(order)
    levels = []
    for rows in reversed(dag.rows):
        kinds, groups = np.unique(invariants, return_inverse=True)
        least = np.array([_least_turns(int(kind)) for kind in kinds], np.int8).reshape(-1, TURNS)
        image = np.empty_like(rows)
        turns, own = np.empty(len(rows), np.uint8), np.empty(len(rows), np.uint64)
        canonical_rows(rows, words, least, groups, order, image, turns, own)
        distinct = DistinctRows()
        places = distinct.places_of(image)
        kept = distinct.rows
        invariants = np.empty(len(kept), np.uint64)
        invariants[places] = own
        words = places << np.uint32(TURN_BITS) | turns
        levels.append(kept)
    root = dag.root
    if not dag.empty:
        # The root may be turned, too: first as its representative, then as the graph was.
        word = int(words[root >> TURN_BITS])
        root = word & ~TURN_MASK | int(COMPOSED[root & TURN_MASK, word & TURN_MASK])
    return VoxelDag(dag.level, tuple(reversed(levels)), root)
