"""Levels of detail of surface voxels in one file that is read chunk by chunk.

Everything is little-endian. A reader asks for the header, then for the index, then for the
chunks it needs, each with one HTTP range request.

=======  ================================================================================
header   80 bytes: ``WBVOXLOD``, version, flags (1 colour, 2 zstd, 4 geometry, 8 the thin
         subset), level, chunk level, corner of the grid (3 float64) and its side (float64)
         in the unit of the mesh, offset of the index, number of nodes, CRC-32 of the index
         and of the header before it
chunks   in any order, whole or compressed with zstd one by one
index    the last bytes of the file, 96 per node, sorted by level and then in Morton order,
         so that the first node is the root
=======  ================================================================================

A node is one chunk: a cube of 2**chunk_level voxels a side of its level. Its record has the
level; a bit for each of the eight children, in Morton order (x lowest), and the row of the
first of them, the others following it; bounds of its voxels, both inclusive, in voxels of the
chunk; its place among the chunks of its level (x, y, z); numbers of voxels and of those whose
faces differ; and offset, bytes in the file, bytes when unpacked and CRC-32 (of the bytes in
the file) of its voxels. Nodes of the finest level have the same four, and numbers of vertices
and triangles, for the original surface.

A chunk's voxels, in Morton order, take 8 bytes, or 12 with colour:

======  =================================================================================
0…2     x, y, z in the chunk
3       bits 0…5: faces −x, +x, −y, +y, −z, +z to show; 6: of the 6-separating subset;
        7: its faces differ
4…7     normal, 10 bits an axis from the lowest: 512 + 511 × component; 512, 512, 512: none
8…11    red, green, blue (sRGB), 0
======  =================================================================================

After them, for the voxels whose faces differ, in order: where the faces of each start in the
list of faces (uint32), and that list: normal and colour of every face to show, 4 or 8 bytes
each. Faces on the border of a chunk are always shown, so that chunks of two levels meet
without a hole.

The original surface of a chunk is every triangle that touches it: vertices (3 float32 each,
from the chunk's corner), colours (red, green, blue, 0 each) when there are any, and
triangles (3 uint32 each).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.morton import morton_cells
from workbench.voxels.chunk_bytes import ChunkVoxels, chunk_bytes, chunk_of_bytes
from workbench.voxels.lod_layout import (
    COLORED,
    COMPRESSED,
    GEOMETRY,
    HEADER,
    NODE,
    THIN,
    LodLayout,
    header_bytes,
    read_layout,
    refused,
)
from workbench.voxels.lod_levels import LodChunk, capped
from workbench.voxels.voxel_set import VoxelGrid

_ZSTD_LEVEL = 3


@dataclass(frozen=True)
class LodFileOptions:
    """What a file holds besides the voxels.

    Attributes
    ----------
    chunk_level : chunks are cubes of 2**chunk_level voxels a side.
    compressed : chunks are compressed with zstd.
    colored, geometry, thin : what the chunks that will come have.
    """

    chunk_level: int
    compressed: bool
    colored: bool
    geometry: bool
    thin: bool

    @property
    def flags(self) -> int:
        """As the header has them."""
        given = (self.colored, self.compressed, self.geometry, self.thin)
        bits = (COLORED, COMPRESSED, GEOMETRY, THIN)
        return sum(bit for bit, on in zip(bits, given, strict=True) if on)


def write_lod_file(
    path: Path,
    grid: VoxelGrid,
    chunks: Iterable[tuple[LodChunk, TriangleMesh | None]],
    options: LodFileOptions,
) -> NDArray[np.void]:
    """Write chunks as they come, then the index; the file is there when it is whole.

    Parameters
    ----------
    path
        The file to write.
    grid
        The cube of the finest level.
    chunks
        Chunks of ``lod_chunks``, in any order, each with the surface that touches it, in the
        mesh's frame, or None.
    options
        What the chunks have.

    Returns
    -------
    The index (n,), of dtype ``NODE``.
    """
    packer = zstandard.ZstdCompressor(level=_ZSTD_LEVEL) if options.compressed else None
    records, numbers = [], []
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(bytes(HEADER.itemsize))
        for chunk, surface in chunks:
            record = _chunk_record(chunk, options.chunk_level)
            body = chunk_bytes(capped(chunk.voxels, options.chunk_level), options.chunk_level)
            _append(file, record, "", body, packer)
            if surface is not None:
                corner = _corner(grid.at_level(chunk.level), record["place"], options.chunk_level)
                record["vertices"] = len(surface.vertices)
                record["triangles"] = len(surface.triangles)
                _append(file, record, "geometry_", _surface_bytes(surface, corner), packer)
            records.append(record)
            numbers.append(chunk.number)
        nodes = _linked(np.array(records, NODE), np.array(numbers, np.int64))
        layout = LodLayout(grid, options.chunk_level, options.flags, nodes)
        index_offset = file.tell()
        file.write(nodes.tobytes())
        file.seek(0)
        file.write(header_bytes(layout, index_offset))
    return nodes


def _chunk_record(chunk: LodChunk, chunk_level: int) -> Any:
    record = np.zeros((), NODE)
    local = chunk.voxels.cells & ((1 << chunk_level) - 1)
    record["level"], record["children"] = chunk.level, chunk.children
    record["low"], record["high"] = local.min(axis=0), local.max(axis=0)
    record["place"] = morton_cells(np.array([chunk.number], np.uint64))[0]
    record["voxels"], record["sided"] = len(chunk.voxels), len(chunk.voxels.sided.index)
    return record


def _append(file: BinaryIO, record: Any, prefix: str, body: bytes, packer: Any) -> None:
    stored = packer.compress(body) if packer is not None else body
    record[f"{prefix}offset"] = file.tell()
    record[f"{prefix}stored"], record[f"{prefix}plain"] = len(stored), len(body)
    record[f"{prefix}crc"] = zlib.crc32(stored)
    file.write(stored)


def _linked(nodes: NDArray[np.void], numbers: NDArray[np.int64]) -> NDArray[np.void]:
    """The nodes level by level in Morton order, each with the row of its first child."""
    order = np.lexsort((numbers, nodes["level"]))
    nodes, numbers = nodes[order], numbers[order]
    counts = np.bitwise_count(nodes["children"]).astype(np.int64)
    # Level by level in Morton order, children come in the order of their parents.
    first = 1 + np.cumsum(counts) - counts
    nodes["first_child"] = np.where(counts > 0, first, 0)
    return nodes


def _corner(grid: VoxelGrid, place: NDArray[Any], chunk_level: int) -> NDArray[np.float64]:
    """(3,) the corner of a chunk, in the mesh's frame."""
    side = grid.voxel_size * (1 << chunk_level)
    return grid.origin + place.astype(np.float64) * side


def _surface_bytes(surface: TriangleMesh, corner: NDArray[np.float64]) -> bytes:
    parts = [(surface.vertices - corner).astype("<f4").tobytes()]
    if "color" in surface.vertex_attributes:
        color = np.zeros((len(surface.vertices), 4), np.uint8)
        color[:, :3] = surface.vertex_attributes["color"]
        parts.append(color.tobytes())
    return b"".join([*parts, surface.triangles.astype("<u4").tobytes()])


class LodFile:
    """A file of `write_lod_file`, read chunk by chunk.

    Attributes
    ----------
    path : the file.
    grid, chunk_level, flags, nodes : as in ``LodLayout``.

    Raises
    ------
    InputError
        Not such a file, or a damaged one; also from the methods, for the part they read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        layout = read_layout(self.path)
        self.grid, self.nodes = layout.grid, layout.nodes
        self.chunk_level, self.flags = layout.chunk_level, layout.flags

    @property
    def colored(self) -> bool:
        return bool(self.flags & COLORED)

    def chunk(self, node: int) -> ChunkVoxels:
        """The voxels of a node, by its row in the index."""
        record = self.nodes[node]
        body = self._body(record, "", int(record["voxels"]) * 12 + int(record["sided"]) * 52)
        try:
            chunk = chunk_of_bytes(body, int(record["voxels"]), int(record["sided"]), self.colored)
        except InputError as error:
            raise refused(self.path, error.message, error.found or "") from error
        if (chunk.cells >> self.chunk_level).any():
            raise refused(self.path, "A chunk of the file is damaged.", "voxels outside it")
        return chunk

    def geometry(self, node: int) -> TriangleMesh | None:
        """The original surface that touches a node, in the mesh's frame, where there is one."""
        record = self.nodes[node]
        vertices, triangles = int(record["vertices"]), int(record["triangles"])
        if not triangles:
            return None
        color_bytes = 4 * vertices if self.colored else 0
        expected = 12 * (vertices + triangles) + color_bytes
        body = self._body(record, "geometry_", expected)
        if len(body) != expected:
            raise refused(self.path, "The surface of a chunk is damaged.", f"{len(body)} bytes")
        local = np.frombuffer(body, "<f4", 3 * vertices).reshape(-1, 3).astype(np.float64)
        index = np.frombuffer(body, "<u4", offset=12 * vertices + color_bytes).reshape(-1, 3)
        if (index >= vertices).any():
            raise refused(self.path, "The surface of a chunk is damaged.", f"index {index.max()}")
        grid = self.grid.at_level(int(record["level"]))
        mesh = TriangleMesh(
            local + _corner(grid, record["place"], self.chunk_level), index.astype(np.int32)
        )
        if not self.colored:
            return mesh
        color = np.frombuffer(body, np.uint8, color_bytes, 12 * vertices).reshape(-1, 4)
        return mesh.with_attributes(color=color[:, :3].copy())

    def _body(self, record: Any, prefix: str, most: int) -> bytes:
        """The unpacked bytes of one range; ``most`` guards against a bomb."""
        stored, plain = int(record[f"{prefix}stored"]), int(record[f"{prefix}plain"])
        with open(self.path, "rb") as file:
            file.seek(int(record[f"{prefix}offset"]))
            data = file.read(stored)
        if len(data) != stored or zlib.crc32(data) != int(record[f"{prefix}crc"]):
            raise refused(self.path, "A chunk of the file is damaged.", "a wrong checksum")
        if plain > most:
            raise refused(self.path, "A chunk of the file is damaged.", f"{plain} bytes unpacked")
        if not self.flags & COMPRESSED:
            return data
        try:
            # The library makes room for what the frame says, whatever it is told here.
            if zstandard.frame_content_size(data) != plain:
                raise refused(self.path, "A chunk of the file is damaged.", "another size")
            body = zstandard.ZstdDecompressor().decompress(data)
        except zstandard.ZstdError as error:
            raise refused(self.path, "A chunk of the file is damaged.", str(error)) from error
        if len(body) != plain:
            raise refused(self.path, "A chunk of the file is damaged.", f"{len(body)} bytes")
        return body
