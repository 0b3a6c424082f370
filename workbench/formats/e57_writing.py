"""ASTM E57 clouds written from a stream of points.

Source: ASTM E2807-11, *Standard Specification for 3D Imaging Data Exchange*; normals by the
extension ``E57_EXT_surface_normals``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pye57 import libe57

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.point_stream import BATCH_POINTS, PointStream
from workbench.geometry.point_set import PointSet

_COORDINATES = ("cartesianX", "cartesianY", "cartesianZ")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
_NORMALS_URI = "http://www.libe57.org/E57_NOR_surface_normals.txt"
# Names that tell files apart are random as a rule; same points shall give same bytes.
_FILE_GUID = "{5ca0b0a1-0000-4000-8000-000000000001}"
_SCAN_GUID = "{5ca0b0a1-0000-4000-8000-000000000002}"


def write_e57_points(path: Path, stream: PointStream) -> dict[str, Any]:
    """Write a stream of points as an E57 file of one scan; same points, same bytes.

    Coordinates are double, in the file's frame; the scan has no pose, as a cloud has no one
    scanner. Colours are 8 bit, normals single. A radius has no place in the format.

    Parameters
    ----------
    path
        The file; it is whole or not there.
    stream
        The points.

    Returns
    -------
    ``bytes`` of the file, ``rounding_error``, which is zero, and ``left_out``: the
    attributes of the stream that the file cannot hold.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    path = Path(path)
    with replacing(path) as partial, _told(path):
        file = libe57.ImageFile(str(partial), "w")
        try:
            _write(file, stream)
        except BaseException:
            file.cancel()
            raise
        file.close()
    return {
        "bytes": path.stat().st_size,
        "rounding_error": 0.0,
        "left_out": sorted(stream.attributes & {"radius"}),
    }


@contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except libe57.E57Exception as error:
        raise InputError(
            "The E57 file cannot be written.",
            file=path,
            found=str(error).splitlines()[0],
            fix="Check that its folder is there and the disk has space.",
        ) from error


def _write(file: Any, stream: PointStream) -> None:
    _head(file)
    scan = libe57.StructureNode(file)
    scan.set("guid", libe57.StringNode(file, _SCAN_GUID))
    scan.set("name", libe57.StringNode(file, "cloud"))
    scan.set("cartesianBounds", _bounds(file, stream))
    prototype = libe57.StructureNode(file)
    fields = list(_COORDINATES)
    for name in _COORDINATES:
        prototype.set(name, libe57.FloatNode(file, 0.0, libe57.E57_DOUBLE))
    if "normals" in stream.attributes:
        file.extensionsAdd("nor", _NORMALS_URI)
        fields += _NORMALS
        for name in _NORMALS:
            prototype.set(name, libe57.FloatNode(file, 0.0, libe57.E57_SINGLE))
    if "color" in stream.attributes:
        fields += _COLORS
        limits = libe57.StructureNode(file)
        for name in _COLORS:
            prototype.set(name, libe57.IntegerNode(file, 0, 0, 255))
            limits.set(f"{name}Minimum", libe57.IntegerNode(file, 0))
            limits.set(f"{name}Maximum", libe57.IntegerNode(file, 255))
        scan.set("colorLimits", limits)
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scan.set("points", points)
    file.root()["data3D"].append(scan)
    columns = {name: np.empty(BATCH_POINTS, _type_of(name)) for name in fields}
    buffers = libe57.VectorSourceDestBuffer()
    for name, column in columns.items():
        buffers.append(libe57.SourceDestBuffer(file, name, column, BATCH_POINTS, True, True))
    writer = points.writer(buffers)
    for batch in stream.batches():
        for start in range(0, len(batch), BATCH_POINTS):
            part = batch.chosen(slice(start, start + BATCH_POINTS))
            _fill(columns, part)
            writer.write(len(part))
    writer.close()


def _head(file: Any) -> None:
    root = file.root()
    file.extensionsAdd("", libe57.E57_V1_0_URI)
    for name, text in (
        ("formatName", "ASTM E57 3D Imaging Data File"), ("guid", _FILE_GUID),
        ("e57LibraryVersion", libe57.E57_LIBRARY_ID), ("coordinateMetadata", ""),
    ):  # fmt: skip
        root.set(name, libe57.StringNode(file, text))
    root.set("versionMajor", libe57.IntegerNode(file, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(file, libe57.E57_FORMAT_MINOR))
    for name in ("data3D", "images2D"):
        root.set(name, libe57.VectorNode(file, True))


def _bounds(file: Any, stream: PointStream) -> Any:
    bounds = libe57.StructureNode(file)
    for axis, letter in enumerate("xyz"):
        bounds.set(f"{letter}Minimum", libe57.FloatNode(file, float(stream.low[axis])))
        bounds.set(f"{letter}Maximum", libe57.FloatNode(file, float(stream.high[axis])))
    return bounds


def _type_of(name: str) -> type[np.generic]:
    if name in _COLORS:
        return np.uint8
    return np.float32 if name in _NORMALS else np.float64


def _fill(columns: dict[str, NDArray[Any]], part: PointSet) -> None:
    for names, values in (
        (_COORDINATES, part.points), (_COLORS, part.color), (_NORMALS, part.normals),
    ):  # fmt: skip
        if values is None or names[0] not in columns:
            continue
        for axis, name in enumerate(names):
            columns[name][: len(part)] = values[:, axis]
