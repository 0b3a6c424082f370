"""What the head of a LAS or LAZ file declares, checked against the bytes there are.

Source: ASPRS, *LAS Specification 1.4 – R15*, sections 2.4 to 2.7; M. Isenburg, *LASzip*, for
what compression adds: a record that tells how, and a table of chunks behind the points.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

HEADER_BYTES = 375
"""Of version 1.4."""
POINT_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Least size of a point by its format."""
COLOR_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
"""Where red, green and blue (uint16 each) stand in a point, by its format."""
VLR_BYTES = 54
EVLR_BYTES = 60
LASZIP_RECORD = ("laszip encoded", 22204)
EXTRA_BYTES_RECORD = ("LASF_Spec", 4)
EXTRA_BYTES_ENTRY = 192

_VERSIONS = {(1, 0): 227, (1, 1): 227, (1, 2): 227, (1, 3): 235, (1, 4): 375}
_EXTRA_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "u8", 8: "i8",
                9: "f4", 10: "f8"}  # fmt: skip
_DAMAGED = "The file was cut short or damaged: copy or export it again."


@dataclass(frozen=True)
class ExtraField:
    """A number per point beyond those of its format: at byte ``start`` of a point."""

    start: int
    dtype: np.dtype[np.generic]
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class LasLayout:
    """What the head of a file declares.

    Attributes
    ----------
    point_format : 0 to 10.
    point_bytes : size of an uncompressed point.
    count : points.
    scale, offset : (3,) float64; a coordinate is integer · scale + offset.
    points_start : byte where they begin.
    extra : further numbers of every point by name, as far as they are declared.
    laszip : the record that tells how points are compressed, or None.
    file_bytes : size of the file.
    """

    point_format: int
    point_bytes: int
    count: int
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    points_start: int
    extra: dict[str, ExtraField]
    laszip: bytes | None
    file_bytes: int


def las_layout(file: BinaryIO, path: Path) -> LasLayout:
    """Read and check the head of a LAS or LAZ file that is open for reading.

    Raises
    ------
    InputError
        Another format or version; sizes, counts or numbers that cannot be true.
    """
    size = file.seek(0, 2)
    file.seek(0)
    head = file.read(HEADER_BYTES)
    if head[:4] != b"LASF":
        refused(path, "This is not a LAS or LAZ file.", "'LASF' at byte 0", repr(head[:4]))
    version = (head[24], head[25]) if len(head) >= 26 else (0, 0)
    if len(head) < _VERSIONS.get(version, 0) or version not in _VERSIONS:
        refused(
            path,
            "The head of the LAS file cannot be used.",
            "versions 1.0 to 1.4, whole",
            f"version {version[0]}.{version[1]}, {len(head)} bytes",
        )
    head_bytes, points_start, records = struct.unpack_from("<HII", head, 94)
    kind, point_bytes, count = struct.unpack_from("<BHI", head, 104)
    scale, offset = np.frombuffer(head, "<f8", 6, 131).reshape(2, 3).astype(np.float64)
    if version == (1, 4):
        (count,) = struct.unpack_from("<Q", head, 247)
    if head_bytes < _VERSIONS[version] or not head_bytes <= points_start <= size:
        refused(path, "The sizes in the head of the LAS file cannot be true.",
                f"points between byte {head_bytes} and {size}", f"byte {points_start}")  # fmt: skip
    compressed, point_format = bool(kind & 0xC0), kind & 0x3F
    if point_format >= len(POINT_BYTES) or point_bytes < POINT_BYTES[point_format]:
        refused(path, "The LAS file has points of an unknown kind.", "point formats 0 to 10",
                f"format {point_format} with {point_bytes} bytes per point")  # fmt: skip
    if not (np.isfinite(scale) & (scale > 0) & np.isfinite(offset)).all():
        refused(path, "The LAS file scales coordinates by numbers that cannot be used.",
                "positive scales, finite offsets", f"{[*scale, *offset]}")  # fmt: skip
    found = _records(file, path, head_bytes, points_start, records)
    if not compressed and count * point_bytes > size - points_start:
        refused(path, "The LAS file ends before its points do.", f"{count} points",
                f"{(size - points_start) // point_bytes} points")  # fmt: skip
    laszip = found.get(LASZIP_RECORD)
    if compressed and laszip is None:
        refused(path, "The LAZ file does not tell how it is compressed.",
                "a LASzip record", "none")  # fmt: skip
    extra = _extra_fields(
        found.get(EXTRA_BYTES_RECORD, b""), POINT_BYTES[point_format], point_bytes
    )
    return LasLayout(point_format, point_bytes, count, scale, offset, points_start, extra,
                     laszip if compressed else None, size)  # fmt: skip


def _records(
    file: BinaryIO, path: Path, start: int, end: int, number: int
) -> dict[tuple[str, int], bytes]:
    """The records between the head and the points, the first of each kind."""
    found: dict[tuple[str, int], bytes] = {}
    if number * VLR_BYTES > end - start:
        refused(path, "The LAS file declares more records than there is room for.",
                f"at most {(end - start) // VLR_BYTES}", str(number))  # fmt: skip
    file.seek(start)
    data = file.read(end - start)
    at = 0
    for _ in range(number):
        if at + VLR_BYTES > len(data):
            refused(path, "A record of the LAS file ends too late.", f"byte {end}", "beyond")
        owner, record, size = struct.unpack_from("<16sHH", data, at + 2)
        at += VLR_BYTES
        if at + size > len(data):
            refused(path, "A record of the LAS file ends too late.", f"byte {end}", "beyond")
        name = owner.split(b"\0")[0].decode("ascii", "replace")
        found.setdefault((name, record), data[at : at + size])
        at += size
    return found


def _extra_fields(entries: bytes, start: int, end: int) -> dict[str, ExtraField]:
    """Declared single numbers; what follows one of unknown size is not read."""
    fields: dict[str, ExtraField] = {}
    for at in range(0, len(entries) - EXTRA_BYTES_ENTRY + 1, EXTRA_BYTES_ENTRY):
        kind, options = entries[at + 2], entries[at + 3]
        name = entries[at + 4 : at + 36].split(b"\0")[0].decode("ascii", "replace")
        if kind == 0:
            start += options
            continue
        if kind not in _EXTRA_TYPES:
            break
        dtype = np.dtype("<" + _EXTRA_TYPES[kind])
        scale = struct.unpack_from("<d", entries, at + 112)[0] if options & 8 else 1.0
        offset = struct.unpack_from("<d", entries, at + 136)[0] if options & 16 else 0.0
        if start + dtype.itemsize > end:
            break
        if np.isfinite([scale, offset]).all():
            fields.setdefault(name, ExtraField(start, dtype, scale, offset))
        start += dtype.itemsize
    return fields


def refused(path: Path, message: str, expected: str, found: str) -> NoReturn:
    """Raise the InputError of a file that cannot be used."""
    raise InputError(message, file=path, expected=expected, found=found, fix=_DAMAGED)
