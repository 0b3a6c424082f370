"""Folders that Potree 2 shows: ``metadata.json``, ``hierarchy.bin`` and ``octree.bin``.

Source: M. Schütz, S. Ohrhallinger and M. Wimmer, *Fast Out-of-Core Octree Generation for
Massive Point Clouds* (2020), for the idea; the layout is that which PotreeConverter 2 writes
and Potree 1.8 reads, encoding ``DEFAULT``.
"""

from __future__ import annotations

import json
import shutil
import struct
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.octree_nodes import CELLS, NodeKey, OctreeNode, PointOctree

METADATA = "metadata.json"
HIERARCHY = "hierarchy.bin"
OCTREE = "octree.bin"
_VERSION = "2.0"
_NORMAL, _LEAF = 0, 1
_STEP = 4

_ATTRIBUTES: dict[str, tuple[tuple[str, str, str, int], ...]] = {
    "color": (("rgb", "uint16", "<u2", 3),),
    "normals": tuple((f"Normal{axis}", "float", "<f4", 1) for axis in "XYZ"),
    "radius": (("radius", "float", "<f4", 1),),
}


def write_potree(path: Path, octree: PointOctree, name: str | None = None) -> dict[str, Any]:
    """Write an octree as a Potree 2 folder; same nodes, same bytes.

    Every point is a record: ``position`` (3 int32, by the octree's rounding), then as far as
    points have them ``rgb`` (3 uint16, 257 times the byte), ``NormalX NormalY NormalZ`` and
    ``radius`` (float32 each). Nodes stand in ``octree.bin`` in the order they come. The
    hierarchy is one chunk: 22 bytes per node breadth first (kind, mask of children, points,
    byte where it starts, bytes).

    Parameters
    ----------
    path
        The folder. An older one of Potree 2 is replaced once all is written.
    octree
        Its nodes are asked for once.
    name
        Of the cloud, by default the folder's.

    Returns
    -------
    ``bytes`` of all files, ``precision``, ``rounding_error`` (half of it), ``nodes`` and
    ``levels``.

    Raises
    ------
    InputError
        Something else is at ``path``.
    """
    path = Path(path)
    record = _Record(octree)
    places: dict[NodeKey, tuple[int, int, int]] = {}
    with _replacing_folder(path) as folder:
        with open(folder / OCTREE, "wb") as file:
            for node in octree.nodes():
                start, data = file.tell(), record.rows(node)
                places[node.key] = (len(node.points), start, file.write(data))
        told = sum(points for points, _, _ in places.values())
        if told != octree.count:
            raise InputError(
                "The points changed while they were read.",
                file=path,
                expected=f"{octree.count} points",
                found=f"{told} points",
                fix="Leave the file alone until the export is done.",
            )
        hierarchy = _hierarchy(places)
        (folder / HIERARCHY).write_bytes(hierarchy)
        levels = max(key.level for key in places) + 1
        metadata = _metadata(octree, record, name or path.name, len(hierarchy), levels)
        (folder / METADATA).write_text(json.dumps(metadata, indent=1) + "\n", encoding="utf-8")
    return {
        "bytes": sum((path / part).stat().st_size for part in (METADATA, HIERARCHY, OCTREE)),
        "precision": octree.rounding.step,
        "rounding_error": octree.rounding.step / 2,
        "nodes": len(places),
        "levels": levels,
    }


class _Record:
    """Points as records, and the range of each attribute."""

    def __init__(self, octree: PointOctree) -> None:
        self.octree = octree
        self.columns = [("position", "int32", "<i4", 3)]
        for name, columns in _ATTRIBUTES.items():
            if name in octree.attributes:
                self.columns += columns
        self.dtype = np.dtype([(name, code, (number,)) for name, _, code, number in self.columns])
        self._low = {name: np.full(number, np.inf) for name, _, _, number in self.columns}
        self._high = {name: np.full(number, -np.inf) for name, _, _, number in self.columns}

    def rows(self, node: OctreeNode) -> bytes:
        """The bytes of a node."""
        rows = np.empty(len(node.points), self.dtype)
        rows["position"] = node.whole
        if "rgb" in self._low and node.points.color is not None:
            rows["rgb"] = node.points.color.astype(np.uint16) * 257
        if "NormalX" in self._low and node.points.normals is not None:
            for axis, letter in enumerate("XYZ"):
                rows[f"Normal{letter}"][:, 0] = node.points.normals[:, axis]
        if "radius" in self._low and node.points.radius is not None:
            rows["radius"][:, 0] = node.points.radius
        if len(rows):
            for name, low in self._low.items():
                np.fmin(low, rows[name].min(axis=0), out=low)
                np.fmax(self._high[name], rows[name].max(axis=0), out=self._high[name])
        return rows.tobytes()

    def limits(self, name: str) -> tuple[list[float], list[float]]:
        """Least and greatest values of an attribute; of positions as coordinates."""
        low, high = self._low[name], self._high[name]
        if name == "position":
            whole = np.stack([low, high]).astype(np.int32)
            low, high = self.octree.rounding.coordinates(whole)
        return _numbers(low), _numbers(high)


def _numbers(values: NDArray[np.float64]) -> list[float]:
    """As JSON can hold them."""
    return [float(value) for value in np.nan_to_num(values)]


def _hierarchy(places: dict[NodeKey, tuple[int, int, int]]) -> bytes:
    data = bytearray()
    waiting = deque([NodeKey(0, 0, 0, 0)])
    while waiting:
        key = waiting.popleft()
        mask = 0
        for child in range(8):
            # In this layout x is the highest bit of a child's number.
            x, y, z = child >> 2, child >> 1 & 1, child & 1
            below = NodeKey(key.level + 1, 2 * key.x + x, 2 * key.y + y, 2 * key.z + z)
            if below in places:
                mask |= 1 << child
                waiting.append(below)
        data += struct.pack("<BBIQQ", _NORMAL if mask else _LEAF, mask, *places[key])
    return bytes(data)


def _metadata(
    octree: PointOctree, record: _Record, name: str, first_chunk: int, levels: int
) -> dict[str, Any]:
    rounding = octree.rounding
    low, side = octree.cube.placed(rounding)
    attributes = []
    for column, kind, code, number in record.columns:
        size = np.dtype(code).itemsize
        least, greatest = record.limits(column)
        attributes.append(
            {"name": column, "description": "", "size": size * number, "numElements": number,
             "elementSize": size, "type": kind, "min": least, "max": greatest,
             "scale": [1.0] * number, "offset": [0.0] * number}
        )  # fmt: skip
    return {
        "version": _VERSION,
        "name": name,
        "description": "",
        "points": octree.count,
        "projection": "",
        "hierarchy": {"firstChunkSize": first_chunk, "stepSize": _STEP, "depth": levels - 1},
        "offset": _numbers(rounding.origin),
        "scale": [rounding.step] * 3,
        "spacing": side / CELLS,
        "boundingBox": {"min": _numbers(low), "max": _numbers(low + side)},
        "encoding": "DEFAULT",
        "attributes": attributes,
    }


@contextmanager
def _replacing_folder(path: Path) -> Iterator[Path]:
    """A folder beside its place, moved there when it is complete."""
    if path.exists() and not (path.is_dir() and _is_potree(path)):
        raise InputError(
            "Something else than a Potree folder is in its place.",
            file=path,
            fix="Choose another folder, or remove this one.",
        )
    partial = path.with_name(f".{path.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        if path.exists():
            shutil.rmtree(path)
        partial.rename(path)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def _is_potree(path: Path) -> bool:
    names = {part.name for part in path.iterdir()}
    return not names or (METADATA in names and names <= {METADATA, HIERARCHY, OCTREE})
