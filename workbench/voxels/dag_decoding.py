"""The voxels of a graph, and how many there are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.cube_turns import COMPOSED, SLOT
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS, TURN_MASK
from workbench.kernels.dag_walk import (
    codes_of_masks,
    expanded_codes,
    expanded_masks,
    subtree_counts,
    voxel_ranges,
)
from workbench.voxels.voxel_dag import VoxelDag


class DagWalk:
    """A graph made ready for walks: flat, and with what stands below each node counted.

    Parameters
    ----------
    dag : the graph.

    Attributes
    ----------
    voxel_count : voxels of the whole cube.
    octree_node_count : nodes of the octree that the graph stands for, 2³ leaves included.
    """

    def __init__(self, dag: VoxelDag) -> None:
        self.dag = dag
        self._rows = np.concatenate(dag.rows)
        self._starts = np.cumsum([0, *(len(rows) for rows in dag.rows)], dtype=np.int64)
        self._voxels = np.empty(len(self._rows), np.uint64)
        nodes = np.empty(len(self._rows), np.uint64)
        subtree_counts(self._rows, self._starts, self._voxels, nodes)
        place = dag.root >> TURN_BITS
        self.voxel_count = 0 if dag.empty else int(self._voxels[place])
        self.octree_node_count = 0 if dag.empty else int(nodes[place])

    def codes(self) -> NDArray[np.uint64]:
        """(n,) Morton codes of all voxels, ascending."""
        return next(self.code_parts(0), np.empty(0, np.uint64))

    def code_parts(self, depth: int) -> Iterator[NDArray[np.uint64]]:
        """Morton codes of the voxels, ascending, of one node of ``depth`` after the other.

        Parameters
        ----------
        depth : 0 … level − 2; 0 gives one part.
        """
        codes, words = self._nodes_of(depth)
        for code, word in zip(codes, words, strict=True):
            place = self._starts[depth] + (word >> np.uint32(TURN_BITS))
            out = np.empty(int(self._voxels[place]), np.uint64)
            expanded_codes(self._rows, self._starts, depth, int(word), code, out)
            yield out

    def _nodes_of(self, depth: int) -> tuple[NDArray[np.uint64], NDArray[np.uint32]]:
        """Codes and words of the octree's nodes of a depth, ascending."""
        if self.dag.empty:
            return np.empty(0, np.uint64), np.empty(0, np.uint32)
        codes, words = np.zeros(1, np.uint64), np.array([self.dag.root], np.uint32)
        children = np.arange(8)
        for above in range(depth):
            turns = words & np.uint32(TURN_MASK)
            rows = self.dag.rows[above][words >> np.uint32(TURN_BITS)]
            seen = np.take_along_axis(rows, SLOT[turns].astype(np.int64), axis=1)
            there = seen != NO_CHILD
            own = COMPOSED[turns[:, None], np.where(there, seen & np.uint32(TURN_MASK), 0)]
            below = codes[:, None] << np.uint64(3) | children.astype(np.uint64)
            words = (seen & ~np.uint32(TURN_MASK) | own.astype(np.uint32))[there]
            codes = below[there]
        return codes, words

    def masks(self) -> NDArray[np.uint8]:
        """(n,) children's mask of every node of the octree, parents before children."""
        out = np.empty(self.octree_node_count, np.uint8)
        if not self.dag.empty:
            expanded_masks(self._rows, self._starts, self.dag.root, out)
        return out

    def ranges(
        self, codes: NDArray[np.uint64], depths: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Which voxels stand below cells of the octree, as numbers in the order of their codes.

        Parameters
        ----------
        codes : (n,) Morton codes of the cells.
        depths : (n,) their depths, 0 … level.

        Returns
        -------
        first, count : (n,) number of the first voxel and how many follow it, itself counted;
            −1 and 0 for empty cells.
        """
        first, count = np.full(len(codes), -1, np.int64), np.zeros(len(codes), np.int64)
        if not self.dag.empty:
            voxel_ranges(
                self._rows,
                self._starts,
                self._voxels,
                self.dag.root,
                np.asarray(codes, np.uint64),
                np.asarray(depths, np.int64),
                first,
                count,
            )
        return first, count


def voxels_of_masks(masks: NDArray[np.uint8], level: int, count: int) -> NDArray[np.uint64]:
    """Morton codes (count,) of an octree's masks (n,), parents before children.

    Raises
    ------
    InputError : the masks are not those of an octree of this level with so many voxels.
    """
    # The bits of all masks bound the voxels, whatever a broken file says.
    out = np.empty(int(np.unpackbits(masks).sum(dtype=np.int64)), np.uint64)
    found = codes_of_masks(masks, level, out)
    if found != count:
        raise InputError(
            "The octree is not whole.",
            expected=f"{count:,} voxels",
            found="nodes that do not fit together" if found < 0 else f"{found:,}",
            fix="Write the file again.",
        )
    return out[:found].copy()
