"""Points of LAS and LAZ files, and of COPC files, which are LAZ files too.

Source: ASPRS, *LAS Specification 1.4 – R15*.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.las_layout import COLOR_AT, LasLayout, las_layout, refused
from workbench.formats.laz_decompression import Records, decompressed
from workbench.formats.point_attributes import eight_bits, unit_normals
from workbench.formats.point_stream import BATCH_POINTS
from workbench.formats.whole_file import require_regular
from workbench.geometry.point_set import PointSet

_NORMALS = (("NormalX", "NormalY", "NormalZ"), ("nx", "ny", "nz"))
_RADIUS = "radius"
_BATCH_BYTES = 64 << 20


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
    most = min(BATCH_POINTS, _BATCH_BYTES // layout.point_bytes)
    with _records(file, layout, path) as source:
        for start in range(0, layout.count, most):
            number = min(most, layout.count - start)
            data = source.many(number)
            if len(data) != number * layout.point_bytes:
                refused(path, "The LAS file ends before its points do.",
                        f"{layout.count} points", f"about {start}")  # fmt: skip
            yield np.frombuffer(data, np.uint8).reshape(number, layout.point_bytes)


def _records(file: BinaryIO, layout: LasLayout, path: Path) -> AbstractContextManager[Records]:
    if layout.laszip is not None:
        return decompressed(file, layout, layout.laszip, path)
    file.seek(layout.points_start)
    return nullcontext(_Plain(file, layout))


class _Plain:
    def __init__(self, file: BinaryIO, layout: LasLayout) -> None:
        self._file, self._bytes = file, layout.point_bytes

    def many(self, number: int) -> bytes:
        return self._file.read(number * self._bytes)


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
