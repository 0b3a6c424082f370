"""Point Cloud Library files: text, binary and compressed, organised or not.

Source: Point Cloud Library, *The PCD (Point Cloud Data) file format*, version 0.7.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.number_text import as_bytes_array, line_number, numbers_in_text
from workbench.formats.scan_reading import ScanReading, scan_reading
from workbench.formats.whole_file import whole_file
from workbench.geometry.rangemap import RangeMap
from workbench.kernels.lzf import decompress_lzf

_TYPES = {"F": "f", "I": "i", "U": "u"}
_LONGEST_HEADER = 1 << 16
_LZF_BEST_RATIO = 264 / 3
"""The longest copy LZF knows, 264 bytes, takes three."""
_FIX = "The file was cut short or its header is wrong: export it again."


@dataclass(frozen=True)
class _Header:
    names: tuple[str, ...]
    types: tuple[np.dtype[np.generic], ...]
    counts: tuple[int, ...]
    width: int
    height: int
    viewpoint: NDArray[np.float64] | None
    storage: str
    body: int

    @property
    def points(self) -> int:
        return self.width * self.height

    @property
    def row_bytes(self) -> int:
        return sum(t.itemsize * c for t, c in zip(self.types, self.counts, strict=True))


def read_pcd(path: Path) -> RangeMap:
    """Read a PCD file as one scan; see `pcd_reading`.

    Raises
    ------
    InputError
        No PCD, no coordinates, or a body that does not fit the header.
    """
    return pcd_reading(path).range_map


def pcd_reading(path: Path) -> ScanReading:
    """Read a PCD file as one scan.

    Used are the fields ``x y z`` (scan frame, unit of the file, kept in float64),
    ``intensity`` and ``rgb`` or ``rgba`` (packed 0x00RRGGBB in four bytes). A file with
    ``HEIGHT`` above 1 gives a grid (height, width) whose NaN cells are holes, not losses.
    The viewpoint is the translation of ``VIEWPOINT``, in the frame of the points as the
    library's normal estimation takes it; the default, all zero, counts as not given.

    Raises
    ------
    InputError
        No PCD, no coordinates, or a body that does not fit the header.
    """
    path = Path(path)
    data = whole_file(path)
    header = _header(data, path)
    if header.storage == "ascii":
        columns = _text_columns(data, header, path)
    elif header.storage == "binary":
        columns = _binary_columns(data, header, path)
    else:
        columns = _compressed_columns(data, header, path)
    points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    organised = header.height > 1
    notes = []
    if organised:
        holes = int((~np.isfinite(points).all(axis=1)).sum())
        notes.append(f"{holes} of {header.points} grid cells saw nothing")
    return scan_reading(
        path,
        path.stem,
        points,
        grid=np.arange(header.points, dtype=np.int32).reshape(header.height, header.width)
        if organised
        else None,
        viewpoint=header.viewpoint,
        viewpoint_known=header.viewpoint is not None,
        reflectance=columns.get("intensity"),
        color=_color(columns),
        holes_are_expected=organised,
        notes=notes,
    )


def _header(data: bytes, path: Path) -> _Header:
    end = re.search(rb"^DATA[ \t]+(\S+)[ \t]*(\r\n|\n|\r|$)", data[:_LONGEST_HEADER], re.MULTILINE)
    if end is None:
        _refuse(path, "This is not a PCD file, or its header is cut short.", "no DATA line")
    lines = {}
    for line in data[: end.start()].decode("ascii", "replace").splitlines():
        words = line.split("#")[0].split()
        if words:
            lines[words[0].upper()] = words[1:]
    names = lines.get("FIELDS") or lines.get("COLUMNS") or []
    sizes = lines.get("SIZE", ["4"] * len(names))
    kinds = lines.get("TYPE", ["F"] * len(names))
    counts = lines.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        _refuse(
            path,
            "FIELDS, SIZE, TYPE and COUNT of the PCD header do not fit each other.",
            f"{len(names)}, {len(sizes)}, {len(kinds)} and {len(counts)} entries",
        )
    types = []
    for size, kind in zip(sizes, kinds, strict=True):
        if kind not in _TYPES or size not in ("1", "2", "4", "8") or (kind + size) in ("F1", "F2"):
            _refuse(path, "The PCD header names a type that does not exist.", f"{kind} {size}")
        types.append(np.dtype(f"<{_TYPES[kind]}{size}"))
    for axis in "xyz":
        if names.count(axis) != 1 or counts[names.index(axis)] != "1":
            _refuse(path, f"The PCD file has no single field '{axis}'.", " ".join(names))
    storage = end.group(1).decode("ascii", "replace").lower()
    if storage not in ("ascii", "binary", "binary_compressed"):
        _refuse(path, "Unknown kind of PCD data.", storage)
    points = _whole(lines, "POINTS", path) if "POINTS" in lines else None
    width = _whole(lines, "WIDTH", path) if "WIDTH" in lines else points
    height = _whole(lines, "HEIGHT", path) if "HEIGHT" in lines else 1
    if width is None:
        _refuse(path, "The PCD header does not say how many points there are.", "no WIDTH")
    if points is not None and points != width * height:
        _refuse(
            path,
            "The PCD header contradicts itself.",
            f"WIDTH {width} × HEIGHT {height} is not POINTS {points}",
        )
    return _Header(
        tuple(names),
        tuple(types),
        tuple(_whole({"COUNT": [count]}, "COUNT", path) for count in counts),
        width,
        height,
        _viewpoint(lines.get("VIEWPOINT"), path),
        storage,
        end.end(),
    )


def _whole(lines: Mapping[str, list[str]], key: str, path: Path) -> int:
    words = lines[key]
    if len(words) != 1 or re.fullmatch(r"[0-9]{1,12}", words[0]) is None:
        _refuse(path, f"{key} of the PCD header is no usable number.", " ".join(words)[:40])
    return int(words[0])


def _viewpoint(words: list[str] | None, path: Path) -> NDArray[np.float64] | None:
    if words is None:
        return None
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != 7 or not np.isfinite(numbers).all():
        _refuse(path, "VIEWPOINT of the PCD header is not seven numbers.", " ".join(words)[:80])
    return numbers[:3] if numbers[:3].any() else None


def _text_columns(data: bytes, header: _Header, path: Path) -> dict[str, NDArray[np.generic]]:
    width = sum(header.counts)
    text = as_bytes_array(data)
    read = numbers_in_text(text, header.body, header.points * width, columns=width)
    if read.problem is not None:
        _refuse(
            path,
            "The PCD body ends early or is damaged.",
            read.problem,
            f"line {line_number(text, read.end)}, point {len(read.values) // width}",
        )
    table = read.values.reshape(header.points, width)
    columns: dict[str, NDArray[np.generic]] = {}
    first = 0
    for name, kind, count in zip(header.names, header.types, header.counts, strict=True):
        column = table[:, first : first + 1].reshape(-1)
        first += count
        if count == 0:
            continue
        if name in ("rgb", "rgba"):
            # The text of a packed float colour is the float; its bits are the colour.
            columns[name] = (
                column.astype(np.float32).view(np.uint32)
                if kind.kind == "f"
                else _as_uint32(column)
            )
        elif name in ("x", "y", "z", "intensity"):
            columns[name] = column
    return columns


def _as_uint32(column: NDArray[np.float64]) -> NDArray[np.uint32]:
    inside = np.nan_to_num(column, nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(inside, -(2.0**31), 2.0**32 - 1).astype(np.int64).astype(np.uint32)


def _binary_columns(data: bytes, header: _Header, path: Path) -> dict[str, NDArray[np.generic]]:
    needed = header.points * header.row_bytes
    if needed > len(data) - header.body:
        _refuse(
            path,
            "The PCD body is shorter than its header says.",
            f"{len(data) - header.body} bytes of {needed}",
            f"byte {len(data)}, point {(len(data) - header.body) // header.row_bytes}",
        )
    rows = as_bytes_array(data)[header.body : header.body + needed]
    rows = rows.reshape(header.points, header.row_bytes)
    columns, first = {}, 0
    for name, kind, count in zip(header.names, header.types, header.counts, strict=True):
        if count:
            field = np.ascontiguousarray(rows[:, first : first + kind.itemsize])
            columns[name] = field.view(kind)[:, 0]
        first += kind.itemsize * count
    return columns


def _compressed_columns(data: bytes, header: _Header, path: Path) -> dict[str, NDArray[np.generic]]:
    """Fields one after the other, each for all points, packed with LZF."""
    if len(data) - header.body < 8:
        _refuse(path, "The compressed PCD body has no sizes.", f"{len(data)} bytes")
    packed_size, size = np.frombuffer(data, "<u4", 2, header.body).tolist()
    packed = as_bytes_array(data)[header.body + 8 :][:packed_size]
    if size != header.points * header.row_bytes or size > _LZF_BEST_RATIO * (len(packed) + 1):
        _refuse(
            path,
            "The compressed PCD body does not fit its header.",
            f"{size} bytes unpacked, {len(packed)} packed",
            f"byte {header.body}",
        )
    raw = np.empty(size, np.uint8)
    if len(packed) != packed_size or decompress_lzf(packed, raw) != size:
        _refuse(
            path,
            "The compressed PCD body is damaged.",
            f"{len(packed)} of {packed_size} packed bytes",
            f"byte {header.body + 8}",
        )
    columns, first = {}, 0
    for name, kind, count in zip(header.names, header.types, header.counts, strict=True):
        block = kind.itemsize * count * header.points
        if count:
            field = raw[first : first + block].view(kind).reshape(header.points, count)
            columns[name] = field[:, 0]
        first += block
    return columns


def _color(columns: Mapping[str, NDArray[np.generic]]) -> NDArray[np.uint8] | None:
    for name in ("rgb", "rgba"):
        packed = columns.get(name)
        if packed is not None and packed.dtype.itemsize == 4:
            bits = np.ascontiguousarray(packed).view(np.uint32)
            channels = [(bits >> shift) & 255 for shift in (16, 8, 0)]
            return np.stack(channels, axis=1).astype(np.uint8)
    return None


def _refuse(path: Path, message: str, found: str, where: str | None = None) -> NoReturn:
    raise InputError(message, file=path, where=where, found=found, fix=_FIX)
