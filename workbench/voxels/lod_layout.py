"""The header and the index of a voxel level-of-detail file; `lod_file` tells what they mean."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.voxels.voxel_set import VoxelGrid

MAGIC, VERSION = b"WBVOXLOD", 1
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
    header = np.zeros((), HEADER)
    header["magic"], header["version"], header["flags"] = MAGIC, VERSION, layout.flags
    header["level"], header["chunk_level"] = layout.grid.level, layout.chunk_level
    header["origin"], header["size"] = layout.grid.origin, layout.grid.size
    header["index_offset"], header["nodes"] = index_offset, len(layout.nodes)
    header["index_crc"] = zlib.crc32(layout.nodes.tobytes())
    header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
    return header.tobytes()


def read_layout(path: Path) -> LodLayout:
    """The checked header and index of a file.

    Raises
    ------
    InputError
        Not such a file, of another version, shorter than it says, or damaged.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            start = file.read(HEADER.itemsize)
            if len(start) < HEADER.itemsize or start[: len(MAGIC)] != MAGIC:
                raise refused(path, "The file holds no voxel levels of detail.", "another header")
            header = np.frombuffer(start, HEADER)[0]
            _check_header(path, start, header)
            end = file.seek(0, 2)
            index_end = int(header["index_offset"]) + int(header["nodes"]) * NODE.itemsize
            if index_end != end:
                raise refused(path, "The file is cut short.", f"{end} bytes of {index_end}")
            file.seek(int(header["index_offset"]))
            index = file.read()
    except OSError as error:
        raise refused(path, "The file cannot be read.", str(error)) from error
    if zlib.crc32(index) != int(header["index_crc"]):
        raise refused(path, "The index of the file is damaged.", "a wrong checksum")
    grid = VoxelGrid(
        header["origin"].astype(np.float64), float(header["size"]), int(header["level"])
    )
    layout = LodLayout(
        grid, int(header["chunk_level"]), int(header["flags"]), np.frombuffer(index, NODE)
    )
    _check_nodes(path, layout, int(header["index_offset"]))
    return layout


def _check_header(path: Path, start: bytes, header: Any) -> None:
    if zlib.crc32(start[:-4]) != int(header["header_crc"]):
        raise refused(path, "The header of the file is damaged.", "a wrong checksum")
    if int(header["version"]) != VERSION:
        raise InputError(
            "The file is of another version.",
            file=path,
            expected=str(VERSION),
            found=str(int(header["version"])),
            fix="Export it again with this program, or read it with the one that wrote it.",
        )
    level, chunk = int(header["level"]), int(header["chunk_level"])
    sound = 1 <= chunk <= LARGEST_CHUNK and 1 <= level <= FINEST
    if not sound or not float(header["size"]) > 0 or not np.isfinite(header["origin"]).all():
        raise refused(path, "The header of the file makes no sense.", f"level {level}, {chunk}")


def _check_nodes(path: Path, layout: LodLayout, end: int) -> None:
    """Every range lies inside the file and every child where its parent says."""
    nodes = layout.nodes
    for name in ("offset", "geometry_offset"):
        stored = nodes["stored" if name == "offset" else "geometry_stored"]
        if len(nodes) and ((nodes[name] > end).any() or (stored > end - nodes[name]).any()):
            raise refused(path, "The index points outside the file.", name)
    counts = np.bitwise_count(nodes["children"]).astype(np.int64)
    parents = np.flatnonzero(counts)
    last = nodes["first_child"][parents].astype(np.int64) + counts[parents]
    if (nodes["first_child"][parents] <= parents).any() or (last > len(nodes)).any():
        raise refused(path, "The index names children that are not there.", "a wrong link")


def refused(path: Path, message: str, found: str) -> InputError:
    """The error of a file that cannot be used."""
    return InputError(
        message,
        file=path,
        expected="a voxel level-of-detail file of the workbench",
        found=found,
        fix="Copy the file again, or export it anew.",
    )
