"""Cloud Optimized Point Clouds: LAZ files whose chunks are the nodes of an octree.

Source: *COPC – Cloud Optimized Point Cloud Specification 1.0*; LAS and LAZ as in
`workbench.formats.las_layout`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import lazrs
import numpy as np

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.las_layout import EVLR_BYTES, HEADER_BYTES, LASZIP_RECORD, VLR_BYTES
from workbench.formats.las_writing import LasRecords, Record, las_head
from workbench.formats.octree_nodes import CELLS, NodeKey, OctreeNode, PointOctree

_INFO = ("copc", 1)
_HIERARCHY = ("copc", 1000)
_INFO_BYTES = 160
_CHUNKS_AT_ONCE = 16
_ENTRY = np.dtype([("key", "<i4", (4,)), ("at", "<u8"), ("bytes", "<i4"), ("points", "<i4")])


def write_copc(path: Path, octree: PointOctree) -> dict[str, Any]:
    """Write an octree as a COPC file; same nodes, same bytes.

    Points are those of `write_las`. The first record is the ``copc`` info; chunks follow in
    the order of the nodes, and the hierarchy in one page behind them. The spacing of the root
    is its side by 128.

    Parameters
    ----------
    path
        The file; it is whole or not there.
    octree
        Its nodes are asked for once.

    Returns
    -------
    ``bytes`` of the file, ``precision``, ``rounding_error`` (half of it), ``nodes`` and
    ``levels``.
    """
    layout = LasRecords(octree.attributes, octree.rounding)
    vlr = lazrs.LazVlr.new_for_compression(layout.point_format, layout.extra_bytes, True)
    records: list[Record] = [
        (_INFO, bytes(_INFO_BYTES)),
        (LASZIP_RECORD, vlr.record_data()),
        *layout.extra_record(),
    ]
    corner, side = octree.cube.placed(octree.rounding)
    box = np.stack([np.full(3, np.iinfo(np.int32).max), np.full(3, np.iinfo(np.int32).min)])

    def head(extended: tuple[int, int], corners: Any) -> bytes:
        low, high = octree.rounding.coordinates(corners)
        return las_head(
            layout, octree.count, low, high, records, compressed=True, extended=extended
        )

    with replacing(path) as partial, open(partial, "wb+") as file:
        file.write(head((0, 0), box))
        start = file.tell()
        keys: list[NodeKey] = []
        counts: list[int] = []
        zipper = lazrs.ParLasZipCompressor(file, vlr)
        for group in _groups(octree.nodes()):
            for node in group:
                keys.append(node.key)
                counts.append(len(node.points))
                if len(node.points):
                    box[0] = np.minimum(box[0], node.whole.min(axis=0))
                    box[1] = np.maximum(box[1], node.whole.max(axis=0))
            zipper.compress_chunks(
                [layout.rows_of(n.whole, n.points).tobytes() for n in group if len(n.points)]
            )
        zipper.done()
        if sum(counts) != octree.count:
            raise InputError(
                "The points changed while they were read.",
                file=path,
                expected=f"{octree.count} points",
                found=f"{sum(counts)} points",
                fix="Leave the file alone until the export is done.",
            )
        entries = _entries(file, vlr, start, keys, counts)
        end = file.seek(0, 2)
        hierarchy = entries.tobytes()
        owner, number = _HIERARCHY
        file.write(struct.pack("<2x16sHQ32x", owner.encode(), number, len(hierarchy)))
        file.write(hierarchy)
        file.seek(0)
        file.write(head((end, 1), box))
        file.seek(HEADER_BYTES + VLR_BYTES)
        center, spacing = corner + side / 2, side / CELLS
        file.write(struct.pack("<5d2Q2d", *center, side / 2, spacing, end + EVLR_BYTES,
                               len(hierarchy), 0.0, 0.0))  # fmt: skip
    return {
        "bytes": Path(path).stat().st_size,
        "precision": octree.rounding.step,
        "rounding_error": octree.rounding.step / 2,
        "nodes": len(keys),
        "levels": max(key.level for key in keys) + 1,
    }


def _groups(nodes: Iterator[OctreeNode]) -> Iterator[list[OctreeNode]]:
    """So many nodes that threads have something to do each."""
    group: list[OctreeNode] = []
    for node in nodes:
        group.append(node)
        if len(group) == _CHUNKS_AT_ONCE:
            yield group
            group = []
    if group:
        yield group


def _entries(
    file: BinaryIO, vlr: lazrs.LazVlr, start: int, keys: list[NodeKey], counts: list[int]
) -> Any:
    """The hierarchy by level and place: where the table of chunks says that nodes are."""
    file.seek(start)
    sizes = np.array([size for _, size in lazrs.read_chunk_table(file, vlr)], np.int64)
    entries = np.zeros(len(keys), _ENTRY)
    entries["key"] = [(key.level, key.x, key.y, key.z) for key in keys]
    entries["points"] = counts
    filled = entries["points"] > 0
    entries["bytes"][filled] = sizes
    # The eight bytes before the first chunk tell where the table is.
    entries["at"][filled] = start + 8 + np.cumsum(sizes) - sizes
    return entries[sorted(range(len(keys)), key=keys.__getitem__)]
