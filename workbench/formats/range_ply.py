"""Range maps in PLY: Stanford's ``range_grid``, the workbench's own, and what others write."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.ply import ListColumn, PlyElement, PlyFile, read_ply, write_ply
from workbench.formats.scan_reading import (
    GridCells,
    ScanReading,
    eight_bit_color,
    scan_reading,
)
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import Matrix4, is_rigid

_REFLECTANCE_NAMES = (
    "reflectance",
    "intensity",
    "scalar_reflectance",
    "scalar_intensity",
    "quality",
)
_FAR = 10.0
"""Distance of the assumed viewpoint of a scanner with parallel rays, in diagonals."""


def read_range_ply(path: Path) -> RangeMap:
    """Read a PLY file as one scan; see `range_ply_reading` for what was left out.

    Raises
    ------
    InputError
        No PLY, no vertices, or contradictions in it.
    """
    return range_ply_reading(path).range_map


def range_ply_reading(path: Path) -> ScanReading:
    """Read a PLY file as one scan.

    Used are the vertex properties ``x y z`` (any type; scan frame, unit of the file), one of
    ``reflectance``, ``intensity``, ``quality`` or ``scalar_*``, ``red green blue``, and for
    the grid either the element ``range_grid`` with ``obj_info num_cols`` and ``num_rows``
    (Stanford 3D Scanning Repository) or the columns ``proj_row`` and ``proj_col``.

    The viewpoint is the one of an ``obj_info viewpoint x y z`` line (or ``unknown``). A
    Cyberware scan or one with a ``range_grid`` has none: that scanner looks along −z with
    nearly parallel rays, so the viewpoint lies ten bounding-box diagonals along +z from the
    centroid. Else it is the origin, unless the points surround it.

    Raises
    ------
    InputError
        No PLY, no vertices, or contradictions in it.
    """
    path = Path(path)
    file = read_ply(path)
    vertex = file.elements.get("vertex")
    coordinates = [] if vertex is None else [vertex.scalar(axis) for axis in "xyz"]
    if vertex is None or any(column is None for column in coordinates):
        raise InputError(
            "The PLY file has no vertices with x, y and z.",
            file=path,
            found=", ".join(file.elements) or "no elements",
            fix="Export it as a point cloud or range map.",
        )
    points = np.stack([c.astype(np.float64) for c in coordinates if c is not None], axis=1)
    notes: list[str] = []
    reflectance = _reflectance(vertex, notes)
    cells = _projector_cells(vertex, notes)
    viewpoint, known = _viewpoint(file, points, path)
    return scan_reading(
        path,
        path.stem,
        points,
        grid=_range_grid(file, vertex.count, path),
        cells=cells,
        viewpoint=viewpoint,
        viewpoint_known=known,
        reflectance=reflectance,
        color=_color(vertex),
        world_from_scan=_pose(file, path),
        notes=notes,
    )


def _reflectance(vertex: PlyElement, notes: list[str]) -> NDArray[np.generic] | None:
    lower = {name.lower(): name for name in vertex.columns}
    others = [name for name in lower if name.startswith("scalar_")]
    for name in (*_REFLECTANCE_NAMES, *others):
        column = vertex.scalar(lower[name]) if name in lower else None
        if column is not None:
            if name not in ("reflectance", "intensity"):
                notes.append(f"property '{lower[name]}' is taken for the reflectance")
            return column
    return None


def _color(vertex: PlyElement) -> NDArray[np.uint8] | None:
    for prefix in ("", "diffuse_"):
        red, green, blue = (vertex.scalar(prefix + name) for name in ("red", "green", "blue"))
        if red is not None and green is not None and blue is not None:
            return eight_bit_color(red, green, blue)
    return None


def _projector_cells(vertex: PlyElement, notes: list[str]) -> GridCells | None:
    row, column = vertex.scalar("proj_row"), vertex.scalar("proj_col")
    if row is None or column is None:
        return None
    rows, columns = row.astype(np.float64), column.astype(np.float64)
    for numbers in (rows, columns):
        if not ((np.abs(numbers) < 2**31) & (numbers == np.floor(numbers))).all():
            notes.append("proj_row and proj_col are not whole numbers: no grid was made")
            return None
    return GridCells(rows.astype(np.int64), columns.astype(np.int64))


def _range_grid(file: PlyFile, vertices: int, path: Path) -> NDArray[np.int32] | None:
    element = file.elements.get("range_grid")
    if element is None:
        return None
    lists = [column for column in element.columns.values() if isinstance(column, ListColumn)]
    width, height = (_whole_info(file, key) for key in ("num_cols", "num_rows"))
    if len(lists) != 1 or width is None or height is None or width * height != element.count:
        raise InputError(
            "The range grid of the PLY file contradicts itself.",
            file=path,
            where="element 'range_grid'",
            expected="one list per cell and obj_info num_cols × num_rows cells",
            found=f"{len(lists)} lists, {width} × {height}, {element.count} cells",
            fix="Correct the header, or remove the range_grid element.",
        )
    lengths, index = lists[0].lengths, lists[0].values.astype(np.int64)
    wrong = lengths > 1
    if not wrong.any():
        wrong[lengths == 1] = (index < 0) | (index >= vertices)
    if wrong.any():
        raise InputError(
            "A cell of the range grid does not name one vertex of the file.",
            file=path,
            where=f"element 'range_grid', row {int(np.argmax(wrong))}",
            expected=f"nothing, or one index below {vertices}",
            fix="The file is damaged: export it again, or remove the range_grid element.",
        )
    cells = np.full(element.count, -1, np.int32)
    cells[lengths == 1] = index
    return cells.reshape(height, width)


def _whole_info(file: PlyFile, key: str) -> int | None:
    words = file.info(key)
    if not words or re.fullmatch(r"[0-9]{1,9}", words[0]) is None:
        return None
    return int(words[0])


def _viewpoint(
    file: PlyFile, points: NDArray[np.float64], path: Path
) -> tuple[NDArray[np.float64] | None, bool]:
    if (words := file.info("viewpoint")) is not None:
        if words == ["unknown"]:
            return None, True
        return _info_numbers(words, 3, "viewpoint", path), True
    if "range_grid" not in file.elements and file.info("is_cyberware_data") != ["1"]:
        return None, False
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return None, False
    with np.errstate(over="ignore"):
        diagonal = np.linalg.norm(np.ptp(finite, axis=0))
        far = finite.mean(axis=0) + np.array([0.0, 0.0, _FAR * diagonal])
    return (far, True) if np.isfinite(far).all() else (None, False)


def _pose(file: PlyFile, path: Path) -> Matrix4 | None:
    words = file.info("world_from_scan")
    if words is None:
        return None
    matrix = _info_numbers(words, 16, "world_from_scan", path).reshape(4, 4)
    if not is_rigid(matrix):
        raise InputError(
            "The pose in the PLY file is not rigid.",
            file=path,
            where="obj_info world_from_scan",
            fix="Correct or remove that header line.",
        )
    return matrix


def _info_numbers(words: list[str], count: int, key: str, path: Path) -> NDArray[np.float64]:
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(
            f"The {key} in the PLY header cannot be used.",
            file=path,
            where=f"obj_info {key}",
            expected=f"{count} finite numbers",
            found=" ".join(words)[:80],
            fix="Correct or remove that header line.",
        )
    return numbers


def write_range_ply(
    path: Path, range_map: RangeMap, *, float_type: Literal["float32", "float64"] = "float64"
) -> None:
    """Write a scan as binary little-endian PLY; same scan, same bytes.

    With float64 `read_range_ply` gives back every array of ``range_map`` bit for bit; its
    name is that of the file.

    Parameters
    ----------
    path
        The file to write.
    range_map
        The scan. Its pose, if any, is kept as ``obj_info world_from_scan``, row by row.
    float_type
        Type of the coordinates on disk. float32 rounds them to 2⁻²⁴ of their size: 0.06 µm
        at 1 m, but 0.25 m at the 5 000 km of a national grid.
    """
    columns: dict[str, NDArray[np.generic]] = {
        axis: range_map.points_in_scan[:, k].astype(float_type) for k, axis in enumerate("xyz")
    }
    if range_map.color is not None:
        for k, name in enumerate(("red", "green", "blue")):
            columns[name] = range_map.color[:, k]
    if range_map.reflectance is not None:
        columns["reflectance"] = range_map.reflectance.astype(np.float32)
    elements = [PlyElement("vertex", len(range_map), columns)]
    viewpoint = range_map.viewpoint_in_scan
    info = [f"viewpoint {'unknown' if viewpoint is None else _numbers(viewpoint)}"]
    if range_map.world_from_scan is not None:
        info.append(f"world_from_scan {_numbers(range_map.world_from_scan)}")
    if range_map.grid is not None:
        height, width = range_map.grid.shape
        info += [f"num_cols {width}", f"num_rows {height}"]
        cells = range_map.grid.reshape(-1)
        lists = ListColumn(cells[cells >= 0], (cells >= 0).astype(np.int64))
        elements.append(PlyElement("range_grid", len(cells), {"vertex_indices": lists}))
    write_ply(path, elements, obj_info=info)


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(repr(float(value)) for value in values.reshape(-1))
