"""The header and the index of a surfel file; `surfel_file` tells what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.indexed_file import IndexedFormat
from workbench.surfels.surfel_bytes import surfel_record

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
FORMAT = IndexedFormat(
    HEADER, b"WBSURFEL", 1, "a surfel file of the workbench", "The file holds no surfels."
)
refused = FORMAT.refused


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
    fields = {
        "flags": layout.flags,
        "index_offset": index_offset,
        "nodes": len(layout.nodes),
        "levels": int(layout.nodes["level"].max()) + 1,
    }
    return FORMAT.sealed(fields, layout.nodes.tobytes())


def read_layout(path: Path) -> SurfelLayout:
    """The checked header and index of a file.

    Raises
    ------
    InputError
        Not such a file, of another version, shorter than it says, or damaged.
    """
    path = Path(path)
    header, index = FORMAT.opened(path, _check_header, _check_end)
    layout = SurfelLayout(int(header["flags"]), np.frombuffer(index, NODE))
    _check_nodes(path, layout, int(header["index_offset"]))
    return layout


def _check_header(path: Path, header: Any) -> None:
    if not int(header["nodes"]) or int(header["flags"]) & ~(COLORED | EXACT):
        raise refused(path, "The header of the file makes no sense.", f"{int(header['nodes'])}")


def _check_end(path: Path, header: Any, end: int) -> None:
    FORMAT.check_nodes_end(path, header, end, NODE.itemsize)


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
    FORMAT.check_children(path, nodes["first_child"], nodes["children"])
