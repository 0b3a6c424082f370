"""What one photograph's pixels show of the geometry: depth, normals, and the flash's shadows.

Source: Jaspe, section 3.4.5, after Pintus et al. 2011: the geometry is drawn from the camera at
one point a pixel, and all that is asked afterwards is asked of these buffers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import rotate
from workbench.kernels.photo_buffers import interpolated_normals, splat

_ROWS_AT_ONCE = 128
# Discs overlap by so much of the samples' distance, so that no pixel between them is open.
_DISC = 0.75
# Embree computes in float32: a shadow ray starts this much of its length nearer to the flash.
_START = 2e-3
# A step in depth: this many pixels' widths beyond what the slope around foretells.
_STEP_PX = 4.0
# How far from the seen surface a sample may lie to count as seen, pixels' widths along it.
_SEEN_PX = 3.0
_STEEPEST = 0.15


class Block(Protocol):
    """Samples of a surface: some of a mesh's vertices, or a chunk of a cloud."""

    @property
    def first(self) -> int:
        """Number of the first of them."""

    @property
    def points(self) -> NDArray[np.float64]:
        """(n, 3) in the world."""

    @property
    def normals(self) -> NDArray[np.float64]:
        """(n, 3) unit, outwards."""

    @property
    def spacing(self) -> NDArray[np.float64]:
        """(n,) distance to the neighbours."""


@dataclass(frozen=True)
class PlainBlock:
    """Samples in arrays; see `Block`."""

    first: int
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    spacing: NDArray[np.float64]


@dataclass(frozen=True)
class PhotoView:
    """The buffers of one photograph.

    Attributes
    ----------
    camera : of the size of the buffers.
    depth : (h, w) float32 along the camera's axis, infinite where nothing is seen.
    normals : (h, w, 3) float32 in the camera's frame, unit; 0 where nothing is seen.
    slopes : (h, w, 2) float32 right and down per forward, of the rays through pixels' middles.
    """

    camera: PhotoCamera
    depth: NDArray[np.float32]
    normals: NDArray[np.float32]
    slopes: NDArray[np.float32]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(h, w) where the geometry is."""
        return np.asarray(np.isfinite(self.depth))

    @property
    def focal_px(self) -> float:
        """Focal length of the camera, pixels; COLMAP's models all begin with it."""
        return self.camera.params[0]

    @cached_property
    def cosines(self) -> NDArray[np.float32]:
        """(h, w) cosine between the normal and the way to the camera, in [0, 1]."""
        right, down = self.slopes[..., 0], self.slopes[..., 1]
        normals = self.normals
        against = right * normals[..., 0] + down * normals[..., 1] + normals[..., 2]
        length = np.sqrt(1.0 + right**2 + down**2)
        return np.asarray(np.clip(-against / length, 0.0, 1.0), np.float32)

    def places(self, rows: slice) -> NDArray[np.float64]:
        """(r, w, 3) what is seen in some rows, in the camera's frame; NaN where nothing is."""
        depth = np.where(self.seen[rows], self.depth[rows], np.nan).astype(np.float64)
        return np.concatenate([self.slopes[rows] * depth[..., None], depth[..., None]], axis=2)

    def smoothed(self, side_px: int) -> PhotoView:
        """With normals averaged over squares (3.4.5: 5 × 5 pixels); 1 leaves them."""
        if side_px <= 1:
            return self
        mean = np.asarray(
            cv2.blur(self.normals, (side_px, side_px), borderType=cv2.BORDER_REPLICATE), np.float32
        )
        mean /= np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), np.float32(1e-12))
        mean[~self.seen] = 0.0
        return replace(self, normals=mean)

    def steps(self) -> NDArray[np.bool_]:
        """(h, w) pixels at which the depth jumps, on either side of the jump."""
        # On a plane, 1 / depth is linear over a pinhole's picture: what its second difference
        # shows is curvature or a step. Nothing seen is infinitely far, which is a step too.
        nearness = np.where(self.seen, 1.0 / self.depth, np.float32(0.0))
        limit = nearness * np.float32(_STEP_PX / self.focal_px)
        steps = np.zeros(self.depth.shape, bool)
        padded = np.pad(nearness, 1, mode="edge")
        for one, other in (
            (padded[1:-1, :-2], padded[1:-1, 2:]),
            (padded[:-2, 1:-1], padded[2:, 1:-1]),
        ):
            steps |= np.abs(one + other - 2.0 * nearness) > limit
        return steps & self.seen

    def which_are_seen(
        self, pixels: NDArray[np.float64], depths: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(n,) whether samples at pixels (n, 2) and depths (n,) lie on what is seen there."""
        height, width = self.depth.shape
        inside = np.isfinite(pixels).all(axis=1) & (depths > 0.0)
        inside &= ((pixels >= 0.0) & (pixels < [width, height])).all(axis=1)
        seen = np.zeros(len(pixels), bool)
        column, row = pixels[inside].astype(np.int64).T
        surface = self.depth[row, column].astype(np.float64)
        steepness = np.maximum(self.cosines[row, column], _STEEPEST)
        tolerance = _SEEN_PX * depths[inside] / (self.focal_px * steepness)
        seen[inside] = np.abs(depths[inside] - surface) <= tolerance
        return seen


def reduced_camera(camera: PhotoCamera, width: int, height: int) -> PhotoCamera:
    """The same camera with a picture of another size, pixels."""
    if (width, height) == (camera.width, camera.height):
        return camera
    import pycolmap

    lens = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=list(camera.params)
    )
    lens.rescale(width, height)
    return PhotoCamera(camera.model, width, height, tuple(lens.params), camera.camera_from_world)


def within(camera: PhotoCamera, long_side_px: int) -> PhotoCamera:
    """The same camera with a picture whose longer side is at most so many pixels."""
    share = min(1.0, long_side_px / max(camera.width, camera.height))
    sides = (max(1, round(share * side)) for side in (camera.width, camera.height))
    return reduced_camera(camera, *sides)


def view_of_surface(
    rays: SurfaceRays, normals_in_world: NDArray[np.float64], camera: PhotoCamera
) -> PhotoView:
    """What a photograph sees of a mesh, by one ray through the middle of each pixel.

    Parameters
    ----------
    rays : the mesh, made ready.
    normals_in_world : (v, 3) unit, at its vertices.
    """
    mesh = rays.mesh
    view = _empty_view(camera)
    for rows in strips(camera.height):
        slopes = view.slopes[rows].reshape(-1, 2).astype(np.float64)
        directions = np.column_stack([slopes, np.ones(len(slopes))])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        met = rays.first_met(camera.center, directions @ camera.camera_from_world[:3, :3])
        axis = camera.camera_from_world[2]
        depth = met.points @ axis[:3] + axis[3]
        view.depth[rows] = np.where(met.found, depth, np.inf).reshape(view.depth[rows].shape)
        normals = interpolated_normals(
            met.points, met.triangles, mesh.vertices, mesh.triangles, normals_in_world
        )
        turned = rotate(camera.camera_from_world, normals)
        view.normals[rows] = turned.reshape(view.normals[rows].shape)
    return view


def view_of_samples(blocks: Iterable[Block], camera: PhotoCamera) -> PhotoView:
    """What a photograph sees of samples that have no surface, drawn as discs.

    Parameters
    ----------
    blocks : samples about as dense as pixels; denser ones cost time and change nothing.
    """
    view = _empty_view(camera)
    for block in blocks:
        pixels, depths = camera.project(block.points)
        radii = _DISC * block.spacing * view.focal_px / np.maximum(depths, 1e-12)
        radii = np.minimum(radii, max(camera.width, camera.height))
        turned = rotate(camera.camera_from_world, block.normals)
        # A sample that turns its back is the far side of the object, seen through a gap.
        places = (block.points - camera.center) @ camera.camera_from_world[:3, :3].T
        depths = np.where((places * turned).sum(axis=1) < 0.0, depths, -1.0)
        splat(pixels, depths, radii, turned, view.depth, view.normals)
    return view


def lit_by_flash(
    view: PhotoView, rays: SurfaceRays, flash_in_camera: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(h, w) whether what a pixel shows gets light from the flash: neither hidden nor turned away.

    True where nothing is seen.

    Parameters
    ----------
    view : of the mesh.
    flash_in_camera : (3,) middle of the flash.

    Raises
    ------
    InputError : the flash is not a finite point.
    """
    flash = np.asarray(flash_in_camera, np.float64)
    if flash.shape != (3,) or not np.isfinite(flash).all():
        raise InputError("shadows need the place of the flash", found=str(flash_in_camera))
    camera = view.camera
    lit = np.ones(view.depth.shape, bool)
    to_world = camera.camera_from_world[:3, :3]
    for rows in strips(camera.height):
        seen = view.seen[rows]
        places = view.places(rows)[seen]
        way = flash - places
        distance = np.linalg.norm(way, axis=1)
        facing = (way * view.normals[rows][seen]).sum(axis=1) > 0.0
        # From the flash to the place: the first thing met is the place itself where it is lit.
        directions = -way / np.maximum(distance, 1e-12)[:, None]
        met = rays.first_met(camera.center + flash @ to_world, directions @ to_world)
        reached = np.linalg.norm(met.points - (camera.center + flash @ to_world), axis=1)
        hidden = reached < distance * (1.0 - _START)
        lit[rows][seen] = facing & ~hidden
    return lit


def strips(height: int) -> Iterator[slice]:
    """Rows of a picture, some at a time: memory grows with its width alone."""
    for top in range(0, height, _ROWS_AT_ONCE):
        yield slice(top, min(top + _ROWS_AT_ONCE, height))


def _empty_view(camera: PhotoCamera) -> PhotoView:
    shape = (camera.height, camera.width)
    slopes = np.empty((*shape, 2), np.float32)
    for rows in strips(camera.height):
        columns, lines = np.arange(camera.width) + 0.5, np.arange(rows.start, rows.stop) + 0.5
        pixels = np.stack(np.meshgrid(columns, lines), axis=-1).reshape(-1, 2)
        ways = rotate(camera.camera_from_world, camera.directions(pixels))
        slopes[rows] = (ways[:, :2] / ways[:, 2:]).reshape(len(lines), camera.width, 2)
    return PhotoView(
        camera, np.full(shape, np.inf, np.float32), np.zeros((*shape, 3), np.float32), slopes
    )
