"""Any of the workbench's own level-of-detail and point files back as points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from workbench.cloud.point_export import export_points
from workbench.cloud.point_sources import PointSource
from workbench.errors import SettingsError
from workbench.pointcodecs.cube_file import SUFFIX as CUBE_SUFFIX
from workbench.pointcodecs.cube_file import read_point_cubes
from workbench.surfels.surfel_file import SURFEL_SUFFIX, surfel_points
from workbench.voxels.dag_file import SUFFIX as GRAPH_SUFFIX
from workbench.voxels.voxel_points import LOD_SUFFIX, voxel_points, write_voxel_points

_VOXELS = (LOD_SUFFIX, GRAPH_SUFFIX)


def decode(
    path: Path, out: Path, *, level: int | None = None, count: int | None = None
) -> dict[str, Any]:
    """Write the points of a file as PLY, with what is known of each.

    Parameters
    ----------
    path
        A ``.vlod``, ``.voxgraph``, ``.surfels`` or ``.pcube`` file, or any file of points.
    out
        The PLY file.
    level
        Of a ``.vlod``: 2**level voxels a side instead of the finest.
    count
        Of a ``.surfels``: so many of the whole object's instead of the finest.

    Returns
    -------
    ``file``, ``items``, ``unit``, and of voxels ``resolution`` and ``voxel_size``.

    Raises
    ------
    InputError
        The file is none of these, or damaged.
    SettingsError
        An option that this kind of file does not know.
    """
    suffix = path.suffix.lower()
    for name, value, belongs in (
        ("level", level, suffix == LOD_SUFFIX), ("count", count, suffix == SURFEL_SUFFIX),
    ):  # fmt: skip
        if value is not None and not belongs:
            raise SettingsError(
                f"--{name} does not belong to this kind of file",
                file=path,
                expected=LOD_SUFFIX if name == "level" else SURFEL_SUFFIX,
                fix="leave it out",
            )
    if suffix in _VOXELS:
        voxels = voxel_points(path, level)
        write_voxel_points(out, voxels)
        return {
            "file": str(out),
            "items": len(voxels),
            "unit": "voxels",
            "resolution": voxels.grid.resolution,
            "voxel_size": voxels.grid.voxel_size,
        }
    told = export_points(_points(path, suffix, count), out, "ply")
    unit = "surfels" if suffix == SURFEL_SUFFIX else "points"
    return {"file": str(out), "items": told["items"], "unit": unit}


def _points(path: Path, suffix: str, count: int | None) -> PointSource:
    if suffix == SURFEL_SUFFIX:
        return surfel_points(path, count)
    if suffix == CUBE_SUFFIX:
        return read_point_cubes(path).point_set()
    return path
