"""A surface cut into chunks, in one file of which only those are read that rays may meet.

Everything is little-endian.

=======  ================================================================================
header   ``WBCHUNKS``, version, flags (1 colour), middle (3 float64) and unit (float64) of the
         local frame, numbers of vertices and triangles of the surface, of nodes and chunks,
         offset of the index, CRC-32 of the index and of the header before it
chunks   in the order of the tree's leaves, so that a subtree is one range of the file
index    the tree's nodes, the root first and children behind their parent, then the chunks
=======  ================================================================================

A chunk has positions (3 float32 each, local), the vertices' numbers in the surface (uint32), the
corners of its triangles among its vertices (3 uint16), the triangles' numbers (uint32), and, with
colour, one sRGB colour a triangle (3 bytes). A vertex that several chunks use is in each of them.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.atomic import replacing
from workbench.formats.indexed_file import IndexedFormat
from workbench.raytracing.chunk_tree import NODE, ChunkTree, tree_over
from workbench.raytracing.frame import LocalFrame

CHUNK_SUFFIX = ".raychunks"
#: A chunk's corners are counted with 16 bits, and every triangle may bring three vertices.
MOST_TRIANGLES = (1 << 16) // 3
_COLORED = 1

_FORMAT = IndexedFormat(
    header=np.dtype(
        [
            ("magic", "S8"), ("version", "<u4"), ("flags", "<u4"), ("middle", "<f8", 3),
            ("unit", "<f8"), ("vertices", "<u8"), ("triangles", "<u8"), ("nodes", "<u4"),
            ("chunks", "<u4"), ("index_offset", "<u8"), ("index_crc", "<u4"),
            ("header_crc", "<u4"),
        ]
    ),
    magic=b"WBCHUNKS",
    version=1,
    kind="a surface in chunks, as the workbench writes it for rays",
    without="The file holds no surface in chunks.",
)  # fmt: skip

CHUNK = np.dtype(
    [
        ("offset", "<u8"), ("stored", "<u4"), ("crc", "<u4"), ("vertices", "<u4"),
        ("triangles", "<u4"), ("low", "<f4", 3), ("high", "<f4", 3),
    ]
)  # fmt: skip


@dataclass(frozen=True)
class SurfaceChunk:
    """Some triangles of a surface with the vertices they use.

    Attributes
    ----------
    positions : (v, 3) float32 in the local frame.
    vertex_numbers : (v,) uint32, in the surface.
    corners : (t, 3) uint16 or uint32, among the chunk's vertices.
    numbers : (t,) uint32, of the triangles in the surface.
    colors : (t, 3) uint8 sRGB, or None.
    """

    positions: NDArray[np.float32]
    vertex_numbers: NDArray[np.uint32]
    corners: NDArray[np.uint16] | NDArray[np.uint32]
    numbers: NDArray[np.uint32]
    colors: NDArray[np.uint8] | None

    def stored(self) -> bytes:
        """As in the file."""
        parts: list[tuple[NDArray[Any], str]] = [
            (self.positions, "<f4"), (self.vertex_numbers, "<u4"), (self.corners, "<u2"),
            (self.numbers, "<u4"),
        ]  # fmt: skip
        if self.colors is not None:
            parts.append((self.colors, "u1"))
        return b"".join(np.ascontiguousarray(values, kind).tobytes() for values, kind in parts)


def joined_chunks(chunks: list[SurfaceChunk]) -> SurfaceChunk:
    """One chunk of several; vertices that they share stay apart."""
    starts = np.cumsum([0, *(len(chunk.positions) for chunk in chunks)])
    colors = [chunk.colors for chunk in chunks if chunk.colors is not None]
    return SurfaceChunk(
        np.concatenate([chunk.positions for chunk in chunks]),
        np.concatenate([chunk.vertex_numbers for chunk in chunks]),
        np.concatenate(
            [
                chunk.corners.astype(np.uint32) + np.uint32(start)
                for chunk, start in zip(chunks, starts, strict=False)
            ]
        ),
        np.concatenate([chunk.numbers for chunk in chunks]),
        np.concatenate(colors) if colors else None,
    )


def write_chunk_file(
    path: Path,
    frame: LocalFrame,
    chunks: Iterable[SurfaceChunk],
    *,
    vertices: int,
    colored: bool,
) -> None:
    """Write chunks as they come, then the tree over them; the file is there when it is whole.

    Parameters
    ----------
    path
        The file to write.
    frame
        Of the chunks' positions.
    chunks
        In an order that follows space; at least one, of at most ``MOST_TRIANGLES`` each.
    vertices
        Of the whole surface.
    colored
        Whether the chunks have colours.
    """
    records = []
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(bytes(_FORMAT.header.itemsize))
        for chunk in chunks:
            body = chunk.stored()
            low, high = chunk.positions.min(axis=0), chunk.positions.max(axis=0)
            counts = (len(chunk.positions), len(chunk.corners))
            records.append((file.tell(), len(body), zlib.crc32(body), *counts, low, high))
            file.write(body)
        table = np.array(records, CHUNK)
        tree = tree_over(table["low"], table["high"], table["triangles"].astype(np.int64))
        index = tree.nodes.tobytes() + table.tobytes()
        fields = {
            "flags": _COLORED if colored else 0,
            "middle": frame.middle,
            "unit": frame.unit,
            "vertices": vertices,
            "triangles": int(table["triangles"].sum(dtype=np.int64)),
            "nodes": len(tree.nodes),
            "chunks": len(table),
            "index_offset": file.tell(),
        }
        file.write(index)
        file.seek(0)
        file.write(_FORMAT.sealed(fields, index))


class ChunkFile:
    """A file of `write_chunk_file`, read chunk by chunk.

    Attributes
    ----------
    path : the file.
    frame : of positions.
    vertices, triangles : of the whole surface.
    tree : over the chunks.
    chunks : (k,) of dtype ``CHUNK``.
    colored : whether triangles have colours.

    Raises
    ------
    InputError
        Not such a file, or a damaged one; also from the methods, for the part they read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        header, index = _FORMAT.opened(self.path, _check_header, _check_end)
        nodes = np.frombuffer(index, NODE, int(header["nodes"]))
        self.chunks = np.frombuffer(index, CHUNK, int(header["chunks"]), nodes.nbytes)
        self.tree = ChunkTree(nodes)
        _check_tree(self.path, self.tree, len(self.chunks))
        self.frame = LocalFrame(np.array(header["middle"]), float(header["unit"]))
        self.vertices, self.triangles = int(header["vertices"]), int(header["triangles"])
        self.colored = bool(header["flags"] & _COLORED)

    def read(self, first: int, count: int) -> list[SurfaceChunk]:
        """Some chunks that follow one another."""
        records = self.chunks[first : first + count]
        begin = int(records["offset"][0])
        end = int(records["offset"][-1]) + int(records["stored"][-1])
        with open(self.path, "rb") as file:
            file.seek(begin)
            data = memoryview(file.read(end - begin))
        return [
            self._chunk(record, data[int(record["offset"]) - begin :][: int(record["stored"])])
            for record in records
        ]

    def stored_bytes(self, first: int, count: int) -> int:
        """Of some chunks that follow one another, in the file."""
        return int(self.chunks["stored"][first : first + count].sum(dtype=np.int64))

    def _chunk(self, record: Any, body: memoryview) -> SurfaceChunk:
        v, t = int(record["vertices"]), int(record["triangles"])
        expected = 16 * v + (13 if self.colored else 10) * t
        if len(body) != int(record["stored"]) or zlib.crc32(body) != int(record["crc"]):
            raise _FORMAT.refused(self.path, "A chunk of the file is damaged.", "a wrong checksum")
        if len(body) != expected:
            raise _FORMAT.refused(
                self.path, "A chunk of the file is damaged.", f"{len(body)} of {expected} bytes"
            )
        corners = np.frombuffer(body, "<u2", 3 * t, 16 * v).reshape(-1, 3)
        if t and int(corners.max()) >= v:
            raise _FORMAT.refused(self.path, "A chunk of the file is damaged.", "a wrong corner")
        return SurfaceChunk(
            np.frombuffer(body, "<f4", 3 * v).reshape(-1, 3),
            np.frombuffer(body, "<u4", v, 12 * v),
            corners,
            np.frombuffer(body, "<u4", t, 16 * v + 6 * t),
            np.frombuffer(body, "u1", 3 * t, 16 * v + 10 * t).reshape(-1, 3)
            if self.colored
            else None,
        )


def _check_header(path: Path, header: Any) -> None:
    sizes = ("triangles", "nodes", "chunks")
    if not all(int(header[name]) for name in sizes) or not float(header["unit"]) > 0.0:
        raise _FORMAT.refused(path, "The header of the file is damaged.", "no size")


def _check_end(path: Path, header: Any, end: int) -> None:
    index = int(header["nodes"]) * NODE.itemsize + int(header["chunks"]) * CHUNK.itemsize
    if int(header["index_offset"]) + index != end:
        raise _FORMAT.refused(path, "The file is cut short.", f"{end} bytes")


def _check_tree(path: Path, tree: ChunkTree, chunks: int) -> None:
    nodes = tree.nodes
    inner = np.flatnonzero(nodes["left"] >= 0)
    links = np.stack([nodes["left"][inner], nodes["right"][inner]])
    ranges = nodes["first"].astype(np.int64) + nodes["count"]
    if (links <= inner).any() or (links >= len(nodes)).any() or (ranges > chunks).any():
        raise _FORMAT.refused(path, "The index names nodes that are not there.", "a wrong link")
