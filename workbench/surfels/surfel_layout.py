"""The header and the index of a surfel file; `surfel_file` tells what they mean."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.surfels.surfel_bytes import surfel_record

MAGIC, VERSION = b"WBSURFEL", 1
COLORED, EXACT = 1, 2
# Each coarser list of colours has a quarter of the surfels, down to this many.
FEWEST_COARSE = 64

HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u4"),
        ("flags", "<u4"),
        ("index_offset", "<u8"),
        ("nodes", "<u4"),
        ("levels", "<u4"),
        ("index_crc", "<u4"),
        ("header_crc", "<u4"),
    ]
)
NODE = np.dtype(
    [
        ("level", "u1"),
        ("children", "u1"),
        ("reserved", "<u2"),
        ("first_child", "<u4"),
        ("surfels", "<u4"),
        ("spacing_prefix", "<u4"),
        ("spacing_distance", "<f8"),
        ("radius", "<f8"),
        ("lower", "<f8", (3,)),
        ("size", "<f8", (3,)),
        ("offset", "<u8"),
        ("bytes", "<u8"),
        ("items", "<u8"),
        ("crc", "<u4"),
        ("reserved_2", "<u4"),
    ]
)


@dataclass(frozen=True)
class SurfelLayout:
    """What the header and the index of a file say.

    Attributes
    ----------
    flags : ``COLORED`` and ``EXACT``, added up.
    nodes : (n,) of dtype ``NODE``, level by level from the root.
    """

    flags: int
    nodes: NDArray[np.void]

    @property
    def record(self) -> np.dtype[np.void]:
        """One surfel."""
        return surfel_record(bool(self.flags & EXACT), bool(self.flags & COLORED))


def coarse_counts(surfels: int) -> list[int]:
    """Lengths of the lists of coarser colours of a node: a quarter each of the one before.

    >>> coarse_counts(1000)
    [250, 63]
    """
    counts = []
    while surfels > FEWEST_COARSE:
        surfels = -(-surfels // 4)
        counts.append(surfels)
    return counts


def node_bytes(surfels: int, flags: int) -> int:
    """Bytes of a node in the file."""
    colored = bool(flags & COLORED)
    plain = surfels * surfel_record(bool(flags & EXACT), colored).itemsize
    return plain + (3 * sum(coarse_counts(surfels)) if colored else 0)


def header_bytes(layout: SurfelLayout, index_offset: int) -> bytes:
    """The header of a file whose index starts at ``index_offset``."""
    header = np.zeros((), HEADER)
    header["magic"], header["version"], header["flags"] = MAGIC, VERSION, layout.flags
    header["index_offset"], header["nodes"] = index_offset, len(layout.nodes)
    header["levels"] = int(layout.nodes["level"].max()) + 1
    header["index_crc"] = zlib.crc32(layout.nodes.tobytes())
    header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
    return header.tobytes()


def read_layout(path: Path) -> SurfelLayout:
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
                raise refused(path, "The file holds no surfels.", "another header")
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
    layout = SurfelLayout(int(header["flags"]), np.frombuffer(index, NODE))
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
    if not int(header["nodes"]) or int(header["flags"]) & ~(COLORED | EXACT):
        raise refused(path, "The header of the file makes no sense.", f"{int(header['nodes'])}")


def _check_nodes(path: Path, layout: SurfelLayout, end: int) -> None:
    """Every range lies inside the file, every child where its parent says, every number is one."""
    nodes = layout.nodes
    numbers = np.column_stack(
        [nodes["lower"], nodes["size"], nodes["spacing_distance"], nodes["radius"]]
    )
    if not np.isfinite(numbers).all() or (numbers[:, 3:] < 0.0).any():
        raise refused(path, "The index has numbers that make no sense.", "bounds or distances")
    for node in nodes:
        size, offset = int(node["bytes"]), int(node["offset"])
        if not HEADER.itemsize <= offset <= end or size > end - offset:
            raise refused(path, "The index points outside the file.", f"{offset} + {size}")
        surfels = int(node["surfels"])
        # A count that is out of bounds would make long lists of counts of its own.
        if not 0 < surfels <= size or size != node_bytes(surfels, layout.flags):
            raise refused(path, "The index contradicts itself.", f"{surfels} surfels, {size} bytes")
        if not 0 < int(node["spacing_prefix"]) <= surfels:
            raise refused(path, "The index contradicts itself.", "a prefix beyond the surfels")
    parents = np.flatnonzero(nodes["children"])
    last = nodes["first_child"][parents].astype(np.int64) + nodes["children"][parents]
    if (nodes["first_child"][parents] <= parents).any() or (last > len(nodes)).any():
        raise refused(path, "The index names children that are not there.", "a wrong link")


def refused(path: Path, message: str, found: str) -> InputError:
    """The error of a file that cannot be used."""
    return InputError(
        message,
        file=path,
        expected="a surfel file of the workbench",
        found=found,
        fix="Copy the file again, or export it anew.",
    )
