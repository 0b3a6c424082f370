"""Pictures of voxels and of voxel graphs, as the page draws and lights them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.formats.gltf import encoded_from_linear, srgb_from_linear
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.depth_planes import plane_normals
from workbench.kernels.morton import morton_codes
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.viewer.page_light import PLAIN, Light, lit
from workbench.viewer.surface_pictures import surface_picture
from workbench.voxels.dag_file import VoxelGraph
from workbench.voxels.graph_pictures import (
    PictureOptions,
    TracedView,
    cell_colors,
    traced_view,
)
from workbench.voxels.tracing import CellHits, VoxelTracer
from workbench.voxels.voxel_points import voxel_points

DETAIL_PX = 1.0
# Rays along each side of a pixel.
_SIDE = 2


def graph_picture(
    voxels: VoxelGraph, camera: PhotoCamera, light: Light = "camera", detail_px: float = DETAIL_PX
) -> NDArray[np.uint8]:
    """What a camera sees of a voxel graph, (h, w, 4) uint8 sRGB; alpha 0 where nothing is.

    A ray for each pixel, with normals of the depths around, as in Jaspe 2018, 5.5.2, but fitted.

    Parameters
    ----------
    voxels
        With colours or without.
    camera
        A pinhole camera in the mesh's frame.
    light
        See `page_light.lit`.
    detail_px
        Side of the finest cells that are looked into, pixels.

    Raises
    ------
    InputError
        The graph is broken.
    """
    tracer = VoxelTracer(voxels.graph, voxels.grid)
    view = traced_view(tracer, camera, PictureOptions(detail_px=detail_px))
    found = view.hits.found
    picture = np.zeros((camera.height * camera.width, 4), np.uint8)
    if found.any():
        albedo = np.full((int(found.sum()), 3), PLAIN)
        if voxels.colors is not None:
            albedo = LINEAR_OF_BYTE[cell_colors(voxels, view.hits)[found]]
        normals = _plane_normals(view, camera, voxels.grid.voxel_size)[found]
        picture[found, :3] = srgb_from_linear(lit(albedo, normals, view.directions[found], light))
        picture[found, 3] = 255
    return picture.reshape(camera.height, camera.width, 4)


def _plane_normals(view: TracedView, camera: PhotoCamera, voxel: float) -> NDArray[np.float64]:
    """Normals (h · w, 3) of the planes that depths around each pixel lie in."""
    shape = (camera.height, camera.width)
    depths = view.hits.distance * (view.directions @ camera.camera_from_world[2, :3])
    inverse = np.where(view.hits.found, 1.0 / depths, 0.0).reshape(shape)
    normals = np.empty((*shape, 3))
    fx, fy, cx, cy = camera.params
    plane_normals(inverse, voxel * view.hits.sizes.reshape(shape), (fx, fy, cx, cy), normals)
    return normals.reshape(-1, 3) @ camera.camera_from_world[:3, :3]


def voxel_picture(
    path: Path,
    surface: TriangleMesh | None,
    camera: PhotoCamera,
    light: Light = "camera",
    detail_px: float = DETAIL_PX,
) -> NDArray[np.uint8]:
    """What a camera sees of voxels in levels, (h, w, 4) uint8 sRGB; alpha is the share covered.

    Parameters
    ----------
    path
        A ``.vlod`` file.
    surface
        What the voxels were made of, shown wherever the finest are larger than ``detail_px``;
        None shows voxels there, too.
    camera
        A pinhole camera in its frame.
    light
        See `page_light.lit`.
    detail_px
        Side of the finest voxels that are looked into, pixels.

    Raises
    ------
    InputError
        The file is damaged.
    """
    fine = _finer(camera)
    finest = voxel_points(path).graph()
    tracer = VoxelTracer(finest.graph, finest.grid)
    options = PictureOptions(detail_px=detail_px * _SIDE)
    view = traced_view(tracer, fine, options)
    found = view.hits.found
    values = np.zeros((len(found), 4))
    if found.any():
        albedo, normals = _told(path, view.hits, found)
        linear = lit(albedo, normals, view.directions[found], light)
        values[found] = np.column_stack([encoded_from_linear(linear), np.ones(len(linear))])
    sums = values.reshape(camera.height, _SIDE, camera.width, _SIDE, 4).sum(axis=(1, 3))
    picture = np.empty((camera.height, camera.width, 4), np.uint8)
    picture[..., :3] = np.rint(255.0 * sums[..., :3] / np.maximum(sums[..., 3:], 1.0))
    picture[..., 3] = np.rint(255.0 * sums[..., 3] / _SIDE**2)
    if surface is None:
        return picture
    # Voxels are chosen by how far off they are; a pixel shows the surface if any of it is near.
    voxel = finest.grid.voxel_size * fine.params[0] / _SIDE
    near = (voxel > detail_px * view.hits.distance).reshape(fine.height, fine.width)
    close = near.reshape(camera.height, _SIDE, camera.width, _SIDE).any(axis=(1, 3))
    if close.any():
        around = close | ~(picture[..., 3] == 255)
        picture[around] = surface_picture(surface, None, camera, light)[around]
    return picture


def _finer(camera: PhotoCamera) -> PhotoCamera:
    """The same view with more pixels."""
    lens = tuple(_SIDE * value for value in camera.params)
    return replace(camera, width=_SIDE * camera.width, height=_SIDE * camera.height, params=lens)


def _told(
    path: Path, hits: CellHits, found: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Linear colours and normals (n, 3) that the file has of the cells met."""
    cells, sizes = hits.cells[found], hits.sizes[found]
    albedo, normals = np.full(cells.shape, PLAIN), np.zeros(cells.shape)
    finest = voxel_points(path).grid.level
    for size in np.unique(sizes):
        which = sizes == size
        level = voxel_points(path, finest - int(size).bit_length() + 1)
        rows = np.searchsorted(level.codes, morton_codes(cells[which] // size))
        if level.color is not None:
            albedo[which] = LINEAR_OF_BYTE[level.color[rows]]
        if level.normal is not None:
            normals[which] = level.normal[rows]
    return albedo, normals
