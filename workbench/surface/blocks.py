"""A surface solved in blocks: one block's solution, one block's part of the surface, the whole."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.errors import WorkbenchError
from workbench.geometry.mesh import TriangleMesh, edge_census, vertex_normals
from workbench.geometry.neighbours import nearest
from workbench.geometry.samples import Samples
from workbench.kernels.bcc_isosurface import indexed_triangles
from workbench.surface.block_field import BlendedField
from workbench.surface.block_plan import BlockPlan
from workbench.surface.closing import closed_at_box
from workbench.surface.lattice import BRICK_CELLS, surface_part
from workbench.surface.poisson import (
    CUBE_SCALE,
    MAX_DEPTH,
    MIN_DEPTH,
    PoissonSettings,
    cell_size_m,
    depth_for_spacing,
    reconstruct,
)
from workbench.surface.provenance import told_by_samples
from workbench.surface.refinement import moved_onto_samples

# Fewer samples say too little about a surface; the coarse solution knows as much.
_LEAST_SAMPLES = 100


@dataclass(frozen=True)
class CoarseSolution:
    """One solution of the whole from a part of the samples.

    Attributes
    ----------
    mesh : closed.
    cell_m : edge of its octree cells.
    box : where it was cut, corners (3,), (3,); None where it had closed itself.
    """

    mesh: TriangleMesh
    cell_m: float
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None


@dataclass(frozen=True)
class SurfacePart:
    """The surface within one block.

    Attributes
    ----------
    mesh : its triangles and vertices with all attributes.
    keys : (n,) int64 sorted names of the vertices, the same in all blocks.
    own : (n,) bool, whether the vertex is this block's to place.
    looked_at : numbers of the block's bricks that were visited, sorted.
    entered : numbers of bricks of other blocks that the surface runs through, sorted.
    """

    mesh: TriangleMesh
    keys: NDArray[np.int64]
    own: NDArray[np.bool_]
    looked_at: NDArray[np.int64]
    entered: NDArray[np.int64]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored: one array for each thing there is."""
        names = (f.name for f in fields(self) if f.name != "mesh")
        return self.mesh.arrays() | {name: getattr(self, name) for name in names}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SurfacePart:
        """The part that `arrays` told."""
        names = [f.name for f in fields(cls) if f.name != "mesh"]
        return cls(TriangleMesh.from_arrays(arrays), *(arrays[name] for name in names))


def coarse_solution(
    samples: Samples,
    spacing_m: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    settings: PoissonSettings,
) -> CoarseSolution:
    """The whole from samples that were thinned evenly.

    Parameters
    ----------
    samples : the thinned ones.
    spacing_m : between them.
    low, high : (3,) box of all samples.
    settings : as for the blocks; the depth follows from the spacing.
    """
    depth = min(MAX_DEPTH, depth_for_spacing(low, high, spacing_m))
    mesh = reconstruct(samples.points, samples.normals, replace(settings, depth=depth))
    cell = cell_size_m(low, high, depth)
    if edge_census(mesh.triangles).watertight:
        return CoarseSolution(mesh, cell, None)
    box = low - cell, high + cell
    return CoarseSolution(closed_at_box(mesh, *box), cell, box)


def solved_block(
    plan: BlockPlan, block: NDArray[np.int64], samples: Samples, settings: PoissonSettings
) -> TriangleMesh | None:
    """One block's solution where it is used, with ``apart_m``, the distance to the samples.

    Parameters
    ----------
    samples : those in ``plan.solved(block)``.
    settings : the depth follows from the plan's cell.

    Returns
    -------
    None where the samples are too few or no surface comes of them: the coarse solution
    stands alone there.
    """
    if len(samples) < _LEAST_SAMPLES:
        return None
    extent = float(np.ptp(samples.points, axis=0).max())
    depth = math.ceil(math.log2(CUBE_SCALE * extent / plan.cell_m))
    depth = min(MAX_DEPTH, max(MIN_DEPTH, depth))
    # The cube is stretched until its cells are as large as those of all other blocks.
    scale = max(CUBE_SCALE, plan.cell_m * 2.0**depth / extent)
    try:
        mesh = reconstruct(
            samples.points, samples.normals, replace(settings, depth=depth, cube_scale=scale)
        )
    except WorkbenchError:
        return None
    low, high = plan.used(block)
    room = plan.lattice.brick_m
    near = _all_between(mesh.vertices, low - room, high + room)
    mesh = mesh.keep_triangles(np.asarray(near[mesh.triangles].any(axis=1)))
    if not len(mesh.triangles):
        return None
    apart, _ = nearest(cKDTree(samples.points), mesh.vertices)
    return mesh.with_attributes(apart_m=apart)


def part_of_block(
    plan: BlockPlan,
    block: NDArray[np.int64],
    field: BlendedField,
    samples: Samples,
    seeds: NDArray[np.int64],
    refine_rounds: int,
    reach_factor: float,
) -> SurfacePart:
    """The surface within a block, on the samples, with provenance.

    Parameters
    ----------
    field : of the block and its neighbours.
    samples : those in ``plan.solved(block)``.
    seeds : (s,) numbers of bricks where the surface may be.
    refine_rounds, reach_factor : as for `moved_onto_samples` and `told_by_samples`.
    """
    lattice = plan.lattice
    first, last = plan.bricks(block)
    # What moves a vertex depends on the rings of triangles around it: one for each round, and
    # one for its normal afterwards. A ring is no wider than a cell.
    halo = math.ceil((refine_rounds + 1) / BRICK_CELLS)
    part = surface_part(field, lattice, seeds, first - halo, last + halo)
    keys, vertices, triangles = indexed_triangles(part.keys, part.fractions, lattice.stride)
    mesh = TriangleMesh(lattice.positions(vertices), triangles)
    if len(samples):
        mesh = moved_onto_samples(mesh, samples, refine_rounds)
    bricks = lattice.unnumbered(part.brick)
    inside = _all_between(bricks, first, last - 1)
    mesh = mesh.with_attributes(normal=vertex_normals(mesh), key=keys).keep_triangles(inside)
    keys = mesh.vertex_attributes["key"]
    home = lattice.bricks_of_edges(keys)
    # Half the memory for what is no truer in double precision.
    attributes = {"normal": mesh.vertex_attributes["normal"].astype(np.float32)}
    mesh = TriangleMesh(mesh.vertices, mesh.triangles, attributes)
    mesh = told_by_samples(mesh, samples, reach_factor)
    visited = lattice.unnumbered(part.visited)
    looked_at = part.visited[_all_between(visited, first, last - 1)]
    return SurfacePart(
        mesh,
        keys,
        _all_between(home, first, last - 1),
        looked_at,
        np.union1d(part.beyond, part.brick[~inside]),
    )


def bricks_missed(parts: Iterable[SurfacePart]) -> NDArray[np.int64]:
    """Numbers of bricks that the surface enters from elsewhere and that were not looked at."""
    entered, looked_at = [], []
    for part in parts:
        entered.append(part.entered)
        looked_at.append(part.looked_at)
    return np.setdiff1d(np.concatenate(entered), np.concatenate(looked_at))


def joined(parts: Iterable[SurfacePart]) -> TriangleMesh:
    """One mesh from the parts of all blocks; each vertex as its own block placed it.

    ``parts`` are gone through twice, one in memory at a time.
    """
    keys_of, own_of, triangle_count = [], [], 0
    for part in parts:
        keys_of.append(part.keys)
        own_of.append(part.own)
        triangle_count += len(part.mesh.triangles)
        attributes = part.mesh.vertex_attributes
    starts = np.cumsum([0, *(len(keys) for keys in keys_of)])
    chosen, place = _one_of_each(np.concatenate(keys_of), np.concatenate(own_of))
    del keys_of, own_of
    vertices = np.empty((int(chosen.sum()), 3))
    told = {
        name: np.empty((len(vertices), *values.shape[1:]), values.dtype)
        for name, values in attributes.items()
    }
    triangles = np.empty((triangle_count, 3), np.int32)
    done = 0
    for part, start, end in zip(parts, starts[:-1], starts[1:], strict=True):
        mine = chosen[start:end]
        at = place[start:end]
        vertices[at[mine]] = part.mesh.vertices[mine]
        for name, values in part.mesh.vertex_attributes.items():
            told[name][at[mine]] = values[mine]
        triangles[done : done + len(part.mesh.triangles)] = at[part.mesh.triangles]
        done += len(part.mesh.triangles)
    return TriangleMesh(vertices, triangles, told)


def _one_of_each(
    keys: NDArray[np.int64], own: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Which of equal keys (n,) is taken, its own block's first, and the place (n,) of each."""
    order = np.lexsort((~own, keys))
    first = np.diff(keys[order], prepend=-1) != 0
    chosen = np.zeros(len(keys), bool)
    chosen[order[first]] = True
    place = np.empty(len(keys), np.int32)
    place[order] = np.cumsum(first, dtype=np.int32) - 1
    return chosen, place


def _all_between(values: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.bool_]:
    """Rows (n,) of ``values`` (n, 3) that lie in the closed box."""
    return np.asarray(((values >= low) & (values <= high)).all(axis=1))
