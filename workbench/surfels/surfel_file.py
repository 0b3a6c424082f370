"""Progressive surfels in one file, whose every node is read in part or whole.

Everything is little-endian. A reader asks for the header, then for the index, then for as much
of the nodes as it needs, each with one HTTP range request.

=======  ================================================================================
header   40 bytes: ``WBSURFEL``, version, flags (1 colour, 2 float32 positions), offset of the
         index, numbers of nodes and of levels, CRC-32 of the index and of the header before it
nodes    in any order, the surfels of each in theirs: a prefix of the bytes is a prefix of the
         surfels
index    the last bytes of the file, 112 per node, level by level, so that the first node is
         the root
=======  ================================================================================

A node of the index has, in this order: level (uint8, 0 is the root), number of children
(uint8), two bytes of 0, row of the first child, the others following it (uint32), number of
surfels (uint32), p_m (uint32) and r_m (float64), radius (float64), lower corner (3 float64) and
sides (3 float64) of the box of its surfels in the unit of the source, offset and number of its
bytes (2 uint64), how many triangles or points it stands for (uint64), CRC-32 of its bytes
(uint32) and four bytes of 0.

To draw discs of radius r, take p = p_m (r_m / r)² surfels of a node, and its children instead
where it has less than that. ``radius`` is that of discs that cover the object with all of them.

A surfel takes 8 bytes, or 12 with colour; with float32 positions 16, or 20 with colour:

==========  =============================================================================
position    x, y, z: uint16 in 65535ths of the sides of the node's box, or float32 from its
            lower corner
normal      2 signed integers, int8 or int16 beside float32: u and v times 127 or 32767.
            With w = 1 − abs(u) − abs(v) the normal goes along (u, v, w); where w is negative,
            along ((1 − abs(v)) sign u, (1 − abs(u)) sign v, w)
colour      red, green, blue (sRGB), 0
==========  =============================================================================

After the surfels of a node with colour come lists of colours for short prefixes, red, green and
blue each: for the first quarter of the surfels (rounded up), for the first quarter of these, and
so on until no more than 64. They are means over the larger part of the surface that a surfel
then stands for; a reader may pass them over.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError
from workbench.geometry.point_set import PointSet, joined
from workbench.surfels.spacing import Spacing
from workbench.surfels.surfel_bytes import packed_surfels, unpacked_surfels
from workbench.surfels.surfel_layout import (
    COLORED,
    EXACT,
    HEADER,
    NODE,
    SurfelLayout,
    coarse_counts,
    header_bytes,
    node_bytes,
    read_layout,
    refused,
)

SURFEL_SUFFIX = ".surfels"


@dataclass(frozen=True)
class SurfelNode:
    """The surfels of one object, or of one part of it.

    Attributes
    ----------
    surfels : in their order, with normals.
    coarse_colors : (k, 3) uint8 sRGB each, of the counts of ``coarse_counts``; empty where the
        surfels have no colours.
    spacing : for the choice of a prefix.
    radius : of discs that cover the object with all surfels, in its unit.
    items : triangles or points they stand for.
    """

    surfels: PointSet
    coarse_colors: Sequence[NDArray[np.uint8]]
    spacing: Spacing
    radius: float
    items: int

    def prefix(self, count: int) -> PointSet:
        """The first surfels with the colours of so short a prefix and the radius that covers."""
        chosen = self.surfels.chosen(slice(0, count))
        color = chosen.color
        for coarse in self.coarse_colors:
            if len(coarse) >= len(chosen):
                color = coarse[: len(chosen)]
        radius = max(self.spacing.radius_for(len(chosen)), self.radius)
        return PointSet(
            chosen.points, chosen.normals, color, np.full(len(chosen), radius, np.float32)
        )


class SurfelWriter:
    """Writes nodes to an open file as they come, then the index and the header.

    Parameters
    ----------
    file : empty, to be written.
    colored, exact : what all nodes have: colours, float32 positions.
    """

    def __init__(self, file: BinaryIO, *, colored: bool, exact: bool) -> None:
        self._file = file
        self.flags = (COLORED if colored else 0) | (EXACT if exact else 0)
        file.write(bytes(HEADER.itemsize))

    def add(self, node: SurfelNode) -> NDArray[np.void]:
        """Write a node; its record () of dtype ``NODE``, still without level and children."""
        bounds = node.surfels.bounds
        record = np.zeros((), NODE)
        record["lower"], record["size"] = bounds[0], bounds[1] - bounds[0]
        record["surfels"], record["items"] = len(node.surfels), node.items
        record["spacing_prefix"] = node.spacing.prefix
        record["spacing_distance"], record["radius"] = node.spacing.distance, node.radius
        packed = packed_surfels(
            node.surfels, record["lower"], record["size"], bool(self.flags & EXACT)
        )
        body = b"".join([packed.tobytes(), *(coarse.tobytes() for coarse in node.coarse_colors)])
        if len(body) != node_bytes(len(node.surfels), self.flags):
            raise ValueError("a node does not have the colours that the file has")
        record["offset"], record["bytes"] = self._file.tell(), len(body)
        record["crc"] = zlib.crc32(body)
        self._file.write(body)
        return record

    def flush(self) -> None:
        """What was added can be read by `read_node` from now on."""
        self._file.flush()

    def close(self, nodes: NDArray[np.void]) -> None:
        """Write the index, level by level from the root, and the header."""
        index_offset = self._file.tell()
        self._file.write(nodes.tobytes())
        self._file.seek(0)
        self._file.write(header_bytes(SurfelLayout(self.flags, nodes), index_offset))


def read_node(path: Path, layout: SurfelLayout, record: Any) -> SurfelNode:
    """The node of a checked record.

    Raises
    ------
    InputError
        Its bytes are not those that were written.
    """
    try:
        with open(path, "rb") as file:
            file.seek(int(record["offset"]))
            body = file.read(int(record["bytes"]))
    except OSError as error:
        raise refused(path, "The file cannot be read.", str(error)) from error
    if len(body) != int(record["bytes"]) or zlib.crc32(body) != int(record["crc"]):
        raise refused(path, "A node of the file is damaged.", "a wrong checksum")
    count = int(record["surfels"])
    records = np.frombuffer(body, layout.record, count)
    coarse, place = [], records.nbytes
    if layout.flags & COLORED:
        for length in coarse_counts(count):
            part = np.frombuffer(body, np.uint8, 3 * length, place)
            coarse.append(part.reshape(-1, 3).copy())
            place += 3 * length
    return SurfelNode(
        unpacked_surfels(records, record["lower"], record["size"]),
        coarse,
        Spacing(int(record["spacing_prefix"]), float(record["spacing_distance"])),
        float(record["radius"]),
        int(record["items"]),
    )


class SurfelFile:
    """A surfel file, read node by node.

    Attributes
    ----------
    path : the file.
    layout : its checked index.

    Raises
    ------
    InputError
        Not such a file, or a damaged one; also from the methods, for the part they read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.layout = read_layout(self.path)

    @property
    def nodes(self) -> NDArray[np.void]:
        """(n,) of dtype ``NODE``, level by level from the root."""
        return self.layout.nodes

    @property
    def colored(self) -> bool:
        return bool(self.layout.flags & COLORED)

    def node(self, row: int) -> SurfelNode:
        """A node by its row in the index; 0 is the root."""
        return read_node(self.path, self.layout, self.nodes[row])

    def bounds(self, row: int) -> NDArray[np.float64]:
        """(2, 3) lower and upper corner of the surfels of a node."""
        record = self.nodes[row]
        return np.stack([record["lower"], record["lower"] + record["size"]])

    def spacing(self, row: int) -> Spacing:
        """For the choice of a prefix of a node."""
        record = self.nodes[row]
        return Spacing(int(record["spacing_prefix"]), float(record["spacing_distance"]))

    def children(self, row: int) -> range:
        """Rows of the children of a node."""
        first = int(self.nodes[row]["first_child"])
        return range(first, first + int(self.nodes[row]["children"]))


def surfel_points(path: Path, prefix: int | None = None) -> PointSet:
    """The surfels of a file as points with normals, colours and radii.

    Parameters
    ----------
    path
        A ``.surfels`` file.
    prefix
        The first so many of the root, which stand for the whole object; without, all of the
        finest nodes.

    Raises
    ------
    InputError
        The file cannot be used.
    SettingsError
        The root has no such prefix.
    """
    file = SurfelFile(path)
    if prefix is not None:
        most = int(file.nodes["surfels"][0])
        if not 1 <= prefix <= most:
            raise SettingsError(
                "The file has no such prefix.",
                file=path,
                expected=f"1 to {most}",
                found=str(prefix),
                fix="Take fewer, or leave the prefix out for all surfels of the finest nodes.",
            )
        return file.node(0).prefix(prefix)
    finest = [file.node(int(row)) for row in np.flatnonzero(file.nodes["children"] == 0)]
    return joined([node.prefix(len(node.surfels)) for node in finest])
