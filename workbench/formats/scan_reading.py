"""A range map as it came out of a file, and what was left out on the way."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import Matrix4

_FARTHEST = 1e12
"""No scanner measures this far in any unit; files use such numbers to say "no return"."""

_MOST_CELLS_PER_POINT = 64
_ALWAYS_ALLOWED_CELLS = 1 << 20


@dataclass(frozen=True)
class ScanReading:
    """One scan of a file.

    Attributes
    ----------
    range_map : the scan.
    dropped_nonfinite : samples left out because a coordinate was NaN, infinite or beyond
        10¹². Cells of a grid without a return are not counted.
    notes : what a user should know about how the file was read, in plain words.
    """

    range_map: RangeMap
    dropped_nonfinite: int = 0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class GridCells:
    """Where the samples stand in the scanner's grid: ``row`` and ``column`` (n,) int64.

    The grid starts at the smallest row and column that occur.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]


def sanitised_name(text: str) -> str:
    """``text`` with everything but letters, digits, ``.``, ``_`` and ``-`` replaced.

    >>> sanitised_name("Büste 01 (links)")
    'B_ste_01__links_'
    """
    return re.sub(r"[^A-Za-z0-9._-]", "_", text).lstrip(".-") or "scan"


def assumed_viewpoint(points: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The scan's origin, unless it lies inside the bounding box of the points (n, 3).

    A scanner is the origin of its own frame, but a file whose points surround the origin was
    moved to another frame, and then nothing is known.
    """
    if (points.min(axis=0) <= 0).all() and (points.max(axis=0) >= 0).all():
        return None
    return np.zeros(3)


def eight_bit_color(
    red: NDArray[np.generic], green: NDArray[np.generic], blue: NDArray[np.generic]
) -> NDArray[np.uint8]:
    """(n, 3) uint8 from three columns: floats are in 0…1, 16-bit integers in 0…65535."""
    color = np.stack([red, green, blue], axis=1)
    if color.dtype == np.uint8:
        return color.astype(np.uint8)
    values = np.nan_to_num(color.astype(np.float64), nan=0.0)
    if color.dtype.kind == "f" and values.max(initial=0) <= 1:
        values *= 255
    elif values.max(initial=0) > 255:
        values *= 255 / 65535
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def scan_reading(
    path: Path,
    name: str,
    points: NDArray[np.floating],
    *,
    grid: NDArray[np.int32] | None = None,
    cells: GridCells | None = None,
    viewpoint: NDArray[np.float64] | None = None,
    viewpoint_known: bool = False,
    reflectance: NDArray[np.generic] | None = None,
    color: NDArray[np.uint8] | None = None,
    world_from_scan: Matrix4 | None = None,
    holes_are_expected: bool = False,
    notes: Sequence[str] = (),
) -> ScanReading:
    """Make a scan of what a file says; samples without usable coordinates are left out.

    Parameters
    ----------
    path
        The file, for messages.
    name
        Name of the range map before it is sanitised.
    points
        (n, 3), scan frame, unit of the file; may hold NaN.
    grid
        (rows, cols) int32 indices into ``points``, −1 for nothing, where the file has one.
    cells
        Grid cells of the points, where the file has those instead; where two points share
        one, the first has it.
    viewpoint, viewpoint_known
        (3,) scan frame; without ``viewpoint_known`` `assumed_viewpoint` is taken.
    reflectance
        (n,), any number type.
    color
        (n, 3) sRGB.
    world_from_scan
        4×4, or None when the file has none.
    holes_are_expected
        NaN is how the format says "no return here", so it is no loss to report.
    notes
        Passed on.

    Raises
    ------
    InputError
        No sample is left.
    """
    notes = list(notes)
    if not len(points):
        raise InputError(
            f"The scan '{name}' has no points.", file=path, fix="Export it again, or leave it out."
        )
    coordinates = points.astype(np.float64, copy=False)
    usable: NDArray[np.bool_] = np.all(np.abs(coordinates) < _FARTHEST, axis=1)
    kept = int(usable.sum())
    if not kept:
        raise InputError(
            f"None of the {len(points)} points of the scan '{name}' has finite coordinates.",
            file=path,
            fix="Export it again, or leave it out.",
        )
    values = None if reflectance is None else _reflectance(reflectance, notes)
    everything = RangeMap(
        sanitised_name(name), coordinates, grid, None, values, color, world_from_scan
    )
    range_map = everything if usable.all() else everything.subset(usable)
    if cells is not None:
        range_map = replace(range_map, grid=_grid(cells, usable, kept, notes))
    if not viewpoint_known:
        viewpoint = assumed_viewpoint(range_map.points_in_scan)
    range_map = replace(range_map, viewpoint_in_scan=viewpoint)
    dropped = 0 if holes_are_expected else len(usable) - kept
    if dropped:
        notes.append(f"{dropped} samples without finite coordinates were left out")
    return ScanReading(range_map, dropped, tuple(notes))


def _reflectance(values: NDArray[np.generic], notes: list[str]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    lost = int((~np.isfinite(single)).sum())
    if lost:
        notes.append(f"{lost} samples have no finite reflectance")
    return single


def _grid(
    cells: GridCells, usable: NDArray[np.bool_], kept: int, notes: list[str]
) -> NDArray[np.int32] | None:
    row, column = cells.row[usable], cells.column[usable]
    row, column = row - row.min(), column - column.min()
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    if shape[0] * shape[1] > max(_ALWAYS_ALLOWED_CELLS, _MOST_CELLS_PER_POINT * kept):
        notes.append(
            f"the grid of {shape[0]} × {shape[1]} cells is too large for {kept} points and was "
            "left out"
        )
        return None
    grid = np.full(shape, -1, np.int32)
    # Backwards, so that of several samples in one cell the first is what remains.
    grid[row[::-1], column[::-1]] = np.arange(kept - 1, -1, -1, dtype=np.int32)
    shared = kept - int((grid >= 0).sum())
    if shared:
        notes.append(f"{shared} samples share a grid cell with an earlier one and are off the grid")
    return grid
