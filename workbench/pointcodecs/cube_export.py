"""Points written as a file of point cubes, and what that cost them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError
from workbench.geometry.point_set import PointSet
from workbench.pointcodecs.codecs import codec_named
from workbench.pointcodecs.cube_file import SUFFIX, write_point_cubes
from workbench.pointcodecs.point_cells import (
    CellFrame,
    cells_of_points,
    frame_of_cell_size,
    frame_of_resolution,
)

_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class CubeOptions:
    """How points become cubes.

    Attributes
    ----------
    codec : ``ci``, ``eci`` or ``context``.
    resolution : cells along the longest side of the points' bounds; None where the size of a
        cell is given.
    cell_size : in the unit of the points, or None.
    """

    codec: str = "context"
    resolution: int | None = 1024
    cell_size: float | None = None


def export_point_cubes(
    points: PointSet, path: Path, options: CubeOptions | None = None
) -> dict[str, float]:
    """Write points as occupied cells, with their colours and normals.

    Parameters
    ----------
    points
        At least one.
    path
        The file to write, ``.pcube``.
    options
        See `CubeOptions`.

    Returns
    -------
    What `write_point_cubes` tells, and ``given``, the points before those of one cell became
    one; ``merged``, how many that made fewer; ``cell_size``; ``rms_move`` and
    ``largest_move``, distances from points to the middles of their cells. Lengths are in the
    unit of the points.

    Raises
    ------
    SettingsError
        Neither a resolution nor the size of a cell, or both, one out of bounds, no such codec,
        or another suffix.
    InputError
        No points, points that are not finite, or all in one place where a resolution is given.
    """
    chosen = options or CubeOptions()
    codec_named(chosen.codec)
    if Path(path).suffix != SUFFIX:
        raise SettingsError(
            "The file of point cubes has another suffix.",
            file=path,
            expected=SUFFIX,
            found=Path(path).suffix or "none",
            fix=f"name it {Path(path).with_suffix(SUFFIX).name}",
        )
    frame = _frame(points.points, chosen)
    cells = cells_of_points(points, frame)
    figures = write_point_cubes(path, cells, chosen.codec)
    mean, largest = _moves(points.points, frame)
    return figures | {
        "given": len(points),
        "merged": cells.merged,
        "cell_size": frame.cell_size,
        "rms_move": mean,
        "largest_move": largest,
    }


def _frame(points: NDArray[np.float64], options: CubeOptions) -> CellFrame:
    if options.cell_size is not None and options.resolution is None:
        return frame_of_cell_size(points, options.cell_size)
    if options.resolution is not None and options.cell_size is None:
        return frame_of_resolution(points, options.resolution)
    raise SettingsError(
        "Cells are told by a resolution or by their size.",
        expected="one of the two",
        found="both" if options.resolution is not None else "neither",
        fix="give one of them",
    )


def _moves(points: NDArray[np.float64], frame: CellFrame) -> tuple[float, float]:
    """Root mean square and largest of the distances to the middles of cells."""
    total, largest = 0.0, 0.0
    for start in range(0, len(points), _AT_ONCE):
        places = (points[start : start + _AT_ONCE] - frame.origin) / frame.cell_size
        square = ((places - np.floor(places) - 0.5) ** 2).sum(axis=1)
        total, largest = total + float(square.sum()), max(largest, float(square.max()))
    return frame.cell_size * (total / len(points)) ** 0.5, frame.cell_size * largest**0.5
