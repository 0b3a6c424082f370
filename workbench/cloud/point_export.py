"""Points of any source into files of the kinds that others read."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from workbench.cloud.building import build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.point_octree import MEMORY_BYTES, StreamedOctree
from workbench.cloud.point_sources import PointSource, StreamBlocks, cloud_schema, open_points
from workbench.errors import InputError, SettingsError
from workbench.formats.copc import write_copc
from workbench.formats.e57_writing import write_e57_points
from workbench.formats.las_writing import write_las
from workbench.formats.octree_nodes import PointOctree
from workbench.formats.ply_points import write_ply_points
from workbench.formats.point_stream import PointStream
from workbench.formats.potree import write_potree
from workbench.geometry.point_set import PointSet

PointFormat = Literal["las", "laz", "copc", "potree", "ply", "e57", "layered"]
POINT_FORMATS: tuple[str, ...] = get_args(PointFormat)
ROUNDED_FORMATS = ("las", "laz", "copc", "potree")
"""Those that keep coordinates as whole numbers, and take a precision."""


def export_points(
    source: PointSource,
    path: Path,
    file_format: str,
    *,
    precision: float | None = None,
    memory_bytes: int = MEMORY_BYTES,
) -> dict[str, Any]:
    """Write the points of a source; same points and options, same bytes.

    Parameters
    ----------
    source
        As `open_points` takes it. Layered clouds, LAS, LAZ, COPC and binary PLY are never in
        memory as a whole.
    path
        The file to write, for ``potree`` a folder; whole or not there.
    file_format
        ``las``, ``laz``; ``copc``, ``potree`` (octrees, coarse to fine); ``ply``, ``e57``;
        ``layered``, a layered cloud.
    precision
        Step of coordinates for `ROUNDED_FORMATS`, in the unit of the points; by default that
        of `rounding_of`. The others keep every bit.
    memory_bytes
        Bound of the working memory of octrees and layered clouds; the others need some
        hundred megabytes at most.

    Returns
    -------
    ``format``, ``file``, ``items`` (points), ``bytes``, ``bits_per_item``,
    ``attributes`` that were written, ``left_out`` (those that the format has no place for),
    ``rounding_error`` (coordinates are off by that much at most); ``precision`` where it is a
    setting; ``levels`` and ``nodes`` of octrees and layered clouds.

    Raises
    ------
    SettingsError
        An unknown format, or a precision that does not fit.
    InputError
        No points, points that are not finite, a file that cannot be read or written.
    """
    path = Path(path)
    write = _WRITERS.get(file_format)
    if write is None:
        raise SettingsError(
            "This is no format for points.",
            expected=", ".join(POINT_FORMATS),
            found=file_format,
        )
    if precision is not None and file_format not in ROUNDED_FORMATS:
        raise SettingsError(
            "A precision makes no sense for this format: it keeps every bit of coordinates.",
            expected=", ".join(ROUNDED_FORMATS),
            found=file_format,
            fix="Leave the precision out, or choose another format.",
        )
    _check_places(source, path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_points(source) as stream:
        told = write(path, stream, precision, memory_bytes)
        left_out = told.pop("left_out", [])
        return {
            "format": file_format,
            "file": str(path),
            "items": stream.count,
            "bytes": told["bytes"],
            "bits_per_item": 8 * told["bytes"] / stream.count,
            "attributes": sorted(stream.attributes - set(left_out)),
            "left_out": left_out,
        } | told


def _check_places(source: PointSource, path: Path) -> None:
    read = source.path if isinstance(source, LayeredCloud) else source
    if isinstance(read, PointSet | PointStream):
        return
    if Path(read).resolve() == path.resolve():
        raise InputError(
            "The points would be written over what they are read from.",
            file=path,
            fix="Choose another name for the new file.",
        )


def _octree(
    write: Callable[[Path, PointOctree], dict[str, Any]],
    path: Path,
    stream: PointStream,
    precision: float | None,
    memory_bytes: int,
) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        return write(
            path,
            StreamedOctree(stream, Path(folder), precision=precision, memory_bytes=memory_bytes),
        )


def _layered(
    path: Path, stream: PointStream, precision: float | None, memory_bytes: int
) -> dict[str, Any]:
    built = build_cloud(
        path, StreamBlocks(stream), cloud_schema(stream.attributes), memory_bytes=memory_bytes
    )
    return {
        "bytes": built.file_bytes,
        "rounding_error": 0.0,
        "nodes": built.chunks,
        "levels": built.levels,
    }


_Writer = Callable[[Path, PointStream, float | None, int], dict[str, Any]]
_WRITERS: Mapping[str, _Writer] = {
    "las": lambda path, stream, precision, _: write_las(
        path, stream, precision=precision, compressed=False
    ),
    "laz": lambda path, stream, precision, _: write_las(path, stream, precision=precision),
    "copc": partial(_octree, write_copc),
    "potree": partial(_octree, write_potree),
    "ply": lambda path, stream, _precision, _: write_ply_points(path, stream),
    "e57": lambda path, stream, _precision, _: write_e57_points(path, stream),
    "layered": _layered,
}
