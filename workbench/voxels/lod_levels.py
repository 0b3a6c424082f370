"""Levels of detail of surface voxels, made from the voxels alone, chunk after chunk.

Eight voxels become one: faces by or, attributes by their mean, so every voxel encloses those
it was made of (Chajdas, Reitinger and Westermann 2014, "Scalable rendering for very large
meshes", section 3). The paper sorts voxels by all but the last bit of each coordinate to
find which belong together; Morton order has them together at every level already. A chunk is
finished when the next one lies elsewhere, so one chunk per level is open at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from workbench.kernels.voxel_merging import add_voxels, faces_of_kept, thin_subset
from workbench.kernels.voxel_sums import AREA, averages, face_averages, row_length
from workbench.voxels.voxel_set import SidedVoxels, VoxelSet, joined_voxels

CHUNK_LEVEL = 8
_ALL_FACES = np.uint8(63)
_SEPARATING = np.uint8(64)
_ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class LodChunk:
    """The voxels of one level inside one aligned cube.

    Attributes
    ----------
    number : Morton number of the cube among those of its level.
    children : bit i is set when the i-th of the eight cubes of the next finer level has
        voxels.
    voxels : of the whole grid at the chunk's level; only those of the cube.
    """

    number: int
    children: int
    voxels: VoxelSet

    @property
    def level(self) -> int:
        """The level of the voxels."""
        return self.voxels.grid.level


def lod_chunks(
    parts: Iterable[VoxelSet],
    *,
    chunk_level: int = CHUNK_LEVEL,
    face_color_step: int = 24,
    least_coherence: float = 0.5,
) -> Iterator[LodChunk]:
    """Chunks of all levels, children before their parent, the one of the root last.

    Parameters
    ----------
    parts
        Voxels of the finest level, one part for each cube of 2**chunk_level voxels a side,
        in Morton order: as ``voxel_parts`` gives them with this ``part_level``. Parts without
        voxels are passed over.
    chunk_level
        Level of the cubes; 8 or less, so that coordinates in a chunk fit a byte.
    face_color_step, least_coherence
        When a voxel keeps attributes for each face; see ``VoxelisationOptions``.
    """
    if not 1 <= chunk_level <= CHUNK_LEVEL:
        raise ValueError(f"chunk_level must be within 1…{CHUNK_LEVEL}")
    finest = chunk_level
    open_: dict[int, list[LodChunk]] = {}

    def parent(level: int) -> LodChunk:
        chunk = _parent(open_.pop(level))
        keep_open(chunk)
        return chunk

    def keep_open(chunk: LodChunk) -> None:
        # What is left to do with a chunk needs its coarser voxels only.
        if chunk.level > chunk_level:
            coarse = coarser_voxels(chunk.voxels, face_color_step, least_coherence)
            open_.setdefault(chunk.level, []).append(replace(chunk, voxels=coarse))

    for part in parts:
        if not len(part):
            continue
        number = int(part.codes[0]) >> 3 * chunk_level
        finest = level = part.grid.level
        above = number >> 3
        while level > chunk_level and level in open_ and open_[level][0].number >> 3 != above:
            yield parent(level)
            level, above = level - 1, above >> 3
        chunk = LodChunk(number, 0, part)
        keep_open(chunk)
        yield chunk
    for level in range(finest, chunk_level, -1):
        yield parent(level)


def _parent(children: list[LodChunk]) -> LodChunk:
    """The chunk of the chunks (with their coarser voxels) that lie in it."""
    mask = sum(1 << (child.number & 7) for child in children)
    coarse = joined_voxels([child.voxels for child in children])
    return LodChunk(children[0].number >> 3, mask, coarse)


def coarser_voxels(
    voxels: VoxelSet, face_color_step: int = 24, least_coherence: float = 0.5
) -> VoxelSet:
    """The voxels of twice the side that enclose those of a set.

    Areas add up, normals and colours (in linear light) are averaged by area, faces are
    united, and one of the 6-separating subset makes one of it: a path through faces of
    coarse voxels that passes them by would have done so among the fine ones.
    """
    if not len(voxels):
        return replace(voxels, grid=voxels.grid.at_level(voxels.grid.level - 1))
    starts = np.flatnonzero(np.diff(voxels.codes >> np.uint64(3), prepend=np.uint64(1 << 63)))
    ends = np.append(starts[1:], len(voxels))
    parts = []
    # In pieces: the sums are far larger than the voxels they are made of.
    for first in range(0, len(starts), _ROWS_AT_ONCE):
        last = min(first + _ROWS_AT_ONCE, len(starts))
        piece = slice(int(starts[first]), int(ends[last - 1]))
        parts.append(_coarser_piece(voxels, piece, face_color_step, least_coherence))
    return joined_voxels(parts)


def _coarser_piece(voxels: VoxelSet, piece: slice, step: int, coherence: float) -> VoxelSet:
    codes = voxels.codes[piece] >> np.uint64(3)
    new = np.diff(codes, prepend=np.uint64(1 << 63)) != 0
    run = np.cumsum(new, dtype=np.int64) - 1
    count = int(run[-1]) + 1
    colored = voxels.color is not None
    color = np.zeros((0, 3), np.uint8) if voxels.color is None else voxels.color[piece]
    side = np.full(len(codes), -1, np.int32)
    first, last = np.searchsorted(voxels.sided.index, [piece.start, piece.stop])
    side[voxels.sided.index[first:last] - piece.start] = np.arange(first, last)
    face_color = voxels.sided.color
    if face_color is None:
        face_color = np.zeros((0, 6, 3), np.uint8)
    sums, flags = np.zeros((count, row_length(colored))), np.zeros(count, np.uint8)
    add_voxels(
        run, voxels.area[piece], voxels.normal[piece], color, voxels.faces[piece],
        voxels.separating[piece], side, voxels.sided.normal, face_color, sums, flags,
    )  # fmt: skip
    rows = np.arange(count)
    normal = np.empty((count, 3), np.float32)
    mean_color = np.empty((count if colored else 0, 3), np.uint8)
    sided = np.empty(count, np.bool_)
    averages(sums, flags, rows, step, coherence, normal, mean_color, sided)
    index = np.flatnonzero(sided)
    new_normal = np.empty((len(index), 6, 3), np.float32)
    new_color = np.empty((len(index) if colored else 0, 6, 3), np.uint8)
    face_averages(
        sums, flags, rows[index], normal[index], mean_color[index] if colored else mean_color,
        new_normal, new_color,
    )  # fmt: skip
    return VoxelSet(
        voxels.grid.at_level(voxels.grid.level - 1),
        codes[new],
        sums[:, AREA],
        normal,
        mean_color if colored else None,
        flags & _ALL_FACES,
        (flags & _SEPARATING).astype(np.bool_),
        SidedVoxels(index, new_normal, new_color if colored else None),
    )


def thin_part(part: VoxelSet, chunk_level: int = CHUNK_LEVEL) -> VoxelSet:
    """The 6-separating voxels of one chunk, and features too thin for them.

    Kept voxels show the faces that come to light where others are dropped, and all faces on
    the border of the chunk, beyond which it is not known what is dropped.
    """
    keep = thin_subset(part.codes, part.faces, part.normal, part.separating, chunk_level)
    shown = faces_of_kept(part.codes, part.faces, keep, chunk_level)
    return capped(replace(part, faces=shown).subset(keep), chunk_level)


def capped(part: VoxelSet, chunk_level: int = CHUNK_LEVEL) -> VoxelSet:
    """The same voxels with every face on the border of their chunk set.

    The neighbour may be shown at another level, or not yet; with these caps no hole opens
    between the two.
    """
    last = (1 << chunk_level) - 1
    local = part.cells & last
    faces = part.faces.copy()
    for axis in range(3):
        faces[local[:, axis] == 0] |= np.uint8(1 << 2 * axis)
        faces[local[:, axis] == last] |= np.uint8(2 << 2 * axis)
    return replace(part, faces=faces)
