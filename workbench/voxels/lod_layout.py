"""The header and the index of a voxel level-of-detail file; `lod_file` tells what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.indexed_file import IndexedFormat
from workbench.voxels.voxel_set import VoxelGrid

COLORED, COMPRESSED, GEOMETRY, THIN = 1, 2, 4, 8
FINEST, LARGEST_CHUNK = 14, 8

HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u4"),
        ("flags", "<u4"),
        ("level", "<u4"),
        ("chunk_level", "<u4"),
        ("origin", "<f8", (3,)),
        ("size", "<f8"),
        ("index_offset", "<u8"),
        ("nodes", "<u8"),
        ("index_crc", "<u4"),
        ("header_crc", "<u4"),
    ]
)
NODE = np.dtype(
    [
        ("level", "u1"),
        ("children", "u1"),
        ("low", "u1", (3,)),
        ("high", "u1", (3,)),
        ("place", "<u2", (3,)),
        ("reserved", "<u2"),
        ("first_child", "<u4"),
        ("voxels", "<u4"),
        ("sided", "<u4"),
        ("crc", "<u4"),
        ("offset", "<u8"),
        ("stored", "<u8"),
        ("plain", "<u8"),
        ("geometry_offset", "<u8"),
        ("geometry_stored", "<u8"),
        ("geometry_plain", "<u8"),
        ("geometry_crc", "<u4"),
        ("vertices", "<u4"),
        ("triangles", "<u4"),
        ("reserved_2", "<u4"),
    ]
)
FORMAT = IndexedFormat(
    HEADER,
    b"WBVOXLOD",
    1,
    "a voxel level-of-detail file of the workbench",
    "The file holds no voxel levels of detail.",
)
refused = FORMAT.refused


@dataclass(frozen=True)
class LodLayout:
    """What the header and the index of a file say.

    Attributes
    ----------
    grid : the cube of the finest level.
    chunk_level : chunks are cubes of 2**chunk_level voxels a side.
    flags : ``COLORED``, ``COMPRESSED``, ``GEOMETRY``, ``THIN``, added up.
    nodes : (n,) of dtype ``NODE``, level by level from the root.
    """

    grid: VoxelGrid
    chunk_level: int
    flags: int
    nodes: NDArray[np.void]


def header_bytes(layout: LodLayout, index_offset: int) -> bytes:
    """The header of a file whose index starts at ``index_offset``."""
    fields = {
        "flags": layout.flags,
        "level": layout.grid.level,
        "chunk_level": layout.chunk_level,
        "origin": layout.grid.origin,
        "size": layout.grid.size,
        "index_offset": index_offset,
        "nodes": len(layout.nodes),
    }
    return FORMAT.sealed(fields, layout.nodes.tobytes())


def read_layout(path: Path) -> LodLayout:
    """The checked header and index of a file.

    Raises
    ------
    InputError
        Not such a file, of another version, shorter than it says, or damaged.
    """
    path = Path(path)
    header, index = FORMAT.opened(path, _check_header, _check_end)
    grid = VoxelGrid(
        header["origin"].astype(np.float64), float(header["size"]), int(header["level"])
    )
    layout = LodLayout(
        grid, int(header["chunk_level"]), int(header["flags"]), np.frombuffer(index, NODE)
    )
    _check_nodes(path, layout, int(header["index_offset"]))
    return layout


def _check_header(path: Path, header: Any) -> None:
    level, chunk = int(header["level"]), int(header["chunk_level"])
    sound = 1 <= chunk <= LARGEST_CHUNK and 1 <= level <= FINEST
    if not sound or not float(header["size"]) > 0 or not np.isfinite(header["origin"]).all():
        raise refused(path, "The header of the file makes no sense.", f"level {level}, {chunk}")


def _check_end(path: Path, header: Any, end: int) -> None:
    FORMAT.check_nodes_end(path, header, end, NODE.itemsize)


def _check_nodes(path: Path, layout: LodLayout, end: int) -> None:
    """Every range lies inside the file and every child where its parent says."""
    nodes = layout.nodes
    for name in ("offset", "geometry_offset"):
        stored = nodes["stored" if name == "offset" else "geometry_stored"]
        if len(nodes) and ((nodes[name] > end).any() or (stored > end - nodes[name]).any()):
            raise refused(path, "The index points outside the file.", name)
    if not (nodes["level"] == layout.grid.level).any():
        raise refused(path, "The file has no voxels of its finest level.", f"{len(nodes)} chunks")
    depth = nodes["level"].astype(np.int64) - layout.chunk_level
    if (nodes["level"] > layout.grid.level).any() or (
        nodes["place"] >> np.maximum(depth, 0)[:, None]
    ).any():
        raise refused(path, "A chunk lies outside the grid.", "a level or place too large")
    counts = np.bitwise_count(nodes["children"]).astype(np.int64)
    FORMAT.check_children(path, nodes["first_child"], counts)
