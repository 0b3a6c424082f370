"""Encodings of one set of voxels: the five of Jaspe 2018 (5.4.3, tables 5.2 to 5.4), one more.

=========  ==========================================================================
svo        one byte per node of the octree, parents first; smallest for few voxels,
           but it cannot be entered in the middle
svdag      equal subtrees once, plain nodes of 32-bit words
ussvdag    mirrored subtrees once, too; plain nodes, mirrors in the head's free bits
esvdag     equal subtrees once, compact nodes and 4³ bricks
ssvdag     mirrored subtrees once, too; compact nodes and 4³ bricks
osvdag     subtrees once that any of the cube's 48 turns and mirrors makes equal; compact
           nodes with near pointers, and bricks
=========  ==========================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.cube_turns import MIRRORS, TURNS
from workbench.kernels.dag_rows import NO_CHILD, TURN_BITS, TURN_MASK
from workbench.kernels.dag_words import (
    LONG_OFFSETS,
    bricks_of_rows,
    compact_sizes,
    put_compact,
    put_plain,
)
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_near_encoding import near_arrays
from workbench.voxels.voxel_dag import VoxelDag

Encoding = Literal["svo", "svdag", "ussvdag", "esvdag", "ssvdag", "osvdag"]
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)
PLAIN: tuple[Encoding, ...] = ("svdag", "ussvdag")
COMPACT: tuple[Encoding, ...] = ("esvdag", "ssvdag")
# Which of the cube's turns (`workbench.kernels.cube_turns`) make equal subtrees one.
TURNS_OF: dict[Encoding, int] = {
    "svo": 1,
    "svdag": 1,
    "ussvdag": MIRRORS,
    "esvdag": 1,
    "ssvdag": MIRRORS,
    "osvdag": TURNS,
}


@dataclass(frozen=True)
class EncodedGraph:
    """A graph as it is kept in files and traced.

    Attributes
    ----------
    encoding : which one.
    level : depth of the voxels; 2^level of them a side.
    voxels : how many are full.
    root_turn : the turn through which the root is seen.
    starts : (level + 1,) uint64, where in ``nodes`` each depth begins, and the end; all zero
        but the end for an octree.
    nodes : (n,) uint8, uint32 or uint16: the octree's masks, plain or compact nodes. What the
        words mean is told in `workbench.kernels.dag_words`.
    bricks : (m,) uint64, the 4³ voxels of the compact encodings' last depth: bit
        8 c + g is voxel g of child c, both numbered x + 2y + 4z.
    anchors : (k,) uint32, what near pointers of each 128 half-words are added to; empty but
        for osvdag, see `workbench.kernels.dag_near_words`.
    source : the file it was read from, which errors name; None where it was made.
    """

    encoding: Encoding
    level: int
    voxels: int
    root_turn: int
    starts: NDArray[np.uint64]
    nodes: NDArray[Any]
    bricks: NDArray[np.uint64]
    anchors: NDArray[np.uint32]
    source: Path | None = field(default=None, compare=False)

    @property
    def nbytes(self) -> int:
        """Bytes of nodes, bricks, anchors and the index of depths."""
        arrays = (self.nodes, self.bricks, self.anchors, self.starts)
        return sum(array.nbytes for array in arrays)


def encoded(dag: VoxelDag, encoding: Encoding) -> EncodedGraph:
    """The graph in one of the encodings.

    Parameters
    ----------
    dag
        Reduced as the encoding asks for: `TURNS_OF` it, 1 for equal subtrees alone.
    encoding
        Which one.

    Raises
    ------
    InputError
        The graph has more nodes than the encoding can point to.
    """
    if encoding == "svo":
        masks = DagWalk(dag).masks()
        starts = np.zeros(dag.level + 1, np.uint64)
        starts[-1] = len(masks)
        return _graph(dag, encoding, starts, masks, np.empty(0, np.uint64))
    if encoding in PLAIN:
        return _plain(dag, encoding)
    if encoding in COMPACT:
        return _compact(dag, encoding)
    starts, nodes, anchors, bricks = near_arrays(dag)
    return _graph(dag, encoding, starts, nodes, bricks, anchors)


def _graph(
    dag: VoxelDag,
    encoding: Encoding,
    starts: NDArray[np.uint64],
    nodes: NDArray[Any],
    bricks: NDArray[np.uint64],
    anchors: NDArray[np.uint32] | None = None,
) -> EncodedGraph:
    turn = 0 if dag.empty or encoding == "svo" else dag.root & TURN_MASK
    voxels = DagWalk(dag).voxel_count
    if anchors is None:
        anchors = np.empty(0, np.uint32)
    return EncodedGraph(encoding, dag.level, voxels, turn, starts, nodes, bricks, anchors)


def _plain(dag: VoxelDag, encoding: Encoding) -> EncodedGraph:
    leaves = dag.leaf_masks
    sizes = [len(rows) + int((rows != NO_CHILD).sum()) for rows in dag.rows]
    starts = np.cumsum([0, *sizes, len(leaves)], dtype=np.int64)
    if starts[-1] > 1 << 32:
        raise _too_large(int(starts[-1]), 1 << 32, "words")
    words = np.empty(starts[-1], np.uint32)
    words[starts[-2] :] = leaves
    child_at = np.zeros(256, np.int64)
    child_at[leaves] = starts[-2] + np.arange(len(leaves))
    for depth in range(dag.level - 2, -1, -1):
        node_at = np.empty(len(dag.rows[depth]), np.int64)
        put_plain(dag.rows[depth], child_at, int(starts[depth]), words, node_at)
        child_at = node_at
    return _graph(dag, encoding, starts.astype(np.uint64), words, np.empty(0, np.uint64))


def _compact(dag: VoxelDag, encoding: Encoding) -> EncodedGraph:
    order = _most_referred_first(dag, dag.level - 2)
    bricks = np.empty(len(order), np.uint64)
    bricks_of_rows(dag.rows[-1], order, bricks)
    child_at = np.empty(len(order), np.int64)
    child_at[order] = np.arange(len(order))
    levels: list[NDArray[np.uint16]] = []
    for depth in range(dag.level - 3, -1, -1):
        rows = dag.rows[depth]
        if len(child_at) and child_at.max() >= LONG_OFFSETS:
            raise _too_large(int(child_at.max()), LONG_OFFSETS, "half-words or bricks of one depth")
        sizes = np.empty(len(rows), np.int64)
        compact_sizes(rows, child_at, sizes)
        order = _most_referred_first(dag, depth)
        words = np.empty(int(sizes.sum()), np.uint16)
        put_compact(rows, order, child_at, words)
        child_at = np.empty(len(rows), np.int64)
        child_at[order] = np.cumsum(sizes[order]) - sizes[order]
        levels.insert(0, words)
    # Bricks and 2³ leaves have no half-words: their depths begin and end at the end.
    lengths = [len(words) for words in levels] + [0, 0]
    starts = np.cumsum([0, *lengths], dtype=np.uint64)
    nodes = np.concatenate(levels) if levels else np.empty(0, np.uint16)
    return _graph(dag, encoding, starts, nodes, bricks)


def _most_referred_first(dag: VoxelDag, depth: int) -> NDArray[np.int64]:
    """Nodes of a depth by falling number of words that name them, ties as they were."""
    count = len(dag.rows[depth])
    if depth == 0:
        return np.arange(count)
    words = dag.rows[depth - 1].ravel()
    named = np.bincount(words[words != NO_CHILD] >> np.uint32(TURN_BITS), minlength=count)
    return np.argsort(-named, kind="stable")


def _too_large(found: int, most: int, what: str) -> InputError:
    return InputError(
        "The graph is larger than its encoding can point to.",
        expected=f"at most {most:,} {what}",
        found=f"{found:,}",
        fix="Choose a lower resolution, or another encoding.",
    )
