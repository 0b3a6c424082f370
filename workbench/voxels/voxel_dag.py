"""Sparse voxel graphs in memory: levels of nodes whose children may be shared and turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS

# Morton codes of three axes in 64 bits; a graph ends in bricks of 4³ voxels.
FINEST_LEVEL, COARSEST_LEVEL = 21, 2


@dataclass(frozen=True)
class VoxelDag:
    """Which voxels of a cube of 2^level a side are full.

    A node at depth d stands for a cube of 2^(level − d) voxels a side. A *word* names a
    child: its place among the nodes one depth down times 64, plus the turn of the cube
    (`workbench.kernels.cube_turns`) that makes the child of that node: 0 … 7 mirror along the
    axes of their bits, x is bit 0. `NO_CHILD` is empty. Children are numbered x + 2y + 4z, as
    in Morton codes. Nodes of depth ``level − 2`` are 4³ bricks, and the place in *their*
    children's words is the child itself: a mask of 2³ voxels.

    Attributes
    ----------
    level : depth of the voxels.
    rows : for each depth 0 … level − 2 the (n, 8) uint32 words of its nodes' children.
    root : word of the root, which alone stands at depth 0; `NO_CHILD` for an empty cube.
    """

    level: int
    rows: tuple[NDArray[np.uint32], ...]
    root: int

    @property
    def empty(self) -> bool:
        return self.root == int(NO_CHILD)

    @property
    def leaf_masks(self) -> NDArray[np.uint8]:
        """The different 2³ masks in use, ascending."""
        words = self.rows[-1].ravel()
        return np.unique(words[words != NO_CHILD] >> np.uint32(TURN_BITS)).astype(np.uint8)

    @property
    def node_count(self) -> int:
        """Nodes of all depths, the 2³ leaves among them, as the papers count."""
        return sum(len(rows) for rows in self.rows) + len(self.leaf_masks)


def checked_level(level: int) -> int:
    """``level`` itself.

    Raises
    ------
    InputError : it is not in 2 … 21, the levels a graph can have.
    """
    if not COARSEST_LEVEL <= level <= FINEST_LEVEL:
        raise InputError(
            "A sparse voxel graph cannot have this resolution.",
            expected=f"{2**COARSEST_LEVEL} to {2**FINEST_LEVEL} voxels a side, a power of two",
            found=f"2^{level}",
            fix="Ask for another resolution.",
        )
    return level
