"""Points of LAS and LAZ files, and of COPC files, which are LAZ files too.

Source: ASPRS, *LAS Specification 1.4 – R15*; M. Isenburg, *LASzip*. Decompression is that of
lazrs. It trusts the sizes inside a file, so they are checked here before it sees them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

import lazrs
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.las_layout import COLOR_AT, LasLayout, las_layout, refused
from workbench.formats.point_attributes import eight_bits, unit_normals
from workbench.formats.point_stream import BATCH_POINTS
from workbench.formats.whole_file import require_regular
from workbench.geometry.point_set import PointSet

_NORMALS = (("NormalX", "NormalY", "NormalZ"), ("nx", "ny", "nz"))
_RADIUS = "radius"
_LAYERED = 3
_ITEMS_AT = 34
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTES_ITEM = 14
_ITEM_BYTES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}
_ITEMS_OF_ANY_SIZE = (0, _BYTES_ITEM)
_MOST_CHUNK_POINTS = 1 << 32


class _Records(Protocol):
    def many(self, number: int) -> bytes: ...


def las_batches(path: Path) -> Iterator[PointSet]:
    """The points of a LAS, LAZ or COPC file, some at a time, in the order of the file.

    Coordinates are integers times the file's scale plus its offset, float64. Colours are
    made bytes: from 16 bits, or from 8 where no value of the whole file is above 255, as
    many programs write them. Further numbers called ``NormalX NormalY NormalZ`` or
    ``nx ny nz`` are normals, ``radius`` is the radius.

    Raises
    ------
    InputError
        The file is absent or damaged, or of another format; it is named.
    """
    path = Path(path)
    with _opened(path) as file, _told(path):
        layout = las_layout(file, path)
        white = _white(file, layout, path)
        for records in _record_batches(file, layout, path):
            yield _point_set(records, layout, white)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    require_regular(path)
    try:
        file = open(path, "rb")  # noqa: SIM115  # closed below, once it could be opened
    except OSError as error:
        raise InputError(
            "The file cannot be opened.", file=path, found=error.strerror, fix="Check the path."
        ) from error
    with file:
        yield file


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """What the decompressor throws, panics included, as an InputError."""
    try:
        yield
    except (InputError, GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        # A panic of the library is no Exception; all it means is a damaged file.
        if isinstance(error, Exception) or type(error).__name__ == "PanicException":
            refused(path, "The points of the LAZ file cannot be decompressed.",
                    "LASzip data", f"{type(error).__name__}: {error}"[:200])  # fmt: skip
        raise


def _record_batches(file: BinaryIO, layout: LasLayout, path: Path) -> Iterator[NDArray[np.uint8]]:
    """Uncompressed points as bytes (n, point_bytes)."""
    if not layout.count:
        return  # the decompressor would believe a table of chunks that nobody has checked
    file.seek(layout.points_start)
    source: _Records = _Plain(file, layout) if layout.laszip is None else _zipped(
        file, layout, layout.laszip, path
    )  # fmt: skip
    for start in range(0, layout.count, BATCH_POINTS):
        number = min(BATCH_POINTS, layout.count - start)
        data = source.many(number)
        if len(data) != number * layout.point_bytes:
            refused(path, "The LAS file ends before its points do.",
                    f"{layout.count} points", f"about {start}")  # fmt: skip
        yield np.frombuffer(data, np.uint8).reshape(number, layout.point_bytes)


class _Plain:
    def __init__(self, file: BinaryIO, layout: LasLayout) -> None:
        self._file, self._bytes = file, layout.point_bytes

    def many(self, number: int) -> bytes:
        return self._file.read(number * self._bytes)


class _Zipped:
    def __init__(self, file: BinaryIO, layout: LasLayout, laszip: bytes) -> None:
        self._points = lazrs.LasZipDecompressor(file, laszip)
        self._bytes = layout.point_bytes

    def many(self, number: int) -> bytes:
        data = bytearray(number * self._bytes)
        self._points.decompress_many(data)
        return bytes(data)


def _zipped(file: BinaryIO, layout: LasLayout, laszip: bytes, path: Path) -> _Zipped:
    items, layers = _items(laszip, path)
    if items != layout.point_bytes:
        refused(path, "The LAZ file compresses points of another size than it declares.",
                f"{layout.point_bytes} bytes", f"{items} bytes")  # fmt: skip
    _check_chunks(file, layout, laszip, layers, path)
    file.seek(layout.points_start)
    return _Zipped(file, layout, laszip)


def _items(laszip: bytes, path: Path) -> tuple[int, int]:
    """Bytes of a point, and into how many layers its chunks are parted (0: none)."""
    number = struct.unpack_from("<H", laszip, 32)[0] if len(laszip) >= _ITEMS_AT else 0
    if not number or len(laszip) < _ITEMS_AT + 6 * number:
        refused(path, "The LAZ file does not tell how it is compressed.",
                "a LASzip record", f"{len(laszip)} bytes")  # fmt: skip
    items = np.frombuffer(laszip, "<u2", 3 * number, _ITEMS_AT).reshape(-1, 3)
    for kind, size, _ in items.tolist():
        # The decompressor goes by the kind alone, and would take layers for what they are not.
        if size != _ITEM_BYTES.get(kind, size) or kind not in (*_ITEM_BYTES, *_ITEMS_OF_ANY_SIZE):
            refused(path, "The LAZ file compresses an unknown part of points.",
                    "parts as LASzip has them", f"part {kind} of {size} bytes")  # fmt: skip
    layers = 0
    if laszip[:2] == struct.pack("<H", _LAYERED):
        layers = sum(
            int(size) if kind == _BYTES_ITEM else _LAYERS.get(int(kind), 0)
            for kind, size, _ in items
        )
    return int(items[:, 1].sum()), layers


def _check_chunks(
    file: BinaryIO, layout: LasLayout, laszip: bytes, layers: int, path: Path
) -> None:
    """Chunks lie in the file, their layers fill them, and they hold the declared points."""
    start, end = layout.points_start, layout.file_bytes
    file.seek(start)
    table = struct.unpack("<q", _exactly(file, 8, path))[0]
    if table == -1:
        file.seek(end - 8)
        table = struct.unpack("<q", _exactly(file, 8, path))[0]
    if not start + 8 <= table <= end - 8:
        refused(path, "The table of chunks of the LAZ file is not there.",
                f"between byte {start + 8} and {end - 8}", f"byte {table}")  # fmt: skip
    file.seek(table)
    _, number = struct.unpack("<II", _exactly(file, 8, path))
    if (number - 1) * layout.point_bytes > end - start:
        refused(path, "The LAZ file declares more chunks than it can hold.",
                f"at most {(end - start) // layout.point_bytes + 1}", str(number))  # fmt: skip
    file.seek(start)
    chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(laszip))
    at, points = start + 8, 0
    for held, size in chunks:
        if size < 0 or at + size > table or held > _MOST_CHUNK_POINTS:
            refused(path, "A chunk of the LAZ file ends behind the last one.",
                    f"at most byte {table}", f"byte {at + size}")  # fmt: skip
        # The decompressor passes by a chunk without points unless it is the first, and goes on
        # behind the last layer, wherever the table says that the next chunk begins.
        if layers and points < layout.count:
            read = held > 0 or at == start + 8
            layered = _layered_bytes(file, at, layout.point_bytes, layers, path) if read else 0
            if layered != size:
                refused(path, "The layers of a chunk of the LAZ file do not fill it.",
                        f"{size} bytes from byte {at} on", f"{layered} bytes")  # fmt: skip
        at, points = at + size, points + held
    if points < layout.count:
        refused(path, "The LAZ file has fewer points than it declares.",
                f"{layout.count} points", f"{points} points")  # fmt: skip


def _layered_bytes(file: BinaryIO, at: int, point_bytes: int, layers: int, path: Path) -> int:
    """Bytes of a chunk: its first point, how many points it has, and what its layers have."""
    file.seek(at + point_bytes + 4)
    sizes = np.frombuffer(_exactly(file, 4 * layers, path), "<u4")
    return point_bytes + 4 + 4 * layers + int(sizes.sum(dtype=np.int64))


def _exactly(file: BinaryIO, size: int, path: Path) -> bytes:
    data = file.read(size)
    if len(data) != size:
        refused(path, "The LAZ file ends early.", f"{size} more bytes", f"{len(data)}")
    return data


def _column(
    records: NDArray[np.uint8], start: int, dtype: np.dtype[np.generic], n: int = 1
) -> NDArray[np.generic]:
    """Numbers (rows, n) that stand from byte ``start`` of every record on."""
    part = np.ascontiguousarray(records[:, start : start + n * dtype.itemsize])
    return part.view(dtype)


def _white(file: BinaryIO, layout: LasLayout, path: Path) -> int:
    """The value of white: 255 where the whole file has none above it; looks no further."""
    at = COLOR_AT.get(layout.point_format)
    if at is not None:
        for records in _record_batches(file, layout, path):
            if (_column(records, at, np.dtype("<u2"), 3) > 255).any():  # type: ignore[operator]
                return 65535
    return 255


def _point_set(records: NDArray[np.uint8], layout: LasLayout, white: int) -> PointSet:
    whole = _column(records, 0, np.dtype("<i4"), 3)
    color = normals = radius = None
    at = COLOR_AT.get(layout.point_format)
    if at is not None:
        color = eight_bits(_column(records, at, np.dtype("<u2"), 3), white)
    for names in _NORMALS:
        if normals is None and all(name in layout.extra for name in names):
            normals = unit_normals(
                np.stack([_extra(records, layout, name) for name in names], axis=1)
            )
    if _RADIUS in layout.extra:
        with np.errstate(over="ignore"):
            radius = _extra(records, layout, _RADIUS).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        points = whole.astype(np.float64) * layout.scale + layout.offset
    return PointSet(points, normals, color, radius)


def _extra(records: NDArray[np.uint8], layout: LasLayout, name: str) -> NDArray[np.generic]:
    field = layout.extra[name]
    values = _column(records, field.start, field.dtype)[:, 0]
    if (field.scale, field.offset) == (1.0, 0.0):
        return values
    with np.errstate(over="ignore", invalid="ignore"):
        scaled: NDArray[np.float64] = values.astype(np.float64) * field.scale + field.offset
    return scaled
