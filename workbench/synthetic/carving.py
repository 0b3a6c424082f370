"""A closed mesh from a table of blended primitives, carved block by block along the surface."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from workbench.errors import WorkbenchError
from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.kernels.bcc_isosurface import indexed_triangles
from workbench.kernels.carved_blocks import BLOCK_CELLS, carve_blocks, distances_by_cell

_CELL_M = 0.02
_WORKERS = 4
_NEIGHBOURS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


@dataclass(frozen=True)
class Solid:
    """A carved solid as the kernels of ``implicit_solids`` read it.

    Attributes
    ----------
    table : (n, 23) float64 primitives.
    group_blend : (7,) float64, metres.
    detail : (7, 3) float64 weights of roughness, pitting and chiselling by group.
    cracks : (c, 9) float64.
    seed : which weathering.
    low, high : (3,) float64 corners of a box that holds the whole solid, metres.
    interior : (3,) float64 a point well inside.
    """

    table: NDArray[np.float64]
    group_blend: NDArray[np.float64]
    detail: NDArray[np.float64]
    cracks: NDArray[np.float64]
    seed: int
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    interior: NDArray[np.float64]

    def smooth_distances(
        self, points: NDArray[np.float64], spacing_m: float
    ) -> NDArray[np.float64]:
        """Signed distances (n,) to the form before weathering and cuts, negative inside, metres.

        A point of the carved surface with distance −d lies in a groove of depth d.
        """
        cell = np.floor((points - self.low) / _CELL_M).astype(np.int64)
        order = np.lexsort(cell.T)
        changes = np.any(np.diff(cell[order], axis=0) != 0, axis=1)
        starts = np.concatenate([[0], np.flatnonzero(changes) + 1])
        values = np.empty(len(points))

        def measure(cells: NDArray[np.int64]) -> NDArray[np.float64]:
            first = starts[cells[0]]
            last = starts[cells[-1] + 1] if cells[-1] + 1 < len(starts) else len(points)
            part: NDArray[np.float64] = distances_by_cell(
                points[order[first:last]],
                np.append(starts[cells], last) - first,
                self.low + (cell[order[starts[cells]]] + 0.5) * _CELL_M,
                0.87 * _CELL_M,
                self.table,
                self.group_blend,
                self.detail,
                self.cracks,
                spacing_m,
                self.seed,
            )
            return part

        batches = np.array_split(np.arange(len(starts)), min(len(starts), _WORKERS))
        with ThreadPoolExecutor(_WORKERS) as pool:
            values[order] = np.concatenate(list(pool.map(measure, batches)))
        return values


def carved_mesh(solid: Solid, spacing_m: float) -> TriangleMesh:
    """The surface of a solid as one closed, edge-manifold mesh.

    Parameters
    ----------
    solid : what to carve.
    spacing_m : distance between lattice cells; triangle edges are about 0.6 of it long.

    Returns
    -------
    The outer surface in the solid's frame; crumbs that the weathering cut off are left out.

    Raises
    ------
    WorkbenchError
        The surface has a hole: a primitive's reach was set too short.

    Notes
    -----
    Only blocks of 4³ cells that the surface runs through are evaluated: starting from one,
    wave after wave visits the neighbours across every face that the surface crosses. Memory
    is bound by the surface, not by the volume, and the waves have a fixed order.
    """
    extent = np.ceil((solid.high - solid.low) / (BLOCK_CELLS * spacing_m)).astype(np.int64)
    stride = int(extent.max() * 2 * BLOCK_CELLS + 4)
    visited = np.zeros(extent, bool)
    wave = _first_block(solid, spacing_m)[None]
    keys, fractions = [], []
    with ThreadPoolExecutor(_WORKERS) as pool:
        while len(wave):
            visited[tuple(wave.T)] = True
            parts = pool.map(
                lambda blocks: carve_blocks(
                    blocks, solid.low, 0.5 * spacing_m, stride, solid.table, solid.group_blend,
                    solid.detail, solid.cracks, solid.seed,
                ),
                np.array_split(wave, min(len(wave), _WORKERS)),
            )  # fmt: skip
            crossed = []
            for part_keys, part_fractions, part_crossed in parts:
                keys.append(part_keys)
                fractions.append(part_fractions)
                crossed.append(part_crossed)
            block, face = np.nonzero(np.concatenate(crossed))
            found = wave[block] + _NEIGHBOURS[face]
            found = found[((found >= 0) & (found < extent)).all(axis=1)]
            wave = np.unique(found[~visited[tuple(found.T)]], axis=0)
    _, vertices, triangles = indexed_triangles(
        np.concatenate(keys), np.concatenate(fractions), stride
    )
    mesh = TriangleMesh(solid.low + vertices * (0.5 * spacing_m), triangles)
    mesh = _largest_component(mesh)
    census = edge_census(mesh.triangles)
    if not census.watertight:
        raise WorkbenchError(
            "The carved surface is not closed.",
            expected="two faces at every edge",
            found=str(census),
            fix="Report it with the simulation's options; another seed will do for now.",
        )
    return mesh


def _first_block(solid: Solid, spacing_m: float) -> NDArray[np.int64]:
    """The block (3,) where a walk along x from outside to the interior point enters."""
    steps = np.arange(solid.low[0], solid.interior[0], 0.2 * spacing_m)
    points = np.tile(solid.interior, (len(steps), 1))
    points[:, 0] = steps
    inside = solid.smooth_distances(points, spacing_m) < 0
    entry = points[int(inside.argmax())]
    block: NDArray[np.int64] = np.floor((entry - solid.low) / (BLOCK_CELLS * spacing_m)).astype(
        np.int64
    )
    return block


def _largest_component(mesh: TriangleMesh) -> TriangleMesh:
    """The connected part with most faces."""
    edges = mesh.triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_matrix(
        (np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(len(mesh.vertices),) * 2
    )
    _, label = connected_components(graph, directed=False)
    faces = np.bincount(label[mesh.triangles[:, 0]])
    return mesh.keep_triangles(label[mesh.triangles[:, 0]] == faces.argmax())
