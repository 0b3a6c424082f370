"""LAS and LAZ files, written from a stream of points in memory for one batch.

Source: ASPRS, *LAS Specification 1.4 – R15*; M. Isenburg, *LASzip*.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lazrs
import numpy as np
from numpy.typing import NDArray

from workbench.formats.atomic import replacing
from workbench.formats.las_layout import (
    EXTRA_BYTES_ENTRY,
    EXTRA_BYTES_RECORD,
    HEADER_BYTES,
    LASZIP_RECORD,
)
from workbench.formats.point_rounding import Rounding, rounding_of
from workbench.formats.point_stream import PointStream
from workbench.geometry.point_set import PointSet

_SOFTWARE = b"Scan workbench"
_FLOAT32 = 9
_COORDINATES_ARE_WKT = 16
_COMPRESSED = 0x80
_ONLY_RETURN = 0x11

Record = tuple[tuple[str, int], bytes]


def write_las(
    path: Path, stream: PointStream, *, precision: float | None = None, compressed: bool = True
) -> dict[str, Any]:
    """Write a LAS 1.4 file of a stream, compressed to LAZ or not; same points, same bytes.

    Points are of format 7, or 6 where they have no colour: ``x y z`` as integers by a
    `Rounding`, red, green and blue as 16 bits (257 times the byte), one return each, all
    else zero. Normals are further numbers ``NormalX NormalY NormalZ`` and the radius is
    ``radius``, each float32. The date is left zero.

    Parameters
    ----------
    path
        The file; it is whole or not there.
    stream
        The points.
    precision
        Step of coordinates, by default that of `rounding_of`.
    compressed
        Compress as LASzip does, in chunks of 50 000 points.

    Returns
    -------
    ``bytes`` of the file, ``precision`` (the step) and ``rounding_error`` (half of it).

    Raises
    ------
    SettingsError
        The precision does not fit the size of the cloud.
    """
    rounding = rounding_of(stream.low, stream.high, precision)
    layout = LasRecords(stream.attributes, rounding)
    vlr = lazrs.LazVlr.new_for_compression(layout.point_format, layout.extra_bytes, False)
    records = layout.extra_record()
    if compressed:
        records.append((LASZIP_RECORD, vlr.record_data()))
    low, high = layout.rounded_box(stream.low, stream.high)
    with replacing(path) as partial, open(partial, "wb+") as file:
        file.write(las_head(layout, stream.count, low, high, records, compressed=compressed))
        if compressed:
            zipper = lazrs.ParLasZipCompressor(file, vlr)
            for batch in stream.batches():
                zipper.compress_many(layout.rows(batch).tobytes())
            zipper.done()
        else:
            for batch in stream.batches():
                file.write(layout.rows(batch).data)
    return {
        "bytes": Path(path).stat().st_size,
        "precision": rounding.step,
        "rounding_error": rounding.step / 2,
    }


class LasRecords:
    """Points as records of LAS point format 7 (with colour) or 6.

    Parameters
    ----------
    attributes : which of ``normals``, ``color`` and ``radius`` are written.
    rounding : of coordinates.
    """

    def __init__(self, attributes: frozenset[str], rounding: Rounding) -> None:
        self.rounding = rounding
        self.colored = "color" in attributes
        self.point_format = 7 if self.colored else 6
        self._extra = [
            *(("NormalX", "NormalY", "NormalZ") if "normals" in attributes else ()),
            *(("radius",) if "radius" in attributes else ()),
        ]
        fields: list[tuple[Any, ...]] = [
            ("whole", "<i4", (3,)), ("intensity", "<u2"), ("returns", "u1"), ("flags", "u1"),
            ("class", "u1"), ("user", "u1"), ("angle", "<i2"), ("source", "<u2"), ("time", "<f8"),
        ]  # fmt: skip
        if self.colored:
            fields.append(("color", "<u2", (3,)))
        self.dtype = np.dtype(fields + [(name, "<f4") for name in self._extra])

    @property
    def extra_bytes(self) -> int:
        """Of every point, beyond its format."""
        return 4 * len(self._extra)

    def rows(self, points: PointSet) -> NDArray[np.void]:
        """Records (n,) of points."""
        return self.rows_of(self.rounding.whole(points.points), points)

    def rows_of(self, whole: NDArray[np.int32], points: PointSet) -> NDArray[np.void]:
        """Records (n,) of points whose integer coordinates (n, 3) are known."""
        rows = np.zeros(len(whole), self.dtype)
        rows["whole"] = whole
        rows["returns"] = _ONLY_RETURN
        if self.colored and points.color is not None:
            rows["color"] = points.color.astype(np.uint16) * 257
        if "NormalX" in self._extra and points.normals is not None:
            for axis, name in enumerate(("NormalX", "NormalY", "NormalZ")):
                rows[name] = points.normals[:, axis]
        if "radius" in self._extra and points.radius is not None:
            rows["radius"] = points.radius
        return rows

    def extra_record(self) -> list[Record]:
        """The record that names further numbers, where there are some."""
        if not self._extra:
            return []
        entries = b"".join(
            struct.pack("<2xBB32s156x", _FLOAT32, 0, name.encode()) for name in self._extra
        )
        assert len(entries) == EXTRA_BYTES_ENTRY * len(self._extra)
        return [(EXTRA_BYTES_RECORD, entries)]

    def rounded_box(
        self, low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The box of points after rounding: rounding keeps the order of numbers."""
        corners = self.rounding.coordinates(self.rounding.whole(np.stack([low, high])))
        return corners[0], corners[1]


def las_head(
    layout: LasRecords,
    count: int,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    records: Sequence[Record],
    *,
    compressed: bool,
    extended: tuple[int, int] = (0, 0),
) -> bytes:
    """All bytes before the points of a LAS 1.4 file.

    Parameters
    ----------
    layout
        What a point is.
    count
        Points.
    low, high
        (3,) corners of their box as rounded.
    records
        Owner, number and content of each variable length record, in order.
    compressed
        Whether points are.
    extended
        Byte where the extended records behind the points start, and their number.
    """
    body = b"".join(
        struct.pack("<2x16sHH32x", owner.encode(), number, len(content)) + content
        for (owner, number), content in records
    )
    head = bytearray(HEADER_BYTES)
    struct.pack_into("<4sHH", head, 0, b"LASF", 0, _COORDINATES_ARE_WKT)
    struct.pack_into("<BB32s32s", head, 24, 1, 4, b"OTHER", _SOFTWARE)
    point_format = layout.point_format | (_COMPRESSED if compressed else 0)
    struct.pack_into("<HIIBH", head, 94, HEADER_BYTES, HEADER_BYTES + len(body), len(records),
                     point_format, layout.dtype.itemsize)  # fmt: skip
    box = np.stack([high, low], axis=1).ravel()
    scale = [layout.rounding.step] * 3
    struct.pack_into("<12d", head, 131, *scale, *layout.rounding.origin, *box)
    struct.pack_into("<QIQQ", head, 235, *extended, count, count)
    return bytes(head) + body
