"""Points of PLY files, streamed where the file allows, and written as a stream.

Source: G. Turk, *The PLY Polygon File Format* (Stanford, 1994).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.ply import read_ply
from workbench.formats.ply_layout import LONGEST_HEADER, PlyHeader, parse_header
from workbench.formats.point_attributes import unit_normals
from workbench.formats.point_stream import BATCH_POINTS, PointStream, slices_of
from workbench.formats.scan_reading import eight_bit_color
from workbench.geometry.point_set import PointSet

_AXES = ("x", "y", "z")
_NORMALS = ("nx", "ny", "nz")
_COLORS = ("red", "green", "blue")
_RADIUS = "radius"
_FIX = "Check the file; the program that wrote it may offer another format."


def ply_batches(path: Path) -> Iterator[PointSet]:
    """The vertices of a PLY file, some at a time, in the order of the file.

    ``x y z`` are points, ``nx ny nz`` normals, ``red green blue`` colours and ``radius`` the
    radius, as far as they are there. A binary file whose first element are the vertices,
    of single values and colours of bytes, is never in memory as a whole; others are.

    Raises
    ------
    InputError
        The file is absent, damaged, or has no vertices with ``x y z``.
    """
    path = Path(path)
    row = None if not path.is_file() else _streamed_row(path)
    if row is None:
        vertex = read_ply(path).elements.get("vertex")
        columns = {} if vertex is None else {n: vertex.scalar(n) for n in vertex.columns}
        yield from slices_of(
            _point_set({n: c for n, c in columns.items() if c is not None}, path)
        )()
        return
    dtype, start, count = row
    with open(path, "rb") as file:
        file.seek(start)
        for first in range(0, count, BATCH_POINTS):
            rows = np.fromfile(file, dtype, min(BATCH_POINTS, count - first))
            yield _point_set({name: rows[name] for name in dtype.names or ()}, path)


def is_streamed(path: Path) -> bool:
    """Whether `ply_batches` reads the file in parts."""
    return Path(path).is_file() and _streamed_row(Path(path)) is not None


def _streamed_row(path: Path) -> tuple[np.dtype[np.void], int, int] | None:
    """Type of a vertex, where they begin and how many; None where the file is read whole."""
    with open(path, "rb") as file:
        data = file.read(LONGEST_HEADER)
    if not data:
        return None
    header = parse_header(data, path)
    if header.byte_order is None or not header.elements:
        return None
    first = header.elements[0]
    dtype = _row_type(header)
    if dtype is None or first.name != "vertex" or not first.count:
        return None
    if header.body_start + first.count * dtype.itemsize > path.stat().st_size:
        # The whole reader tells which row is missing.
        return None
    return dtype, header.body_start, first.count


def _row_type(header: PlyHeader) -> np.dtype[np.void] | None:
    fields = []
    for declared in header.elements[0].properties:
        wide_color = declared.name in _COLORS and declared.value_type != np.uint8
        if declared.count_type is not None or wide_color:
            return None
        fields.append((declared.name, declared.value_type.newbyteorder(header.byte_order or "<")))
    return np.dtype(fields) if fields else None


def _point_set(columns: Mapping[str, NDArray[Any]], path: Path) -> PointSet:
    if not columns.keys() >= set(_AXES) or not len(columns["x"]):
        raise InputError(
            "The PLY file holds no points.",
            file=path,
            expected="an element 'vertex' with x, y and z, and some rows",
            found=", ".join(columns) or "no vertices",
            fix=_FIX,
        )
    color = normals = radius = None
    if columns.keys() >= set(_COLORS):
        color = eight_bit_color(*(columns[name] for name in _COLORS))
    if columns.keys() >= set(_NORMALS):
        normals = unit_normals(np.stack([columns[name] for name in _NORMALS], axis=1))
    if _RADIUS in columns:
        radius = columns[_RADIUS].astype(np.float32)
    points = np.stack([columns[axis].astype(np.float64) for axis in _AXES], axis=1)
    return PointSet(points, normals, color, radius)


def write_ply_points(path: Path, stream: PointStream) -> dict[str, Any]:
    """Write a stream of points as binary little-endian PLY; same points, same bytes.

    Vertices are ``x y z`` (double), then as far as the stream has them ``nx ny nz`` (float),
    ``red green blue`` (uchar, sRGB) and ``radius`` (float).

    Returns
    -------
    ``bytes`` of the file and ``rounding_error``, which is zero.
    """
    fields = [(name, "<f8", "double") for name in _AXES]
    if "normals" in stream.attributes:
        fields += [(name, "<f4", "float") for name in _NORMALS]
    if "color" in stream.attributes:
        fields += [(name, "u1", "uchar") for name in _COLORS]
    if "radius" in stream.attributes:
        fields.append((_RADIUS, "<f4", "float"))
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {stream.count}"]
    header += [f"property {kind} {name}" for name, _, kind in fields]
    dtype = np.dtype([(name, code) for name, code, _ in fields])
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write("\n".join([*header, "end_header\n"]).encode())
        for batch in stream.batches():
            rows = np.empty(len(batch), dtype)
            for names, values in (
                (_AXES, batch.points), (_NORMALS, batch.normals), (_COLORS, batch.color),
            ):  # fmt: skip
                for k, name in enumerate(names):
                    if values is not None and name in (dtype.names or ()):
                        rows[name] = values[:, k]
            if batch.radius is not None and _RADIUS in (dtype.names or ()):
                rows[_RADIUS] = batch.radius
            file.write(rows.data)
    return {"bytes": Path(path).stat().st_size, "rounding_error": 0.0}
