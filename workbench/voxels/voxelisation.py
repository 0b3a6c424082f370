"""The voxels a triangle mesh touches, with the exact area of surface in each.

The paper grows an octree and cuts every triangle on the way down (Chajdas, Reitinger and
Westermann 2014, "Scalable rendering for very large meshes", section 3). Here the grid is cut
into blocks of 64³ voxels; each gets the list of its triangles, and the triangles are cut
slab by slab, row by row and cell by cell inside it. A block has room for all its sums, so no
voxel is ever sorted or merged, blocks need nothing of one another, and their voxels come out
in Morton order: the same bytes whatever the number of workers, in memory that does not grow
with the resolution.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.kernels.morton import morton_cells
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.kernels.voxel_blocks import triangles_by_block, triangles_per_block
from workbench.kernels.voxel_sums import (
    AREA,
    GROUP,
    SEPARATING,
    add_triangles,
    averages,
    cells_in_order,
    face_averages,
    row_length,
)
from workbench.kernels.voxel_texture import COLUMNS, ROWS
from workbench.voxels.voxel_set import SidedVoxels, VoxelGrid, VoxelSet, joined_voxels

FINEST_LEVEL = 14
BLOCK_LEVEL = 6
# Numbers are held for 8**8 blocks at most, 128 MB.
_MOST_BLOCK_LEVELS = FINEST_LEVEL - BLOCK_LEVEL
_FACES = 63


@dataclass(frozen=True)
class VoxelisationOptions:
    """How a surface becomes voxels.

    Attributes
    ----------
    shell : give every face of a voxel that looks outward its opposite too, for models that
        one can enter.
    face_color_step : sRGB bytes between two faces of a voxel from which each keeps its own
        attributes.
    least_coherence : length of the mean of unit normals in a voxel below which each of its
        faces keeps its own attributes.
    workers : threads; the result does not depend on them.
    pairs_at_once : triangles in lists of blocks that are held at a time, 4 bytes each.
    """

    shell: bool = False
    face_color_step: int = 24
    least_coherence: float = 0.5
    workers: int = 1
    pairs_at_once: int = 1 << 26


@dataclass(frozen=True)
class SurfacePart:
    """The voxels of one cube, and lists of the triangles that come near it."""

    voxels: VoxelSet
    lists: list[NDArray[np.int32]]

    def triangles(self) -> NDArray[np.int32]:
        """Rows of the mesh's triangles that touch the cube, ascending; a few pass close by."""
        return np.unique(np.concatenate([np.zeros(0, np.int32), *self.lists]))


@dataclass(frozen=True)
class TriangleCensus:
    """What kinds of triangles a mesh has: without area, and those that repeat another one."""

    triangles: int
    degenerate: int
    duplicate: int


def triangle_census(mesh: TriangleMesh) -> TriangleCensus:
    """Count triangles without area and triangles with the corners of an earlier one."""
    degenerate = 0
    for start in range(0, len(mesh.triangles), 1 << 20):
        part = mesh.triangles[start : start + (1 << 20)]
        a, b, c = (mesh.vertices[part[:, k]] for k in range(3))
        degenerate += int((~np.cross(b - a, c - a).any(axis=1)).sum())
    return TriangleCensus(len(mesh.triangles), degenerate, _duplicates(mesh.triangles))


def _duplicates(triangles: NDArray[np.int32]) -> int:
    """Rows of (m, 3) that have the corners of an earlier row, in any order."""
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    outer = low.astype(np.int64) << 32 | high
    # Only rows that share lowest and highest corner need a look at the middle one.
    order = np.argsort(outer, kind="stable")
    same = np.diff(outer[order]) == 0
    rows = order[np.concatenate([same, [False]]) | np.concatenate([[False], same])]
    if not len(rows):
        return 0
    return len(rows) - len(np.unique(np.sort(triangles[rows], axis=1), axis=0))


def voxelise(
    mesh: TriangleMesh, grid: VoxelGrid, options: VoxelisationOptions | None = None
) -> VoxelSet:
    """All voxels of a grid that a mesh touches; see `voxel_parts`."""
    return joined_voxels(list(voxel_parts(mesh, grid, options)))


def voxel_parts(
    mesh: TriangleMesh,
    grid: VoxelGrid,
    options: VoxelisationOptions | None = None,
    *,
    part_level: int = 8,
    texture: SurfaceTexture | None = None,
) -> Iterator[VoxelSet]:
    """The voxels of `surface_parts` without the triangles they were made of."""
    for part in surface_parts(mesh, grid, options, part_level=part_level, texture=texture):
        yield part.voxels


def surface_parts(
    mesh: TriangleMesh,
    grid: VoxelGrid,
    options: VoxelisationOptions | None = None,
    *,
    part_level: int = 8,
    texture: SurfaceTexture | None = None,
) -> Iterator[SurfacePart]:
    """The voxels of a grid that a mesh touches, cube after cube in Morton order.

    A voxel is in the set when its closed cube and a triangle with area have a point in
    common. A piece of surface in a plane of the grid counts half in the voxels of either
    side. Colours of vertices (``color``, sRGB) are averaged in linear light.

    Parameters
    ----------
    mesh
        Any triangles; those without area are passed over.
    grid
        A cube around the mesh, such as ``grid_of_mesh`` gives, of level 1…14.
    options
        See `VoxelisationOptions`.
    part_level
        Each part holds the voxels of one aligned cube of 2**part_level voxels a side, or of
        the whole grid where that is smaller; cubes without surface are left out. Grids may
        have 2**8 cubes a side.
    texture
        Of the mesh; voxels then have the mean of what it shows inside them, in linear light,
        instead of the colours of vertices.

    Yields
    ------
    Parts with at least one voxel; one empty part for a mesh without any surface.

    Raises
    ------
    InputError
        Vertices that are not finite or outside the grid, or a level out of bounds.
    """
    chosen = options or VoxelisationOptions()
    job = _Job.of(mesh, grid, chosen, part_level, texture)
    ahead = 2 * chosen.workers
    waiting: deque[Future[SurfacePart]] = deque()
    found = False
    with ThreadPoolExecutor(chosen.workers) as pool:
        try:
            for blocks, lists in job.cubes(part_level):
                waiting.append(pool.submit(job.part, blocks, lists))
                if len(waiting) > ahead:
                    part = waiting.popleft().result()
                    found = found or len(part.voxels) > 0
                    if len(part.voxels):
                        yield part
            while waiting:
                part = waiting.popleft().result()
                found = found or len(part.voxels) > 0
                if len(part.voxels):
                    yield part
        finally:
            for left in waiting:
                left.cancel()
    if not found:
        yield SurfacePart(job.block(0, np.zeros(0, np.int32)), [])


class _Scratch:
    """Room for the sums of one block; pages of it that stay untouched take no memory."""

    def __init__(self, side: int, colored: bool) -> None:
        cells = side**3
        self.slot = np.full(cells, -1, np.int32)
        self.marked = np.zeros(-(-cells // GROUP), np.bool_)
        self.sums = np.empty((cells, row_length(colored)))
        self.flags = np.empty(cells, np.uint8)


@dataclass(frozen=True)
class _Texels:
    """A texture as `add_triangles` reads it; nothing where there is none."""

    page_of: NDArray[np.int32]
    pages: NDArray[np.int64]
    values: NDArray[np.uint8]

    @classmethod
    def of(cls, texture: SurfaceTexture | None) -> _Texels:
        if texture is None:
            return cls(
                np.zeros(0, np.int32), np.zeros((0, 4), np.int64), np.zeros((0, 3), np.uint8)
            )
        sizes = [picture.shape[0] * picture.shape[1] for picture in texture.pictures]
        # Places on the very border are those of a picture that ends there.
        repeats = bool(((texture.places < 0.0) | (texture.places > 1.0)).any())
        pages = [
            (start, picture.shape[0], picture.shape[1], repeats)
            for start, picture in zip(np.cumsum([0, *sizes]), texture.pictures, strict=False)
        ]
        values = np.concatenate([picture.reshape(-1, 3) for picture in texture.pictures])
        return cls(np.ascontiguousarray(texture.pages, np.int32), np.array(pages, np.int64), values)

    def places_of(
        self, texture: SurfaceTexture, triangles: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """(n, 3) column and row of vertices in texels from the middle of the first, and 0."""
        size = self.pages[texture.page_of_vertices(triangles)][:, [COLUMNS, ROWS]]
        places = np.zeros((len(size), 3))
        places[:, :2] = texture.places * size - 0.5
        return places


@dataclass(frozen=True)
class _Job:
    """A mesh in the coordinates of a grid: what every block needs."""

    grid: VoxelGrid
    options: VoxelisationOptions
    points: NDArray[np.float64]
    colors: NDArray[np.float64]
    triangles: NDArray[np.int32]
    texels: _Texels
    block_level: int
    local: threading.local

    @classmethod
    def of(
        cls,
        mesh: TriangleMesh,
        grid: VoxelGrid,
        options: VoxelisationOptions,
        part_level: int,
        texture: SurfaceTexture | None,
    ) -> _Job:
        # A single voxel has no plane in its middle, where coordinates start.
        if not 1 <= grid.level <= FINEST_LEVEL:
            raise InputError(
                "The resolution is out of bounds.",
                expected=f"2 to {1 << FINEST_LEVEL} voxels a side",
                found=str(grid.resolution),
                fix="Choose a resolution within them.",
            )
        block_level = min(BLOCK_LEVEL, part_level, grid.level)
        if block_level < max(grid.level - _MOST_BLOCK_LEVELS, 0):
            raise ValueError(f"parts of level {part_level} are too many for such a grid")
        # From the middle of the grid: a mirrored mesh has the same numbers with another sign.
        points = (mesh.vertices - grid.center) / grid.voxel_size
        inside = np.abs(points) < 0.5 * grid.resolution
        if not inside.all():
            row = int(np.argmin(inside.all(axis=1)))
            raise InputError(
                "A vertex is not finite or lies outside the voxel grid.",
                where=f"vertex {row}",
                expected=f"coordinates inside {grid.origin} + {grid.size}",
                found=str(mesh.vertices[row]),
                fix="Repair the mesh, or take a grid that encloses it.",
            )
        colors = np.zeros((0, 3))
        texels = _Texels.of(texture)
        if texture is not None:
            colors = texels.places_of(texture, mesh.triangles)
        elif "color" in mesh.vertex_attributes:
            colors = LINEAR_OF_BYTE[np.asarray(mesh.vertex_attributes["color"], np.uint8)]
        triangles = np.ascontiguousarray(mesh.triangles, np.int32)
        return cls(grid, options, points, colors, triangles, texels, block_level, threading.local())

    def cubes(self, level: int) -> Iterator[tuple[NDArray[np.int64], list[NDArray[np.int32]]]]:
        """Morton numbers of the blocks of each cube of 2**level voxels, and their triangles."""
        side, per_axis = 1 << self.block_level, 1 << (self.grid.level - self.block_level)
        frame = (self.points, self.triangles, 0.5 * self.grid.resolution, side, per_axis)
        counts = triangles_per_block(*frame)
        used = np.flatnonzero(counts)
        cube = used >> (3 * max(level - self.block_level, 0))
        # Passes over the mesh end between cubes, each with as many lists as may be held.
        firsts = np.flatnonzero(np.diff(cube, prepend=-1))
        ends = np.append(firsts[1:], len(used))
        total = np.cumsum(counts[used])
        begin = 0
        while begin < len(firsts):
            before = total[firsts[begin] - 1] if firsts[begin] else 0
            fit = np.searchsorted(total[ends - 1], before + self.options.pairs_at_once, "right")
            stop = max(int(fit), begin + 1)
            low, high = int(used[firsts[begin]]), int(used[ends[stop - 1] - 1]) + 1
            starts = np.concatenate([[0], np.cumsum(counts[low:high])])
            lists = triangles_by_block(*frame, low, starts)
            for k in range(begin, stop):
                blocks = used[firsts[k] : ends[k]]
                yield blocks, [lists[starts[b - low] : starts[b - low + 1]] for b in blocks]
            begin = stop

    def part(self, blocks: NDArray[np.int64], lists: list[NDArray[np.int32]]) -> SurfacePart:
        """The voxels of some blocks, together."""
        voxels = [self.block(int(b), t) for b, t in zip(blocks, lists, strict=True)]
        return SurfacePart(joined_voxels(voxels), lists)

    def block(self, number: int, chosen: NDArray[np.int32]) -> VoxelSet:
        """The voxels of the block with a Morton number."""
        side = 1 << self.block_level
        scratch: _Scratch | None = getattr(self.local, "scratch", None)
        if scratch is None:
            scratch = self.local.scratch = _Scratch(side, len(self.colors) > 0)
        cell = morton_cells(np.array([number], np.uint64))[0].astype(np.int64)
        corner = cell * side - self.grid.resolution // 2
        sums, flags = scratch.sums, scratch.flags
        used = add_triangles(
            self.points, self.colors, self.triangles, chosen, corner, side,
            scratch.slot, scratch.marked, sums, flags,
            self.texels.page_of, self.texels.pages, self.texels.values,
        )  # fmt: skip
        places, rows = cells_in_order(scratch.slot, scratch.marked, used)
        normal = np.empty((used, 3), np.float32)
        color = np.empty((used if len(self.colors) else 0, 3), np.uint8)
        sided = np.empty(used, np.bool_)
        averages(
            sums, flags, rows, self.options.face_color_step, self.options.least_coherence,
            normal, color, sided,
        )  # fmt: skip
        index = np.flatnonzero(sided)
        face_normal = np.empty((len(index), 6, 3), np.float32)
        face_color = np.empty((len(index) if len(self.colors) else 0, 6, 3), np.uint8)
        face_averages(
            sums, flags, rows[index], normal[index], color[index] if len(color) else color,
            face_normal, face_color,
        )  # fmt: skip
        colored = len(self.colors) > 0
        found = flags[rows]
        faces = found & np.uint8(_FACES)
        return VoxelSet(
            self.grid,
            (np.uint64(number) << np.uint64(3 * self.block_level)) | places.astype(np.uint64),
            sums[rows, AREA] * self.grid.voxel_size**2,
            normal,
            color if colored else None,
            faces | _opposite(faces) if self.options.shell else faces,
            (found & SEPARATING).astype(np.bool_),
            SidedVoxels(index, face_normal, face_color if colored else None),
        )


def _opposite(faces: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Masks with every face exchanged for the one behind it."""
    return (faces & np.uint8(0b010101)) << np.uint8(1) | (faces & np.uint8(0b101010)) >> np.uint8(1)
