"""The points of any file that has some: clouds, scans, or the vertices of a surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.formats.las_reading import las_batches
from workbench.formats.ply_points import is_streamed, ply_batches
from workbench.formats.point_attributes import unit_normals
from workbench.formats.point_stream import PointStream, slices_of, surveyed
from workbench.formats.potree import METADATA
from workbench.formats.potree_reading import PotreeCloud
from workbench.formats.scans import SCAN_SUFFIXES, read_scans
from workbench.formats.surface_files import SURFACE_SUFFIXES, read_surface
from workbench.geometry.point_set import PointSet, joined
from workbench.geometry.transforms import apply

LAS_SUFFIXES = (".las", ".laz")
POINT_SUFFIXES = tuple(dict.fromkeys((*LAS_SUFFIXES, *SCAN_SUFFIXES, *SURFACE_SUFFIXES)))
"""The extensions of files with points, in lower case; ``.copc.laz`` is one of LAZ."""


def read_points(path: Path) -> PointSet:
    """All points of a cloud, scan or mesh file.

    Parameters
    ----------
    path
        A LAS, LAZ or COPC file; PLY (its vertices); OBJ, GLB or STL (the vertices of the
        surface); a folder of Potree or the ``metadata.json`` inside; E57, PTX, PCD, XYZ,
        PTS, TXT or ASC: the scans inside, each where its pose puts it, one after another,
        without the samples that saw nothing.

    Returns
    -------
    Points in the file's world frame and unit, with the attributes that all of them have.

    Raises
    ------
    InputError
        Another kind of file, one that is absent or damaged, no points, or points that are
        not finite (their number is told).
    """
    stream = point_stream(path)
    return joined(list(stream.batches()))


def point_batches(path: Path) -> Iterator[PointSet]:
    """The same points some at a time; files of LAS, LAZ and binary PLY are never in memory.

    Raises
    ------
    InputError
        As `read_points`, but for points that are not finite, and perhaps amid the points.
    """
    return _batches(Path(path))()


def point_stream(path: Path) -> PointStream:
    """The same points as a stream, which takes one pass over them.

    Raises
    ------
    InputError
        As `read_points`.
    """
    path = Path(path)
    return surveyed(_batches(path), path)


def _batches(path: Path) -> Callable[[], Iterator[PointSet]]:
    suffix = path.suffix.lower()
    if suffix in LAS_SUFFIXES:
        return lambda: las_batches(path)
    if suffix == ".ply":
        if is_streamed(path):
            return lambda: ply_batches(path)
        return slices_of(joined(list(ply_batches(path))))
    if path.name == METADATA or (path / METADATA).is_file():
        return PotreeCloud(path).batches
    whole = _WHOLE.get(suffix)
    if whole is None:
        raise InputError(
            "This kind of file is not read as points.",
            file=path,
            expected=", ".join(POINT_SUFFIXES),
            found=suffix or "no extension",
            fix="Export it to one of these formats.",
        )
    return slices_of(whole(path))


def _of_surface(path: Path) -> PointSet:
    mesh = read_surface(path)
    normals = mesh.vertex_attributes.get("normal")
    color = mesh.vertex_attributes.get("color")
    return PointSet(
        mesh.vertices.astype(np.float64),
        None if normals is None else unit_normals(normals),
        None if color is None else color[:, :3].astype(np.uint8),
    )


def _of_scans(path: Path) -> PointSet:
    parts = []
    for reading in read_scans(path, {}):
        scan = reading.range_map
        points = scan.points_in_scan
        if scan.world_from_scan is not None:
            points = apply(scan.world_from_scan, points)
        parts.append(PointSet(points, None, scan.color))
    return joined(parts)


_WHOLE: Mapping[str, Callable[[Path], PointSet]] = {
    **dict.fromkeys(SCAN_SUFFIXES, _of_scans),
    **dict.fromkeys(SURFACE_SUFFIXES, _of_surface),
}
