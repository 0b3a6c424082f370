"""Files of sparse voxel graphs: one header for all encodings."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.whole_file import whole_file
from workbench.kernels.dag_near_words import BLOCK_BITS
from workbench.voxels.dag_colors import VoxelColors
from workbench.voxels.dag_encoding import ENCODINGS, PLAIN, TURNS_OF, EncodedGraph, Encoding
from workbench.voxels.voxel_dag import COARSEST_LEVEL, FINEST_LEVEL
from workbench.voxels.voxel_set import VoxelGrid

SUFFIX = ".voxgraph"
_MAGIC, _VERSION = b"VOXGRAPH", 1
_CHECKED = struct.Struct("<8sII")
_HEAD = struct.Struct("<BBBBI4dQQQ")
_NO_COLOR, _PLAIN_COLOR, _BYTE_COLOR, _SHORT_COLOR = range(4)


@dataclass(frozen=True)
class VoxelGraph:
    """What a file holds.

    Attributes
    ----------
    graph : the voxels.
    grid : where the cube lies and how large it is, in the mesh's frame and unit.
    colors : of the voxels in the order of their Morton codes, or None.
    """

    graph: EncodedGraph
    grid: VoxelGrid
    colors: VoxelColors | None = None


def write_voxel_graph(path: Path, voxels: VoxelGraph) -> int:
    """Write a graph as one file; same voxels, same bytes.

    All numbers are little-endian:

    ======  ==========  =============================================================
    offset  type        what
    ======  ==========  =============================================================
    0       8 bytes     ``VOXGRAPH``
    8       uint32      version, 1
    12      uint32      CRC-32 of all that follows
    16      uint8       encoding: 0 svo, 1 svdag, 2 ussvdag, 3 esvdag, 4 ssvdag,
                        5 osvdag
    17      uint8       level L; 2^L voxels a side
    18      uint8       turn of the root: mirrors of bit 0 x, 1 y, 2 z; more for osvdag
    19      uint8       colours: 0 none, 1 three bytes each, 2 one byte and 3 two bytes
                        that are places in the palette
    20      uint32      colours in the palette
    24      4 float64   lowest corner of the cube, its side
    56      uint64      voxels
    64      uint64      numbers in the array of nodes
    72      uint64      bricks
    80      uint64      L + 1 places in the array of nodes where depths 0 … L − 1 begin,
                        and where the last ends
    …       uint64      bricks: 4³ voxels each, bit 8 c + g for voxel g of child c
    …       …           nodes: uint8 for svo, uint32 for svdag and ussvdag, uint16 for the
                        others; then zero bytes up to a multiple of eight
    …       uint32      osvdag only: an anchor for every 128 numbers of nodes
    …       uint8       the palette, three bytes sRGB each
    …       …           colours, in the order of the voxels' Morton codes
    ======  ==========  =============================================================

    Children and voxels are numbered x + 2 y + 4 z everywhere. What the nodes mean is told in
    `workbench.kernels.dag_words` and `workbench.kernels.dag_near_words`.

    Parameters
    ----------
    path
        The file to write.
    voxels
        What to write.

    Returns
    -------
    Bytes of the file.
    """
    graph, grid, colors = voxels.graph, voxels.grid, voxels.colors
    kind, palette = _NO_COLOR, np.empty((0, 3), np.uint8)
    values: NDArray[Any] = palette
    if colors is not None:
        palette, values = colors.palette, colors.values
        kind = _PLAIN_COLOR
        if len(palette):
            kind = _BYTE_COLOR if values.dtype == np.uint8 else _SHORT_COLOR
    head = _HEAD.pack(
        ENCODINGS.index(graph.encoding),
        graph.level,
        graph.root_turn,
        kind,
        len(palette),
        *(float(x) for x in grid.origin),
        grid.size,
        graph.voxels,
        len(graph.nodes),
        len(graph.bricks),
    )
    padding = bytes(-graph.nodes.nbytes % 8)
    parts = [head, *(_bytes_of(a) for a in (graph.starts, graph.bricks, graph.nodes))]
    parts += [padding, *(_bytes_of(a) for a in (graph.anchors, palette, values))]
    check = 0
    for part in parts:
        check = zlib.crc32(part, check)
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(_CHECKED.pack(_MAGIC, _VERSION, check))
        for part in parts:
            file.write(part)
    return _CHECKED.size + sum(len(part) for part in parts)


def read_voxel_graph(path: Path) -> VoxelGraph:
    """Read what `write_voxel_graph` wrote.

    Raises
    ------
    InputError
        The file is absent, is no such file, is of a later version, or is damaged.
    """
    data = whole_file(path)
    if data[: len(_MAGIC)] != _MAGIC:
        raise _refused(path, "This is not a sparse voxel graph.", f"it begins {data[:8]!r}")
    if len(data) < _CHECKED.size + _HEAD.size:
        raise _refused(path, "The file is cut off.", f"{len(data)} bytes")
    _, version, check = _CHECKED.unpack_from(data)
    if version != _VERSION:
        raise _refused(
            path, "The file is of a version this program does not know.", f"version {version}"
        )
    if zlib.crc32(memoryview(data)[_CHECKED.size :]) != check:
        raise _refused(path, "The file is damaged.", "its check sum does not fit")
    return _Sections(path, data).voxel_graph()


class _Sections:
    """The file's bytes, taken one array after another."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path, self._data = path, data
        self._at = _CHECKED.size + _HEAD.size

    def voxel_graph(self) -> VoxelGraph:
        head = _HEAD.unpack_from(self._data, _CHECKED.size)
        number, level, turn, kind, palette_size = head[:5]
        voxels, node_count, brick_count = head[9:]
        known = number < len(ENCODINGS) and kind <= _SHORT_COLOR
        if not known or not COARSEST_LEVEL <= level <= FINEST_LEVEL:
            raise _refused(self._path, "The header makes no sense.", f"{head[:5]}")
        encoding = ENCODINGS[number]
        if not (np.isfinite(head[5:9]).all() and head[8] > 0):
            raise _refused(self._path, "The header makes no sense.", "a cube without a place")
        if turn >= TURNS_OF[encoding]:
            raise _refused(self._path, "The header makes no sense.", f"turn {turn} of the root")
        starts = self._taken(np.uint64, level + 1)
        bricks = self._taken(np.uint64, brick_count)
        nodes = self._taken(_type_of_nodes(encoding), node_count)
        self._at += -nodes.nbytes % 8
        blocks = node_count >> BLOCK_BITS if encoding == "osvdag" else 0
        anchors = self._taken(np.uint32, blocks)
        ordered = bool((starts[1:] >= starts[:-1]).all()) and int(starts[-1]) == node_count
        if not ordered or (voxels and not node_count + brick_count):
            raise _refused(self._path, "The header makes no sense.", "depths out of order")
        colors = self._colors(kind, palette_size, voxels)
        if self._at != len(self._data):
            raise _refused(
                self._path, "The file is too long.", f"{len(self._data) - self._at} bytes more"
            )
        graph = EncodedGraph(
            encoding, level, voxels, turn, starts, nodes, bricks, anchors, self._path
        )
        return VoxelGraph(graph, VoxelGrid(np.array(head[5:8]), head[8], level), colors)

    def _colors(self, kind: int, palette_size: int, voxels: int) -> VoxelColors | None:
        palette = self._taken(np.uint8, 3 * palette_size).reshape(-1, 3)
        if kind == _NO_COLOR:
            return None
        if kind == _PLAIN_COLOR:
            return VoxelColors(palette, self._taken(np.uint8, 3 * voxels).reshape(-1, 3))
        values = self._taken(np.uint8 if kind == _BYTE_COLOR else np.uint16, voxels)
        if len(values) and int(values.max()) >= palette_size:
            raise _refused(self._path, "A colour is not in the palette.", f"place {values.max()}")
        return VoxelColors(palette, values)

    def _taken(self, kind: type[np.generic], count: int) -> NDArray[Any]:
        size = count * np.dtype(kind).itemsize
        if self._at + size > len(self._data):
            raise _refused(self._path, "The file is cut off.", f"{len(self._data)} bytes")
        values = np.frombuffer(self._data, np.dtype(kind).newbyteorder("<"), count, self._at)
        self._at += size
        # Kernels are compiled for aligned arrays of the machine's own kind that can be written.
        return values.astype(kind)


def _type_of_nodes(encoding: Encoding) -> type[np.generic]:
    if encoding == "svo":
        return np.uint8
    return np.uint32 if encoding in PLAIN else np.uint16


def _bytes_of(values: NDArray[Any]) -> bytes:
    return values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()


def _refused(path: Path, message: str, found: str) -> InputError:
    return InputError(message, file=path, found=found, fix="Write the file again.")
