"""Points of Potree 2 folders, node by node: ``metadata.json``, ``hierarchy.bin``, ``octree.bin``.

The layout is that of `workbench.formats.potree`; hierarchies of several chunks and compressed
points are refused.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.point_attributes import unit_normals
from workbench.formats.potree import HIERARCHY, METADATA, OCTREE
from workbench.formats.whole_file import require_regular
from workbench.geometry.point_set import PointSet

_ENTRY = struct.Struct("<BBIQQ")
_PROXY = 2
# Of what nobody writes more: deeper trees than that have cells below any coordinate's step.
_DEEPEST = 40
_KINDS = {
    "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4",
    "uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float": "<f4", "double": "<f8",
}  # fmt: skip


@dataclass(frozen=True)
class PotreeNode:
    """A cube of the octree with points of its own.

    Attributes
    ----------
    level : 0 of the root.
    octant : which of its parent's it is, x the highest bit; 0 of the root.
    lower : (3,) its corner in the cloud's coordinates.
    side : of the cube.
    points, offset, bytes : how many there are, and where in ``octree.bin``.
    children : rows of its children in the list of nodes.
    """

    level: int
    octant: int
    lower: NDArray[np.float64]
    side: float
    points: int
    offset: int
    bytes: int
    children: tuple[int, ...]


class PotreeCloud:
    """A folder that `workbench.formats.potree.write_potree` wrote, or one like it.

    Parameters
    ----------
    path : the folder, or the ``metadata.json`` inside.

    Attributes
    ----------
    nodes : the root first, level by level.
    spacing : of the root's points; halved from level to level.
    box : corners (3,), (3,) of the root.

    Raises
    ------
    InputError
        Not such a folder, or a damaged one; also from the methods, for what they read.
    """

    def __init__(self, path: Path) -> None:
        path = Path(path)
        self._told = path if path.name == METADATA else path / METADATA
        told = self._metadata()
        try:
            self._scale = np.array(told["scale"], np.float64).reshape(3)
            self._offset = np.array(told["offset"], np.float64).reshape(3)
            box = told["boundingBox"]
            low, high = (np.array(box[end], np.float64).reshape(3) for end in ("min", "max"))
            self.spacing = float(told["spacing"])
            first_chunk = int(told["hierarchy"]["firstChunkSize"])
            self._record = _record_of(told["attributes"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            self._refuse("It does not say what it must.", f"{type(error).__name__}: {error}")
        numbers = [*self._scale, *self._offset, *low, *high, self.spacing]
        if not np.isfinite(numbers).all() or (high <= low).any() or (self._scale <= 0).any():
            self._refuse("Its box, scale or spacing is no such thing.", str(numbers))
        self.box = (low, high)
        self.nodes = self._tree(first_chunk, low, float(high[0] - low[0]))

    @property
    def colored(self) -> bool:
        """Whether points have colours."""
        return "rgb" in (self._record.names or ())

    def read(self, node: PotreeNode) -> PointSet:
        """The points of a node, with those of colours, normals and radii that it has."""
        told = f"{node.points} points in {node.bytes} bytes"
        if node.bytes != node.points * self._record.itemsize:
            self._refuse("Its points are packed.", told)
        if node.offset + node.bytes > self._octree_bytes:
            self._refuse("Its points are cut short.", told)
        try:
            with open(self._told.with_name(OCTREE), "rb") as file:
                file.seek(node.offset)
                data = file.read(node.bytes)
        except OSError as error:
            self._refuse("Its points cannot be read.", str(error.strerror))
        if len(data) != node.bytes:
            self._refuse("Its points are cut short.", told)
        rows = np.frombuffer(data, self._record)
        names = self._record.names or ()
        color = normals = radius = None
        if "rgb" in names:
            color = (rows["rgb"].astype(np.uint16) >> 8).astype(np.uint8)
        if all(f"Normal{axis}" in names for axis in "XYZ"):
            columns = [rows[f"Normal{axis}"][:, 0] for axis in "XYZ"]
            normals = unit_normals(np.stack(columns, axis=1))
        if "radius" in names:
            radius = rows["radius"][:, 0].astype(np.float32)
        points = rows["position"] * self._scale + self._offset
        return PointSet(points, normals, color, radius)

    def batches(self) -> Iterator[PointSet]:
        """All points, node by node."""
        # Each node has its own bytes: all of them are no more than there are.
        if sum(node.bytes for node in self.nodes) > self._octree_bytes:
            self._refuse("Its points are cut short.", f"{self._octree_bytes} bytes")
        for node in self.nodes:
            if node.points:
                yield self.read(node)

    @cached_property
    def _octree_bytes(self) -> int:
        path = self._told.with_name(OCTREE)
        return path.stat().st_size if path.is_file() else 0

    def _metadata(self) -> dict[str, Any]:
        require_regular(self._told)
        try:
            told = json.loads(self._told.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(
                "There is no Potree cloud.", file=self._told, found=error.strerror,
                expected=f"a folder with {METADATA}, {HIERARCHY} and {OCTREE}",
                fix="Name such a folder, or export the cloud anew.",
            ) from error  # fmt: skip
        except (ValueError, RecursionError) as error:
            self._refuse("It is no JSON.", str(error)[:200])
        if not isinstance(told, dict) or not str(told.get("version", "")).startswith("2."):
            self._refuse("It is of another version.", str(told)[:100])
        if told.get("encoding") != "DEFAULT":
            self._refuse("Its points are compressed.", str(told.get("encoding"))[:100])
        return told

    def _tree(
        self, first_chunk: int, low: NDArray[np.float64], side: float
    ) -> tuple[PotreeNode, ...]:
        path = self._told.with_name(HIERARCHY)
        require_regular(path)
        try:
            data = path.read_bytes()
        except OSError as error:
            self._refuse("Its tree cannot be read.", str(error.strerror))
        if not 0 < first_chunk <= len(data):
            self._refuse("Its tree is cut short.", f"{len(data)} of {first_chunk} bytes")
        nodes: list[PotreeNode] = []
        waiting = [(0, 0, low, side)]
        for row, (level, octant, lower, wide) in enumerate(waiting):
            at = row * _ENTRY.size
            if at + _ENTRY.size > first_chunk or level > _DEEPEST:
                self._refuse("Its tree ends too early.", f"{first_chunk} bytes")
            kind, mask, points, offset, size = _ENTRY.unpack_from(data, at)
            if kind == _PROXY:
                self._refuse("Its tree is in several parts.", "a part apart")
            first = len(waiting)
            for child in range(8):
                if mask >> child & 1:
                    turn = np.array([child >> 2, child >> 1 & 1, child & 1])
                    waiting.append((level + 1, child, lower + 0.5 * wide * turn, 0.5 * wide))
            children = tuple(range(first, len(waiting)))
            nodes.append(PotreeNode(level, octant, lower, wide, points, offset, size, children))
        return tuple(nodes)

    def _refuse(self, message: str, found: str) -> NoReturn:
        raise InputError(
            f"The Potree cloud cannot be read. {message}",
            file=self._told,
            expected="version 2, encoding DEFAULT, a tree in one part",
            found=found,
            fix="Export it again.",
        )


def _record_of(attributes: Any) -> np.dtype[np.void]:
    """How a point is stored; ValueError where that is not told."""
    fields = []
    for attribute in attributes:
        kind = np.dtype(_KINDS[attribute["type"]])
        number = int(attribute["numElements"])
        if not 0 < number <= 64 or number * kind.itemsize != attribute["size"]:
            raise ValueError(f"{attribute['name']} has another size")
        fields.append((str(attribute["name"]), kind, (number,)))
    record = np.dtype(fields)
    if record["position"] != np.dtype(("<i4", (3,))):
        raise ValueError("there are no positions of 32 bits")
    if "rgb" in (record.names or ()) and record["rgb"] != np.dtype(("<u2", (3,))):
        raise ValueError("colours are not three numbers of 16 bits")
    return record
