"""Cloud optimised point clouds: LAZ files whose chunks are the nodes of an octree.

Source: *COPC – Cloud Optimized Point Cloud Specification, version 1.0*; M. Isenburg,
*LASzip*, for chunks of any size.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from workbench.formats.atomic import replacing
from workbench.formats.las_layout import EVLR_BYTES, LASZIP_RECORD
from workbench.formats.las_writing import LasRecords, Record, las_head
from workbench.formats.point_octree import (
    GRID_LEVEL,
    MEMORY_BYTES,
    Key,
    PointOctree,
    build_octree,
)
from workbench.formats.point_rounding import rounding_of
from workbench.formats.point_stream import PointStream

_INFO = ("copc", 1)
_INFO_BYTES = 160
_HIERARCHY = ("copc", 1000)
_ENTRY = struct.Struct("<iiiiQii")
_COMPRESSED_AT_ONCE = 16 << 20


def write_copc(
    path: Path,
    stream: PointStream,
    *,
    precision: float | None = None,
    memory_bytes: int = MEMORY_BYTES,
) -> dict[str, Any]:
    """Write a COPC 1.0 file; same points, same bytes.

    Points are what `write_las` makes of them. Nodes and levels are those of `build_octree`;
    the hierarchy is one page.

    Parameters
    ----------
    path
        The file; by custom its name ends in ``.copc.laz``. Its folder needs room for the
        uncompressed points twice.
    stream
        The points.
    precision
        Step of coordinates, by default that of `rounding_of`.
    memory_bytes
        Bound of the working memory.

    Returns
    -------
    ``bytes``, ``precision``, ``rounding_error`` as of `write_las`, ``levels``, ``nodes`` and
    ``points_per_level``.

    Raises
    ------
    SettingsError
        The precision does not fit the size of the cloud, or there is too little memory.
    """
    path = Path(path)
    rounding = rounding_of(stream.low, stream.high, precision)
    layout = LasRecords(stream.attributes, rounding)
    vlr = lazrs.LazVlr.new_for_compression(layout.point_format, layout.extra_bytes, True)
    low, high = layout.rounded_box(stream.low, stream.high)

    def head(info: bytes, extended: tuple[int, int]) -> bytes:
        records: Sequence[Record] = [
            (_INFO, info), (LASZIP_RECORD, vlr.record_data()), *layout.extra_record(),
        ]  # fmt: skip
        return las_head(
            layout, stream.count, low, high, records, compressed=True, extended=extended
        )

    with replacing(path) as partial, open(partial, "wb+") as file:
        file.write(head(bytes(_INFO_BYTES), (0, 0)))
        points_start = file.tell()
        sink = _Chunks(file, vlr)
        tree = build_octree(
            stream, rounding, layout.rows, sink, path.parent, memory_bytes=memory_bytes
        )
        sizes = sink.finished(points_start)
        page = _page(tree, sink.keys, sizes, points_start + 8)
        file.seek(0, 2)
        record_start = file.tell()
        owner, number = _HIERARCHY
        file.write(struct.pack("<2x16sHQ32x", owner.encode(), number, len(page)) + page)
        info = _info(tree, layout, record_start + EVLR_BYTES, len(page))
        file.seek(0)
        file.write(head(info, (record_start, 1)))
    return {
        "bytes": path.stat().st_size,
        "precision": rounding.step,
        "rounding_error": rounding.step / 2,
        **told_of_tree(tree),
    }


def told_of_tree(tree: PointOctree) -> dict[str, Any]:
    """``levels``, ``nodes`` and ``points_per_level`` of a tree."""
    per_level = np.zeros(tree.levels, np.int64)
    for key, count in tree.counts.items():
        per_level[key[0]] += count
    return {
        "levels": tree.levels,
        "nodes": sum(count > 0 for count in tree.counts.values()),
        "points_per_level": per_level.tolist(),
    }


class _Chunks:
    """Nodes of a tree as chunks of a LAZ file, some megabytes compressed at once."""

    def __init__(self, file: BinaryIO, vlr: Any) -> None:
        self.keys: list[Key] = []
        self._file, self._vlr = file, vlr
        self._zipper = lazrs.ParLasZipCompressor(file, vlr)
        self._waiting: list[bytes] = []

    def node(self, key: Key, rows: NDArray[np.void]) -> None:
        """Take a node."""
        self.keys.append(key)
        self._waiting.append(rows.tobytes())
        if sum(map(len, self._waiting)) >= _COMPRESSED_AT_ONCE:
            self._compress()

    def finished(self, points_start: int) -> list[int]:
        """Write the table of chunks; returns the bytes of each node's."""
        self._compress()
        self._zipper.done()
        self._file.flush()
        self._file.seek(points_start)
        chunks = lazrs.read_chunk_table(self._file, self._vlr)
        return [size for _, size in chunks if size]

    def _compress(self) -> None:
        if self._waiting:
            self._zipper.compress_chunks(self._waiting)
            self._waiting = []


def _page(tree: PointOctree, keys: Sequence[Key], sizes: Sequence[int], start: int) -> bytes:
    """All entries of the hierarchy, coarse levels first."""
    places = dict(zip(keys, zip(np.cumsum([start, *sizes[:-1]]).tolist(), sizes, strict=True),
                      strict=True))  # fmt: skip
    return b"".join(
        _ENTRY.pack(*key, *places.get(key, (0, 0)), count)
        for key, count in sorted(tree.counts.items())
    )


def _info(tree: PointOctree, layout: LasRecords, page_start: int, page_bytes: int) -> bytes:
    rounding = layout.rounding
    half = tree.side * rounding.step / 2
    center = tree.corner * rounding.step + rounding.origin + half
    spacing = 2 * half / 2**GRID_LEVEL
    body = struct.pack("<5dQQdd", *center, half, spacing, page_start, page_bytes, 0.0, 0.0)
    return body.ljust(_INFO_BYTES, b"\0")
