"""Pictures of encoded voxel graphs: traced, lit by one light, with hard shadows."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.color_png import write_color_png
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.morton import morton_codes
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_file import VoxelGraph, read_voxel_graph
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.screen_normals import screen_normals
from workbench.voxels.tracing import CellHits, VoxelTracer
from workbench.voxels.voxel_set import VoxelGrid

_BACKGROUND = (255, 255, 255, 0)
_STONE = np.array([206, 200, 190], np.uint8)
_AMBIENT = 0.25
# Between the ball in a cube of side 1 and the ball around it: surfaces seldom reach further.
_SEEN_RADIUS = 0.68


@dataclass(frozen=True)
class PictureOptions:
    """How a graph is shown.

    Attributes
    ----------
    detail_px : side in pixels of the finest cell that is looked into; 0 shows every voxel.
    block_px : pixels a side of the blocks whose rays start together; 0 starts each alone.
    shadows : whether points behind others, seen from the light, are dark.
    light : (3,) direction to the light in the camera's frame: x right, y down, z forward.
    """

    detail_px: float = 1.0
    block_px: int = 8
    shadows: bool = True
    light: tuple[float, float, float] = (-0.5, -0.8, -0.7)


@dataclass(frozen=True)
class TracedView:
    """What the pixels of a camera see, rows first.

    Attributes
    ----------
    hits : of the h · w rays.
    directions : (h · w, 3) unit, in the mesh's frame.
    """

    hits: CellHits
    directions: NDArray[np.float64] = field(repr=False)


def camera_around(
    grid: VoxelGrid,
    width: int = 1280,
    height: int = 720,
    *,
    azimuth: float = 30.0,
    elevation: float = 15.0,
    view_angle: float = 35.0,
    up: str = "y",
) -> PhotoCamera:
    """A pinhole camera that sees the cube but for its outermost corners.

    Parameters
    ----------
    grid : the cube.
    width, height : of the picture, pixels.
    azimuth, elevation : where it stands, degrees: around the upward axis, and above the middle.
    view_angle : across the shorter side of the picture, degrees.
    up : ``y`` or ``z``, the axis of the mesh that points up.

    Raises
    ------
    InputError : ``up`` is another axis.
    """
    if up not in ("y", "z"):
        raise InputError(
            "Up is one of two axes.", expected="y or z", found=up, fix="Turn the mesh, or choose."
        )
    around, above = np.radians(azimuth), np.radians(elevation)
    back = np.array([np.sin(around) * np.cos(above), np.sin(above), np.cos(around) * np.cos(above)])
    upward = np.array([0.0, 1.0, 0.0])
    if up == "z":
        back, upward = back[[0, 2, 1]] * [1.0, -1.0, 1.0], np.array([0.0, 0.0, 1.0])
    right = np.cross(upward, back)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, -np.cross(back, right), -back])
    half = np.radians(0.5 * view_angle)
    eye = grid.center + back * (_SEEN_RADIUS * grid.size / np.sin(half))
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = rotation
    camera_from_world[:3, 3] = -rotation @ eye
    focal = 0.5 * min(width, height) / np.tan(half)
    lens = (focal, focal, 0.5 * width, 0.5 * height)
    return PhotoCamera("PINHOLE", width, height, lens, camera_from_world)


def traced_view(tracer: VoxelTracer, camera: PhotoCamera, options: PictureOptions) -> TracedView:
    """What each pixel of a pinhole camera sees; blocks change the time only."""
    columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    directions = camera.directions(pixels.reshape(-1, 2))
    nearest: NDArray[np.float64] | float = 0.0
    if options.block_px:
        nearest = _block_starts(tracer, camera, options.block_px)
    hits = tracer.first_met(
        camera.center,
        directions,
        nearest=nearest,
        slope=options.detail_px / _focal(camera),
    )
    return TracedView(hits, directions)


def picture(
    voxels: VoxelGraph, camera: PhotoCamera, options: PictureOptions | None = None
) -> NDArray[np.uint8]:
    """A shaded picture (h, w, 4), sRGB with alpha: 0 where there is nothing.

    Parameters
    ----------
    voxels
        A graph, with colours or without.
    camera
        A pinhole camera in the mesh's frame.
    options
        See `PictureOptions`.

    Raises
    ------
    InputError
        The graph is broken.
    """
    chosen = options or PictureOptions()
    tracer = VoxelTracer(voxels.graph, voxels.grid)
    view = traced_view(tracer, camera, chosen)
    found = view.hits.found
    image = np.empty((camera.height * camera.width, 4), np.uint8)
    image[:] = _BACKGROUND
    if found.any():
        colors = cell_colors(voxels, view.hits)[found]
        light = _light(tracer, camera, view, chosen)[found]
        linear = (colors / 255.0) ** 2.2 * light[:, None]
        image[found, :3] = np.rint(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2))
        image[found, 3] = 255
    return image.reshape(camera.height, camera.width, 4)


def write_graph_picture(
    graph_path: Path,
    picture_path: Path,
    *,
    camera: PhotoCamera | None = None,
    options: PictureOptions | None = None,
) -> None:
    """Trace a graph's file and write its picture as PNG.

    Parameters
    ----------
    graph_path
        What `workbench.voxels.dag_file.write_voxel_graph` wrote.
    picture_path
        The file to write.
    camera
        Where to look from; `camera_around` the whole where there is none.
    options
        See `PictureOptions`.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    voxels = read_voxel_graph(graph_path)
    seen = picture(voxels, camera or camera_around(voxels.grid), options)
    write_color_png(picture_path, seen)


def cell_colors(voxels: VoxelGraph, hits: CellHits) -> NDArray[np.uint8]:
    """Colours (n, 3) of the cells met, sRGB: the mean of their voxels, or plain stone."""
    colors = np.broadcast_to(_STONE, (len(hits.sizes), 3)).copy()
    found = hits.found
    if voxels.colors is not None and found.any():
        sizes = hits.sizes[found]
        codes = morton_codes(hits.cells[found] // sizes[:, None])
        depths = voxels.graph.level - np.log2(sizes).astype(np.int64)
        first, count = DagWalk(dag_of(voxels.graph)).ranges(codes, depths)
        colors[found] = voxels.colors.mean(first, count)
    return colors


def _focal(camera: PhotoCamera) -> float:
    return min(camera.params[0], camera.params[1])


def _block_starts(tracer: VoxelTracer, camera: PhotoCamera, side: int) -> NDArray[np.float64]:
    """Where the ray of each pixel (h · w,) may start: its block is empty up to there."""
    left, top = (np.arange(0, n, side, dtype=float) for n in (camera.width, camera.height))
    shape = (len(top), len(left))
    # Rays go through the middles of pixels, so that corners bound them with room to spare.
    corners = [
        camera.directions(np.stack(np.meshgrid(left + dx, top + dy), -1).reshape(-1, 2))
        for dx, dy in ((0, 0), (side, 0), (0, side), (side, side))
    ]
    axes = np.sum(corners, axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    cosines = np.min([(axes * corner).sum(axis=1) for corner in corners], axis=0)
    starts = tracer.empty_before(camera.center, axes, np.arccos(np.clip(cosines, -1.0, 1.0)))
    spread = np.repeat(np.repeat(starts.reshape(shape), side, axis=0), side, axis=1)
    return np.ascontiguousarray(spread[: camera.height, : camera.width]).ravel()


def _light(
    tracer: VoxelTracer, camera: PhotoCamera, view: TracedView, options: PictureOptions
) -> NDArray[np.float64]:
    """Brightness (h · w,) in 0 … 1 of what is seen."""
    world_from_camera = camera.camera_from_world[:3, :3].T
    along = view.directions @ camera.camera_from_world[2, :3]
    shape = (camera.height, camera.width)
    normals = screen_normals(
        (view.hits.distance * along).reshape(shape),
        (view.directions / along[:, None]).reshape(*shape, 3),
        (view.hits.sizes.astype(np.float64) * tracer.grid.voxel_size).reshape(shape),
        1.0 / _focal(camera),
    ).reshape(-1, 3)
    to_light = world_from_camera @ np.array(options.light)
    to_light /= np.linalg.norm(to_light)
    lit = np.clip(np.nan_to_num(normals) @ to_light, 0.0, 1.0)
    if options.shadows:
        asked = np.flatnonzero(view.hits.found & (lit > 0.0))
        # Two cells off the surface: its own steps cast no shadow on it.
        off = 2.0 * tracer.grid.voxel_size * view.hits.sizes[asked, None]
        points = camera.center + view.hits.distance[asked, None] * view.directions[asked]
        shadowed = tracer.first_met(
            points + off * normals[asked],
            np.broadcast_to(to_light, (len(asked), 3)),
            slope=0.0,
        )
        lit[asked[shadowed.found]] = 0.0
    return np.asarray(_AMBIENT + (1.0 - _AMBIENT) * lit)
