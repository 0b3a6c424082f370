"""Points packed for a stay on disk: whole coordinates, and attributes as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.point_rounding import Rounding
from workbench.geometry.point_set import PointSet

Rows = NDArray[np.void]
RowSource = Callable[[], Iterator[Rows]]

_READ_ROWS = 1 << 18
_FIELDS: dict[str, tuple[Any, ...]] = {
    "normals": ("<f4", (3,)), "radius": ("<f4",), "color": ("u1", (3,)),
}  # fmt: skip


def row_type(attributes: frozenset[str]) -> np.dtype[np.void]:
    """A record ``whole`` (3,) int32 and one field per attribute, without gaps."""
    fields = [(name, *kind) for name, kind in _FIELDS.items() if name in attributes]
    return np.dtype([("whole", "<i4", (3,)), *fields])


def packed(points: PointSet, rounding: Rounding, dtype: np.dtype[np.void]) -> Rows:
    """Records (n,) of points."""
    rows = np.empty(len(points), dtype)
    rows["whole"] = rounding.whole(points.points)
    for name in (dtype.names or ())[1:]:
        rows[name] = getattr(points, name)
    return rows


def unpacked(rows: Rows, rounding: Rounding) -> tuple[NDArray[np.int32], PointSet]:
    """Whole coordinates (n, 3) and points (rounded) of records."""
    whole = np.ascontiguousarray(rows["whole"])
    attributes = {name: np.ascontiguousarray(rows[name]) for name in (rows.dtype.names or ())[1:]}
    return whole, PointSet(rounding.coordinates(whole), **attributes)


def rows_of_file(path: Path, dtype: np.dtype[np.void], start: int, count: int) -> RowSource:
    """Records ``start`` to ``start + count`` of a file of nothing else, some at a time."""

    def rows() -> Iterator[Rows]:
        with open(path, "rb") as file:
            file.seek(start * dtype.itemsize)
            for first in range(0, count, _READ_ROWS):
                yield np.fromfile(file, dtype, min(_READ_ROWS, count - first))

    return rows
