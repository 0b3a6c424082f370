"""Voxels of a surface in any of the formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from workbench.errors import InputError, SettingsError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.voxels.dag_encoding import ENCODINGS, Encoding
from workbench.voxels.graph_export import export_voxel_graph
from workbench.voxels.lod_export import LodOptions, write_voxel_lod
from workbench.voxels.lod_levels import thin_part
from workbench.voxels.voxel_dag import COARSEST_LEVEL
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import VoxelisationOptions, triangle_census, voxel_parts

LOD_FORMAT = "voxels"
VOXEL_FORMATS = (LOD_FORMAT, *ENCODINGS)


def write_surface_voxels(
    mesh: TriangleMesh,
    path: Path,
    voxel_format: str,
    options: LodOptions,
    *,
    texture: SurfaceTexture | None = None,
    compare: bool = False,
) -> dict[str, Any]:
    """Write the voxels of a surface in any of the formats; same surface and options, same bytes.

    Parameters
    ----------
    mesh, texture
        The surface, and the texture that its voxels are coloured by instead of its vertices.
    path
        The file.
    voxel_format
        One of ``VOXEL_FORMATS``.
    options
        See `LodOptions`.
    compare
        Of a graph, tell what the other encodings would take.

    Returns
    -------
    What `write_voxel_lod` or `write_surface_graph` tells; ``voxels`` and ``bytes`` among it.

    Raises
    ------
    InputError
        No surface, or vertices that are not finite.
    SettingsError
        An unknown format, or a resolution it cannot have.
    """
    check_voxel_options(voxel_format, options)
    if voxel_format == LOD_FORMAT:
        return write_voxel_lod(mesh, path, options, texture)
    return write_surface_graph(
        mesh, path, _encoding(voxel_format), options, texture=texture, compare=compare
    )


def check_voxel_options(voxel_format: str, options: LodOptions) -> None:
    """Say what is wrong before a large surface is read.

    Raises
    ------
    SettingsError
        An unknown format, or a resolution it cannot have.
    """
    if voxel_format not in VOXEL_FORMATS:
        raise SettingsError(
            f"There is no voxel format {voxel_format!r}.",
            expected=", ".join(VOXEL_FORMATS),
            fix="choose one of the expected names",
        )
    least = 1 if voxel_format == LOD_FORMAT else COARSEST_LEVEL
    if options.level < least:
        raise SettingsError(
            "The resolution is too small for a sparse voxel graph.",
            expected=f"{1 << least} voxels a side or more",
            found=str(options.resolution),
            fix="ask for a higher resolution, or for voxels",
        )


def write_surface_graph(
    mesh: TriangleMesh,
    path: Path,
    encoding: Encoding,
    options: LodOptions,
    *,
    texture: SurfaceTexture | None = None,
    compare: bool = False,
) -> dict[str, Any]:
    """Write the sparse voxel graph of a surface; same surface and options, same bytes.

    Parameters
    ----------
    mesh, texture
        The surface, and the texture that its voxels are coloured by instead of its vertices.
    path
        The file.
    encoding, compare
        As in `export_voxel_graph`.
    options
        Of them ``resolution``, ``subset``, ``chunk_level`` and ``workers`` count.

    Returns
    -------
    What `export_voxel_graph` tells, ``file``, ``bytes`` and the kinds of triangles.

    Raises
    ------
    InputError
        No surface, or vertices that are not finite.
    """
    grid = grid_of_mesh(mesh.vertices, options.level)
    census = triangle_census(mesh)
    if census.triangles == census.degenerate:
        raise InputError(
            "The mesh has no triangle with area.",
            found=f"{census.triangles} triangles, all degenerate",
            fix="Check the file; there is no surface to cut into voxels.",
        )
    level = options.chunk_level
    parts = voxel_parts(
        mesh, grid, VoxelisationOptions(workers=options.workers), part_level=level, texture=texture
    )
    if options.subset == "thin":
        parts = (thin_part(part, level) for part in parts)
    told = export_voxel_graph(
        parts, grid, path, encoding=encoding, part_level=level, compare=compare
    )
    return {
        **told,
        "file": str(path),
        "bytes": told["file_bytes"],
        "voxel_size": grid.voxel_size,
        "triangles": census.triangles,
        "degenerate_triangles": census.degenerate,
        "duplicate_triangles": census.duplicate,
    }


def _encoding(name: str) -> Encoding:
    """A format's name as that of an encoding."""
    return next(encoding for encoding in ENCODINGS if encoding == name)
