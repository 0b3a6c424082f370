"""Leica PTX: gridded terrestrial scans as text, several to a file.

Source: Leica Geosystems, *Cyclone — PTX point cloud format* (also printed in New River
Kinematics' SpatialAnalyzer manual). A scan is ten header lines — columns, rows, the
scanner's registered position and its three axes, the four rows of a 4×4 matrix — and then
columns × rows lines ``x y z intensity [r g b]``, column after column, with ``0 0 0`` in the
cells that saw nothing.

The matrix is for row vectors: its translation is the last *row*, and a registered point is
``[x y z 1] · M``. Hence ``world_from_scan = Mᵀ``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.number_text import as_bytes_array, line_number, numbers_in_text
from workbench.formats.scan_reading import ScanReading, scan_reading
from workbench.formats.whole_file import whole_file
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import Matrix4, is_rigid, nearest_rigid

_AXIS_ROWS = 4
_HEADER_LINES = 10
_CUT_SHORT = "The file was cut short or is no PTX: export it again."


@dataclass(frozen=True)
class _Header:
    columns: int
    rows: int
    world_from_scan: Matrix4
    body: int


def read_ptx(path: Path) -> list[RangeMap]:
    """Read every scan of a PTX file; see `ptx_readings`.

    Raises
    ------
    InputError
        No PTX, a truncated or ragged body (line), a matrix that is not rigid.
    """
    return [reading.range_map for reading in ptx_readings(path)]


def ptx_readings(path: Path) -> list[ScanReading]:
    """Read every scan of a PTX file.

    Points stay in the scanner's frame, float64, with the scanner at the origin; the matrix
    becomes ``world_from_scan``. The grid is (rows, columns). Scans of a file with several
    are named ``<stem>_000``, ``<stem>_001``, …

    Raises
    ------
    InputError
        No PTX, a truncated or ragged body (line), a matrix that is not rigid.
    """
    path = Path(path)
    data = whole_file(path)
    text = as_bytes_array(data)
    position = _skip_blank(data, 0)
    scans: list[tuple[_Header, NDArray[np.float64]]] = []
    while position < len(data) or not scans:
        header = _header(data, position, path)
        table, position = _cells(text, header, path)
        scans.append((header, table))
        position = _skip_blank(data, position)
    several = len(scans) > 1
    return [
        _reading(path, f"{path.stem}_{k:03d}" if several else path.stem, header, table)
        for k, (header, table) in enumerate(scans)
    ]


def _skip_blank(data: bytes, position: int) -> int:
    found = re.compile(rb"\s*").match(data, position)
    return found.end() if found else position


def _line_at(data: bytes, position: int) -> tuple[bytes, int]:
    end = re.compile(rb"\r\n|\n|\r").search(data, position)
    if end is None:
        return data[position:], len(data)
    return data[position : end.start()], end.end()


def _header(data: bytes, position: int, path: Path) -> _Header:
    widths = [1, 1] + [3] * _AXIS_ROWS + [4] * 4
    numbers: list[list[float]] = []
    for width in widths:
        line, after = _line_at(data, position)
        words = line.split()
        try:
            row = [float(word.replace(b"_", b"?")) for word in words]
        except ValueError:
            row = []
        if len(row) != width or len(words) != width or not np.isfinite(row).all():
            raise InputError(
                "The header of a PTX scan is not understood.",
                file=path,
                where=f"line {line_number(as_bytes_array(data), position)}",
                expected=f"{width} finite number{'s' if width > 1 else ''}",
                found=repr(line[:60].decode("ascii", "replace")),
                fix=_CUT_SHORT,
            )
        numbers.append(row)
        position = after
    columns, rows = numbers[0][0], numbers[1][0]
    # The shortest cell, "0 0 0 0", takes eight bytes with its line end.
    most = (len(data) - position + 1) // 8
    if columns != int(columns) or rows != int(rows) or columns < 1 or rows < 1:
        raise InputError(
            "A PTX scan has an impossible grid.",
            file=path,
            expected="whole numbers of columns and rows, at least 1 each",
            found=f"{columns:g} columns, {rows:g} rows",
            fix=_CUT_SHORT,
        )
    if columns * rows > most:
        raise InputError(
            "A PTX scan declares more cells than the file can hold.",
            file=path,
            where=f"byte {position}",
            expected=f"{columns:g} × {rows:g} cells",
            found=f"at most {most}",
            fix=_CUT_SHORT,
        )
    matrix = np.array(numbers[-4:]).T
    if not is_rigid(matrix, 1e-3):
        raise InputError(
            "The transform of a PTX scan is not rigid.",
            file=path,
            where=f"the four lines before line {line_number(as_bytes_array(data), position)}",
            expected="a rotation, and a translation in the last row",
            fix="Export the scan without scaling, or correct the matrix.",
        )
    return _Header(int(columns), int(rows), nearest_rigid(matrix), position)


def _cells(text: NDArray[np.uint8], header: _Header, path: Path) -> tuple[NDArray[np.float64], int]:
    first, _ = _line_at(text[header.body : header.body + 4096].tobytes(), 0)
    width = len(first.split())
    if width not in (4, 7):
        raise InputError(
            "The cells of a PTX scan are not understood.",
            file=path,
            where=f"line {line_number(text, header.body)}",
            expected="x y z intensity, or x y z intensity r g b",
            found=f"{width} values",
            fix=_CUT_SHORT,
        )
    count = header.columns * header.rows
    read = numbers_in_text(text, header.body, count * width, columns=width)
    if read.problem is not None:
        raise InputError(
            "The body of a PTX scan ends early or is damaged.",
            file=path,
            where=f"line {line_number(text, read.end)}, byte {read.end}, "
            f"cell {len(read.values) // width}",
            expected=f"{count} cells of {width} numbers",
            found=read.problem,
            fix=_CUT_SHORT,
        )
    return read.values.reshape(count, width), read.end


def _reading(path: Path, name: str, header: _Header, table: NDArray[np.float64]) -> ScanReading:
    seen = (table[:, :3] != 0).any(axis=1)
    returns = table[seen]
    index = np.full(len(table), -1, np.int32)
    index[seen] = np.arange(len(returns), dtype=np.int32)
    notes = []
    if np.array_equal(header.world_from_scan, np.eye(4)):
        notes.append("the file gives the identity as pose: the scan may never have been registered")
    color = returns[:, 4:7]
    return scan_reading(
        path,
        name,
        returns[:, :3],
        # Cells run down a column first.
        grid=np.ascontiguousarray(index.reshape(header.columns, header.rows).T),
        viewpoint=np.zeros(3),
        viewpoint_known=True,
        reflectance=returns[:, 3],
        color=_color(color) if color.shape[1] else None,
        world_from_scan=header.world_from_scan,
        notes=notes,
    )


def _color(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.clip(np.rint(np.nan_to_num(values, nan=0.0)), 0, 255).astype(np.uint8)
