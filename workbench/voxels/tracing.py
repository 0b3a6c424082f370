"""Rays through encoded graphs: where they meet the first voxel (Jaspe 2018, 5.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.dag_words import octree_words
from workbench.kernels.voxel_tracing import beam_starts, trace_rays
from workbench.voxels.dag_encoding import PLAIN, EncodedGraph
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.voxel_set import VoxelGrid


@dataclass(frozen=True)
class CellHits:
    """What rays met, one for each.

    Attributes
    ----------
    distance : (n,) float64 along the unit direction, in the mesh's unit; infinite for nothing.
    cells : (n, 3) int32 lowest voxel of the cell met; undefined for nothing.
    sizes : (n,) int32 its side in voxels, above 1 where detail was left out; 0 for nothing.
    """

    distance: NDArray[np.float64]
    cells: NDArray[np.int32]
    sizes: NDArray[np.int32]

    @property
    def found(self) -> NDArray[np.bool_]:
        """(n,) whether anything was met."""
        return np.asarray(self.sizes > 0)


class VoxelTracer:
    """An encoded graph made ready for rays.

    Graphs are walked as they are, without decoding. An octree without
    pointers cannot be entered in the middle: it is given plain nodes first, none shared.

    Parameters
    ----------
    graph : the voxels.
    grid : where they are.

    Raises
    ------
    InputError : the words of the graph do not fit together.
    """

    def __init__(self, graph: EncodedGraph, grid: VoxelGrid) -> None:
        # A pointer out of bounds would be followed unseen: the graph is read through once.
        dag_of(graph)
        self.grid = grid
        self._empty = graph.voxels == 0
        nodes, compact = graph.nodes, graph.encoding not in ("svo", *PLAIN)
        if graph.encoding == "svo" and not self._empty:
            # One word for each node and one for each pointer, of which all nodes but one have one.
            words = np.empty(2 * len(nodes), np.uint32)
            nodes = words[: octree_words(nodes, graph.level, words)]
        self._arrays = (
            np.empty(0, np.uint32) if compact else nodes,
            nodes if compact else np.empty(0, np.uint16),
            graph.bricks,
            graph.anchors if graph.encoding == "osvdag" else None,
            compact,
            graph.starts.astype(np.int64),
            graph.root_turn,
        )

    @property
    def nbytes(self) -> int:
        """Bytes that are walked through."""
        return sum(array.nbytes for array in self._arrays[:4] if array is not None)

    def first_met(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        *,
        nearest: NDArray[np.float64] | float = 0.0,
        farthest: NDArray[np.float64] | float = np.inf,
        slope: float = 0.0,
    ) -> CellHits:
        """Where rays first enter a full cell.

        Parameters
        ----------
        origins : (n, 3) or (3,) in the mesh's frame.
        directions : (n, 3) unit.
        nearest, farthest : the stretch of each ray that counts, in the mesh's unit.
        slope : cells are not looked into whose side is no more than ``slope`` times their
            distance; the side of a pixel at distance 1 leaves out what is finer than pixels.
        """
        count = len(directions)
        distance, sizes = np.full(count, np.inf), np.zeros(count, np.int32)
        cells = np.zeros((count, 3), np.int32)
        if not self._empty:
            voxel = self.grid.voxel_size
            trace_rays(
                *self._arrays,
                self._in_grid(np.broadcast_to(origins, directions.shape)),
                np.ascontiguousarray(directions, np.float64),
                np.array(np.broadcast_to(nearest, count), np.float64) / voxel,
                np.array(np.broadcast_to(farthest, count), np.float64) / voxel,
                slope,
                distance,
                cells,
                sizes,
            )
            distance *= voxel
        return CellHits(distance, cells, sizes)

    def empty_before(
        self,
        origin: NDArray[np.float64],
        axes: NDArray[np.float64],
        half_angles: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Distances (n,) up to which cones are empty for certain, in the mesh's unit.

        Laine and Karras (2010) start the rays of a block of pixels where four rays at its
        corners ended; the corner of a voxel may show between the four. A cone around the
        block misses none.

        Parameters
        ----------
        origin : (3,) tip of the cones in the mesh's frame.
        axes : (n, 3) unit.
        half_angles : (n,) radians.
        """
        out = np.full(len(axes), np.inf)
        if not self._empty:
            tip = self._in_grid(np.asarray(origin, np.float64))
            axes = np.ascontiguousarray(axes, np.float64)
            half_angles = np.ascontiguousarray(half_angles, np.float64)
            beam_starts(*self._arrays, tip, axes, half_angles, out)
        return np.asarray(out * self.grid.voxel_size)

    def _in_grid(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.ascontiguousarray((points - self.grid.origin) / self.grid.voxel_size)
