"""Clouds for the Potree viewer: a folder of three files, for its loader of version 2.

Source: M. Schütz, S. Ohrhallinger, M. Wimmer, *Fast Out-of-Core Octree Generation for
Massive Point Clouds* (2020), and the layout that PotreeConverter 2 writes.
"""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.copc import told_of_tree
from workbench.formats.point_octree import (
    GRID_LEVEL,
    MEMORY_BYTES,
    Key,
    PointOctree,
    build_octree,
)
from workbench.formats.point_rounding import Rounding, rounding_of
from workbench.formats.point_stream import PointStream
from workbench.geometry.point_set import PointSet

_FILES = ("metadata.json", "hierarchy.bin", "octree.bin")
_NORMALS = ("NormalX", "NormalY", "NormalZ")
_ENTRY = struct.Struct("<BBIQQ")
_LEAF = 1
_STEP_LEVELS = 4
_TYPES = {"i4": "int32", "u2": "uint16", "f4": "float"}


def write_potree(
    path: Path,
    stream: PointStream,
    *,
    precision: float | None = None,
    memory_bytes: int = MEMORY_BYTES,
) -> dict[str, Any]:
    """Write the folder of a Potree 2 cloud; same points, same bytes.

    ``octree.bin`` holds the points node by node, uncompressed (encoding ``DEFAULT``), each
    ``position`` (int32, coordinate = offset + scale · integer), then as far as the stream
    has them ``rgb`` (uint16, 257 times the byte), ``NormalX NormalY NormalZ`` and ``radius``
    (float). ``hierarchy.bin`` holds 22 bytes per node, breadth first, in one piece: type (1:
    leaf), mask of children, points, byte offset and size in ``octree.bin``.
    ``metadata.json`` names all of it. Nodes and levels are those of `build_octree`.

    Parameters
    ----------
    path
        The folder. One that is there is replaced if it holds such a cloud and nothing else.
    stream
        The points.
    precision
        Step of coordinates, by default that of `rounding_of`.
    memory_bytes
        Bound of the working memory.

    Returns
    -------
    ``bytes`` of the three files, ``precision``, ``rounding_error``, ``levels``, ``nodes`` and
    ``points_per_level``.

    Raises
    ------
    InputError
        Something else is at ``path``.
    SettingsError
        The precision does not fit the size of the cloud, or there is too little memory.
    """
    path = Path(path)
    _check_replaceable(path)
    rounding = rounding_of(stream.low, stream.high, precision)
    records = _Records(stream.attributes, rounding)
    partial = path.with_name(f".{path.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        with open(partial / "octree.bin", "wb") as file:
            sink = _Nodes(file, records.dtype)
            tree = build_octree(
                stream, rounding, records.rows, sink, partial, memory_bytes=memory_bytes
            )
        hierarchy = _hierarchy(tree, sink.starts, records.dtype.itemsize)
        (partial / "hierarchy.bin").write_bytes(hierarchy)
        metadata = _metadata(path.name, stream, tree, rounding, sink, len(hierarchy))
        (partial / "metadata.json").write_text(json.dumps(metadata, indent=1) + "\n")
        if path.exists():
            shutil.rmtree(path)
        partial.rename(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {
        "bytes": sum((path / name).stat().st_size for name in _FILES),
        "precision": rounding.step,
        "rounding_error": rounding.step / 2,
        **told_of_tree(tree),
    }


def _check_replaceable(path: Path) -> None:
    if path.is_dir():
        others = sorted({entry.name for entry in path.iterdir()} - set(_FILES))
        if others:
            raise InputError(
                "The folder for a Potree cloud holds other files.",
                file=path,
                found=", ".join(others[:5]),
                fix="Name a folder that is not there yet.",
            )
    elif path.exists():
        raise InputError(
            "A Potree cloud is a folder; there is a file of this name.",
            file=path,
            fix="Name a folder that is not there yet.",
        )


class _Records:
    """Points as rows of ``octree.bin``."""

    def __init__(self, attributes: frozenset[str], rounding: Rounding) -> None:
        self._rounding = rounding
        fields: list[tuple[Any, ...]] = [("whole", "<i4", (3,))]
        if "color" in attributes:
            fields.append(("rgb", "<u2", (3,)))
        if "normals" in attributes:
            fields += [(name, "<f4") for name in _NORMALS]
        if "radius" in attributes:
            fields.append(("radius", "<f4"))
        self.dtype = np.dtype(fields)

    def rows(self, points: PointSet) -> NDArray[np.void]:
        rows = np.zeros(len(points), self.dtype)
        names = self.dtype.names or ()
        rows["whole"] = self._rounding.whole(points.points)
        if "rgb" in names and points.color is not None:
            rows["rgb"] = points.color.astype(np.uint16) * 257
        if _NORMALS[0] in names and points.normals is not None:
            for axis, name in enumerate(_NORMALS):
                rows[name] = points.normals[:, axis]
        if "radius" in names and points.radius is not None:
            rows["radius"] = points.radius
        return rows


class _Nodes:
    """Nodes one behind the other in a file, and the least and largest of all their numbers."""

    def __init__(self, file: BinaryIO, dtype: np.dtype[Any]) -> None:
        self.starts: dict[Key, int] = {}
        self.dtype = dtype
        self.low: dict[str, NDArray[Any]] = {}
        self.high: dict[str, NDArray[Any]] = {}
        self._file = file

    def node(self, key: Key, rows: NDArray[np.void]) -> None:
        """Take a node."""
        self.starts[key] = self._file.tell()
        self._file.write(np.ascontiguousarray(rows).data)
        for name in self.dtype.names or ():
            low, high = rows[name].min(axis=0), rows[name].max(axis=0)
            self.low[name] = np.minimum(self.low.get(name, low), low)
            self.high[name] = np.maximum(self.high.get(name, high), high)


def _hierarchy(tree: PointOctree, starts: dict[Key, int], point_bytes: int) -> bytes:
    entries = []
    waiting: list[Key] = [(0, 0, 0, 0)]
    for key in waiting:
        mask = 0
        for half, child in tree.children(key):
            mask |= 1 << half
            waiting.append(child)
        count = tree.counts[key]
        kind = 0 if mask else _LEAF
        entries.append(_ENTRY.pack(kind, mask, count, starts.get(key, 0), count * point_bytes))
    return b"".join(entries)


def _metadata(
    name: str,
    stream: PointStream,
    tree: PointOctree,
    rounding: Rounding,
    nodes: _Nodes,
    hierarchy_bytes: int,
) -> dict[str, Any]:
    side = tree.side * rounding.step
    low = tree.corner * rounding.step + rounding.origin
    return {
        "version": "2.0",
        "name": name,
        "description": "",
        "points": stream.count,
        "projection": "",
        "hierarchy": {
            "firstChunkSize": hierarchy_bytes,
            "stepSize": _STEP_LEVELS,
            "depth": tree.levels - 1,
        },
        "offset": rounding.origin.tolist(),
        "scale": [rounding.step] * 3,
        "spacing": side / 2**GRID_LEVEL,
        "boundingBox": {"min": low.tolist(), "max": (low + side).tolist()},
        "encoding": "DEFAULT",
        "attributes": [_attribute(field, nodes, rounding) for field in nodes.dtype.names or ()],
    }


def _attribute(field: str, nodes: _Nodes, rounding: Rounding) -> dict[str, Any]:
    dtype, *_ = (nodes.dtype.fields or {})[field]
    low, high = nodes.low[field], nodes.high[field]
    if field == "whole":
        low, high = rounding.coordinates(low), rounding.coordinates(high)
    elements = dtype.shape[0] if dtype.shape else 1
    return {
        "name": "position" if field == "whole" else field,
        "description": "",
        "size": dtype.itemsize,
        "numElements": elements,
        "elementSize": dtype.base.itemsize,
        "type": _TYPES[dtype.base.str[1:]],
        "min": np.atleast_1d(low).tolist(),
        "max": np.atleast_1d(high).tolist(),
    }
