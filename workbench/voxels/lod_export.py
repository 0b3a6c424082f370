"""A mesh file and options in, a voxel level-of-detail file and its figures out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.voxels.lod_file import LodFileOptions, write_lod_file
from workbench.voxels.lod_levels import CHUNK_LEVEL, LodChunk, lod_chunks, thin_part
from workbench.voxels.voxel_set import VoxelGrid, VoxelSet, grid_of_mesh
from workbench.voxels.voxelisation import (
    FINEST_LEVEL,
    VoxelisationOptions,
    surface_parts,
    triangle_census,
)

LOD_FILE_NAME = "voxels.vlod"


@dataclass(frozen=True)
class LodOptions:
    """How a mesh becomes a voxel level-of-detail file.

    Attributes
    ----------
    resolution : voxels along the side of the finest level, a power of two.
    subset : ``thin`` keeps the 6-separating voxels and features too thin for them,
        ``conservative`` every voxel the surface touches, about twice as many.
    shell : show faces both ways, for models that one can enter.
    geometry : keep the original surface of every chunk of the finest level, for close-ups.
    compressed : compress each chunk with zstd.
    face_color_step : sRGB bytes between faces of a voxel from which each keeps its own.
    chunk_level : chunks are cubes of 2**chunk_level voxels a side, at most 8.
    workers : threads; they do not change the file.
    """

    resolution: int = 2048
    subset: Literal["thin", "conservative"] = "thin"
    shell: bool = False
    geometry: bool = True
    compressed: bool = True
    face_color_step: int = 24
    chunk_level: int = CHUNK_LEVEL
    workers: int = 1

    @property
    def level(self) -> int:
        """The level of the finest grid.

        Raises
        ------
        SettingsError
            The resolution is no power of two, or out of bounds.
        """
        level = self.resolution.bit_length() - 1
        if self.resolution != 1 << max(level, 0) or not 1 <= level <= FINEST_LEVEL:
            raise SettingsError(
                "The resolution of a voxel export is not one of those it can have.",
                expected=f"a power of two from 2 to {1 << FINEST_LEVEL}",
                found=str(self.resolution),
                fix="Set resolution to such a number, e.g. 2048.",
            )
        return level


def export_voxel_lod(
    mesh_path: Path, out: Path, options: LodOptions | None = None
) -> dict[str, Any]:
    """Write ``voxels.vlod`` of a mesh file to a folder.

    Parameters
    ----------
    mesh_path
        PLY, OBJ, GLB or STL.
    out
        The folder, made where it is missing.
    options
        See `LodOptions`.

    Returns
    -------
    Figures of the file, as `write_voxel_lod` returns them.
    """
    chosen = options or LodOptions()
    # Before a large mesh is read: a wrong option should not take minutes to be told.
    _ = chosen.level
    mesh = read_surface(mesh_path)
    out.mkdir(parents=True, exist_ok=True)
    return write_voxel_lod(mesh, out / LOD_FILE_NAME, chosen)


def write_voxel_lod(
    mesh: TriangleMesh, path: Path, options: LodOptions, texture: SurfaceTexture | None = None
) -> dict[str, Any]:
    """Write the voxel level-of-detail file of a mesh; same mesh and options, same bytes.

    Parameters
    ----------
    mesh
        The surface; with the attribute ``color`` the file has colours.
    path
        The file.
    options
        See `LodOptions`.
    texture
        Of the mesh, which then must have ``color``, too: that is what the original surface kept
        in the file is coloured by.

    Returns
    -------
    ``file``, ``resolution``, ``voxel_size`` (unit of the mesh), ``voxels`` (finest level),
    ``voxels_of_all_levels``, ``chunks``, ``levels``, ``voxels_with_sides``, ``bytes`` (whole
    file), ``voxel_bytes`` and ``geometry_bytes`` (in the file), ``bytes_per_voxel`` (of the
    finest level, all levels included), ``triangles``, ``degenerate_triangles`` and
    ``duplicate_triangles``.

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
    file_options = LodFileOptions(
        chunk_level=options.chunk_level,
        compressed=options.compressed,
        colored="color" in mesh.vertex_attributes,
        geometry=options.geometry,
        thin=options.subset == "thin",
    )
    nodes = write_lod_file(path, grid, _chunks(mesh, grid, options, texture), file_options)
    return _figures(path, grid, nodes) | {
        "triangles": census.triangles,
        "degenerate_triangles": census.degenerate,
        "duplicate_triangles": census.duplicate,
    }


def _chunks(
    mesh: TriangleMesh, grid: VoxelGrid, options: LodOptions, texture: SurfaceTexture | None
) -> Iterator[tuple[LodChunk, TriangleMesh | None]]:
    """All chunks, those of the finest level with the surface that touches them."""
    triangles: dict[int, NDArray[np.int32]] = {}

    def parts() -> Iterator[VoxelSet]:
        voxelisation = VoxelisationOptions(
            shell=options.shell,
            face_color_step=options.face_color_step,
            workers=options.workers,
        )
        level = options.chunk_level
        for part in surface_parts(mesh, grid, voxelisation, part_level=level, texture=texture):
            voxels = part.voxels
            if options.subset == "thin":
                voxels = thin_part(voxels, level)
            if options.geometry and len(voxels):
                triangles[int(voxels.codes[0]) >> 3 * level] = part.triangles()
            yield voxels

    for chunk in lod_chunks(
        parts(), chunk_level=options.chunk_level, face_color_step=options.face_color_step
    ):
        chosen = triangles.pop(chunk.number, None) if chunk.level == grid.level else None
        yield chunk, None if chosen is None else _surface_of(mesh, chosen)


def _surface_of(mesh: TriangleMesh, chosen: NDArray[np.int32]) -> TriangleMesh:
    """Some triangles of a mesh and the vertices they use, in time that goes by them alone."""
    used, index = np.unique(mesh.triangles[chosen], return_inverse=True)
    attributes = mesh.vertex_attributes
    return TriangleMesh(
        mesh.vertices[used],
        index.reshape(-1, 3).astype(np.int32),
        {"color": attributes["color"][used]} if "color" in attributes else {},
    )


def _figures(path: Path, grid: VoxelGrid, nodes: NDArray[np.void]) -> dict[str, Any]:
    finest = nodes[nodes["level"] == grid.level]
    voxels = int(finest["voxels"].sum(dtype=np.int64))
    voxel_bytes = int(nodes["stored"].sum(dtype=np.int64))
    return {
        "file": str(path),
        "resolution": grid.resolution,
        "voxel_size": grid.voxel_size,
        "voxels": voxels,
        "voxels_of_all_levels": int(nodes["voxels"].sum(dtype=np.int64)),
        "chunks": len(nodes),
        "levels": len(np.unique(nodes["level"])),
        "voxels_with_sides": int(finest["sided"].sum(dtype=np.int64)),
        "bytes": path.stat().st_size,
        "voxel_bytes": voxel_bytes,
        "geometry_bytes": int(nodes["geometry_stored"].sum(dtype=np.int64)),
        "bytes_per_voxel": voxel_bytes / voxels,
    }
