"""From an encoding back to the graph, with every word checked on the way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.dag_near_words import BLOCK_BITS, near_rows
from workbench.kernels.dag_rows import NO_CHILD
from workbench.kernels.dag_words import compact_rows, plain_rows, rows_of_bricks
from workbench.voxels.dag_decoding import DagWalk, voxels_of_masks
from workbench.voxels.dag_encoding import COMPACT, PLAIN, EncodedGraph
from workbench.voxels.dag_reduction import reduced_dag
from workbench.voxels.voxel_dag import VoxelDag, checked_level


def dag_of(graph: EncodedGraph) -> VoxelDag:
    """The graph in memory that an encoding tells.

    The graph of an octree is the reduced one, for an octree shares nothing.

    Raises
    ------
    InputError
        The words do not make a graph, or not one of as many voxels as are told.
    """
    try:
        return _checked_dag(graph)
    except InputError as error:
        raise InputError(
            error.message,
            file=graph.source,
            expected=error.expected,
            found=error.found,
            fix=error.fix,
        ) from error


def _checked_dag(graph: EncodedGraph) -> VoxelDag:
    checked_level(graph.level)
    if graph.encoding == "svo":
        return reduced_dag(voxels_of_masks(graph.nodes, graph.level, graph.voxels), graph.level)
    dag = _from_plain(graph) if graph.encoding in PLAIN else _from_compact(graph)
    voxels = DagWalk(dag).voxel_count
    if voxels != graph.voxels:
        raise _broken(f"{voxels:,} voxels instead of {graph.voxels:,}")
    return dag


def _from_plain(graph: EncodedGraph) -> VoxelDag:
    starts = [int(start) for start in graph.starts]
    words = graph.nodes
    levels: list[NDArray[np.uint32]] = []
    masks = words[starts[-2] : starts[-1]]
    if (masks > 255).any():
        raise _broken("a leaf of more than eight voxels")
    place_of = np.full(len(words), NO_CHILD, np.uint32)
    place_of[starts[-2] : starts[-1]] = masks
    for depth in range(graph.level - 2, -1, -1):
        rows = np.empty((starts[depth + 1] - starts[depth], 8), np.uint32)
        own = np.full(len(words), NO_CHILD, np.uint32)
        count = plain_rows(words, starts[depth], starts[depth + 1], place_of, rows, own)
        if count < 0:
            raise _broken(f"a node of depth {depth} that points nowhere")
        levels.insert(0, rows[:count].copy())
        place_of = own
    return VoxelDag(graph.level, tuple(levels), _root(graph, len(levels[0])))


def _from_compact(graph: EncodedGraph) -> VoxelDag:
    rows = np.empty((len(graph.bricks), 8), np.uint32)
    rows_of_bricks(graph.bricks, rows)
    levels: list[NDArray[np.uint32]] = [rows]
    place_of = np.arange(len(graph.bricks), dtype=np.uint32)
    for depth in range(graph.level - 3, -1, -1):
        words = graph.nodes[int(graph.starts[depth]) : int(graph.starts[depth + 1])]
        rows = np.empty((len(words), 8), np.uint32)
        own = np.full(len(words), NO_CHILD, np.uint32)
        if graph.encoding in COMPACT:
            count = compact_rows(words, place_of, rows, own)
        else:
            anchors = graph.anchors[int(graph.starts[depth]) >> BLOCK_BITS :]
            count = near_rows(words, anchors, place_of, rows, own)
        if count < 0:
            raise _broken(f"a node of depth {depth} that points nowhere")
        levels.insert(0, rows[:count].copy())
        place_of = own
    return VoxelDag(graph.level, tuple(levels), _root(graph, len(levels[0])))


def _root(graph: EncodedGraph, roots: int) -> int:
    if roots > 1:
        raise _broken(f"{roots} roots")
    return graph.root_turn if roots else int(NO_CHILD)


def _broken(found: str) -> InputError:
    return InputError("The sparse voxel graph is broken.", found=found, fix="Write the file again.")
