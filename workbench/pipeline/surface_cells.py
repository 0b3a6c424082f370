"""A surface as the cells it fills."""

from __future__ import annotations

import numpy as np

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.pointcodecs.point_cells import CellFrame, PointCells
from workbench.voxels.lod_export import LodOptions
from workbench.voxels.lod_levels import thin_part
from workbench.voxels.voxel_set import grid_of_mesh, joined_voxels
from workbench.voxels.voxelisation import VoxelisationOptions, voxel_parts


def surface_cells(
    mesh: TriangleMesh, resolution: int, texture: SurfaceTexture | None = None, workers: int = 1
) -> PointCells:
    """The thinnest set of voxels that leaves no hole: what a scan of the surface would fill.

    Parameters
    ----------
    mesh, texture : the surface, and the texture that colours it instead of its vertices.
    resolution : cells along the side of the cube around it, a power of two.
    workers : threads; they change nothing.

    Raises
    ------
    SettingsError
        A resolution that cannot be.
    InputError
        No surface, or vertices that are not finite.
    """
    level = LodOptions(resolution=resolution).level
    grid = grid_of_mesh(mesh.vertices, level)
    part_level = min(8, level)
    options = VoxelisationOptions(workers=workers)
    parts = voxel_parts(mesh, grid, options, part_level=part_level, texture=texture)
    voxels = joined_voxels([thin_part(part, part_level) for part in parts])
    return PointCells(
        CellFrame(grid.origin, grid.voxel_size, level),
        voxels.cells.astype(np.int32),
        voxels.normal.astype(np.float32),
        voxels.color,
        0,
    )
