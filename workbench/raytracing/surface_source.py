"""Surfaces whose vertices and triangles come some at a time: meshes, and PLY files in place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.ply_layout import LONGEST_HEADER, ElementLayout, PlyHeader, parse_header
from workbench.geometry.mesh import TriangleMesh
from workbench.raytracing.frame import LocalFrame

_ROWS_AT_ONCE = 1 << 20
_COLORS = ("red", "green", "blue")
_NORMALS = ("nx", "ny", "nz")


class SurfaceSource(Protocol):
    """A surface that is read in parts, in order, as often as is asked."""

    @property
    def vertices(self) -> int:
        """How many."""
        ...

    @property
    def triangles(self) -> int:
        """How many."""
        ...

    def points(self) -> Iterator[NDArray[np.float64]]:
        """Positions (b, 3) of the vertices."""
        ...

    def colors(self) -> Iterator[NDArray[np.uint8]] | None:
        """Colours (b, 3) sRGB of the vertices, where there are any."""
        ...

    def corners(self) -> Iterator[NDArray[np.int64]]:
        """Vertices (b, 3) of the triangles."""
        ...


def surface_frame(source: SurfaceSource) -> LocalFrame:
    """The local frame of a surface; raises `InputError` where vertices are not finite."""
    return LocalFrame.of_bounds(*surface_bounds(source))


def surface_diagonal(source: SurfaceSource) -> float:
    """Of the bounds of all vertices, in the surface's unit."""
    low, high = surface_bounds(source)
    return float(np.linalg.norm(high - low))


def surface_bounds(source: SurfaceSource) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (3,) of the box around all vertices, in the surface's frame; NaN where one is."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for points in source.points():
        # NaN does not vanish in these minima, and is refused with the bounds.
        low = np.minimum(low, points.min(axis=0))
        high = np.maximum(high, points.max(axis=0))
    return low, high


class MeshSource:
    """A mesh in memory."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh

    @property
    def vertices(self) -> int:
        return len(self.mesh.vertices)

    @property
    def triangles(self) -> int:
        return len(self.mesh.triangles)

    def points(self) -> Iterator[NDArray[np.float64]]:
        yield self.mesh.vertices

    def colors(self) -> Iterator[NDArray[np.uint8]] | None:
        colors = self.mesh.vertex_attributes.get("color")
        return None if colors is None else iter([np.asarray(colors, np.uint8)])

    def corners(self) -> Iterator[NDArray[np.int64]]:
        for first in range(0, self.triangles, _ROWS_AT_ONCE):
            yield self.mesh.triangles[first : first + _ROWS_AT_ONCE].astype(np.int64)


class PlySource:
    """A binary PLY file of vertices with single values, then triangles; never whole in memory.

    Attributes
    ----------
    path : the file.
    header : what it declares.
    vertex_row, face_row : type of one row of either element.
    vertex_start, face_start : byte where the rows of either begin.

    Raises
    ------
    InputError
        A file that cannot be read so: text, other elements before or between these, lists besides
        the corners; damaged; or, while it is read, a face that is no triangle.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError("The file does not exist.", file=path, fix="Check the path.")
        with open(self.path, "rb") as file:
            self.header = parse_header(file.read(LONGEST_HEADER), self.path)
        vertex, face = self._elements(self.header)
        self.vertex_row, self.face_row = self._row(vertex), self._row(face)
        self.vertices, self.triangles = vertex.count, face.count
        self.vertex_start = self.header.body_start
        self.face_start = self.vertex_start + vertex.count * self.vertex_row.itemsize
        end = self.face_start + face.count * self.face_row.itemsize
        if end > self.path.stat().st_size:
            raise self._refused(
                "The file is shorter than its header says, or some faces are no triangles.",
                f"{self.path.stat().st_size} of {end} bytes",
            )

    def points(self) -> Iterator[NDArray[np.float64]]:
        for rows in self.vertex_rows():
            yield np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)

    def colors(self) -> Iterator[NDArray[np.uint8]] | None:
        fields: Mapping[str, Any] = self.vertex_row.fields or {}
        if not all(name in fields and fields[name][0] == np.uint8 for name in _COLORS):
            return None
        return (np.stack([rows[n] for n in _COLORS], axis=1) for rows in self.vertex_rows())

    def normals(self) -> Iterator[NDArray[np.float32]] | None:
        """Normals (b, 3) of the vertices, where there are any."""
        if not set(_NORMALS) <= set(self.vertex_row.names or ()):
            return None
        return (
            np.stack([rows[n].astype(np.float32) for n in _NORMALS], axis=1)
            for rows in self.vertex_rows()
        )

    def corners(self) -> Iterator[NDArray[np.int64]]:
        for rows in self._rows(self.face_row, self.face_start, self.triangles):
            if not (rows["count"] == 3).all():
                raise self._refused("A face is no triangle.", f"{rows['count'].max()} corners")
            yield rows["corners"].astype(np.int64)

    def vertex_rows(self) -> Iterator[NDArray[np.void]]:
        """The vertices as they are in the file."""
        yield from self._rows(self.vertex_row, self.vertex_start, self.vertices)

    def _rows(self, dtype: np.dtype[np.void], start: int, count: int) -> Iterator[NDArray[np.void]]:
        with open(self.path, "rb") as file:
            file.seek(start)
            for first in range(0, count, _ROWS_AT_ONCE):
                yield np.fromfile(file, dtype, min(_ROWS_AT_ONCE, count - first))

    def _elements(self, header: PlyHeader) -> tuple[ElementLayout, ElementLayout]:
        names = [element.name for element in header.elements[:2]]
        if header.byte_order is None or names != ["vertex", "face"]:
            raise self._refused(
                "The PLY file cannot be read in parts.",
                "text" if header.byte_order is None else ", ".join(names) or "no elements",
            )
        vertex, face = header.elements[:2]
        if not {"x", "y", "z"} <= {p.name for p in vertex.properties} or not face.count:
            raise self._refused("The PLY file holds no triangle mesh.", "no x, y, z or no faces")
        return vertex, face

    def _row(self, element: ElementLayout) -> np.dtype[np.void]:
        order = self.header.byte_order or "<"
        fields: list[tuple[Any, ...]] = []
        for declared in element.properties:
            value = declared.value_type.newbyteorder(order)
            if declared.count_type is None:
                fields.append((declared.name, value, ()))
            elif declared.name in ("vertex_indices", "vertex_index") and element.name == "face":
                fields += [("count", declared.count_type.newbyteorder(order), ())]
                fields += [("corners", value, (3,))]
            else:
                raise self._refused("The PLY file cannot be read in parts.", declared.name)
        if element.name == "face" and "corners" not in [name for name, *_ in fields]:
            raise self._refused("The PLY file holds no triangle mesh.", "no vertex_indices")
        return np.dtype(fields)

    def _refused(self, message: str, found: str) -> InputError:
        return InputError(
            message,
            file=self.path,
            expected="binary PLY: vertices with x y z, then faces of three corners each",
            found=found,
            fix="Export it so, or give more memory than the whole surface takes.",
        )
