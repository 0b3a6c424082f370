"""A painted ball in a flash's light, photographed from all round: in closed form, no mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from workbench.color.blending_colors import Colored, corrected
from workbench.color.blending_observations import Observations, observed, weighed_photo
from workbench.color.blending_samples import blocks_of_mesh
from workbench.color.blending_weights import WeightOptions, feathered, pixel_weights
from workbench.color.flash_light import FlashLight
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import PhotoView, lit_by_flash, view_of_surface
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import rigid

RADIUS, DISTANCE = 0.3, 1.5
FLASH = FlashLight(np.array([-0.12, -0.05, 0.01]), reference_distance=DISTANCE, epsilon=0.0)


def ball(subdivisions: int = 5, middle=(0.0, 0.0, 0.0)) -> TriangleMesh:
    """With exact normals."""
    solid = trimesh.creation.icosphere(subdivisions)
    way = np.asarray(solid.vertices)
    return TriangleMesh(
        RADIUS * way + middle, np.asarray(solid.faces, np.int32), {"normal": way.copy()}
    )


def camera_at(angle: float, height: float = 0.3, size: int = 240, middle=(0.0, 0.0, 0.0)):
    """A camera that looks at the middle from `DISTANCE` away."""
    way = np.array([np.cos(angle), np.sin(angle), height])
    z = -way / np.linalg.norm(way)
    center = np.asarray(middle) - DISTANCE * z
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(z, x), z])
    params = (2.0 * size, 2.0 * size, 0.51 * size, 0.49 * size, -0.05, 0.01, 1e-4, -2e-4)
    return PhotoCamera("OPENCV", size, size, params, rigid(rotation, -rotation @ center))


def ring(count: int, size: int = 240) -> list[PhotoCamera]:
    return [camera_at(2 * np.pi * k / count, 0.5 if k % 2 else -0.4, size) for k in range(count)]


def paint(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Albedo (n, 3), smooth over some centimetres."""
    x, y, z = (places / RADIUS).T
    return np.stack(
        [0.4 + 0.2 * np.sin(4 * x), 0.35 + 0.15 * np.cos(3 * y + z), 0.3 + 0.2 * z * x], axis=1
    )


def photographed(
    camera: PhotoCamera, flash: FlashLight = FLASH, gain: float = 1.0, seed: int | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Linear picture (h, w, 3) and mask (h, w) of the ball at the origin; 1 % noise by seed."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    ways = camera.directions(np.column_stack([columns.ravel(), rows.ravel()]))
    along = -(ways @ camera.center)
    depth2 = along**2 - (camera.center @ camera.center - RADIUS**2)
    hit = depth2 > 0.0
    places = camera.center + (along - np.sqrt(np.maximum(depth2, 0.0)))[:, None] * ways
    places, normals = places[hit], places[hit] / RADIUS
    turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    received = flash.received(places @ turn.T + shift, normals @ turn.T)
    values = np.zeros((len(hit), 3), np.float32)
    values[hit] = paint(places) * gain * received[:, None]
    if seed is not None:
        values *= 1.0 + 0.01 * np.random.default_rng(seed).standard_normal(values.shape)
    shape = (camera.height, camera.width)
    return values.reshape(*shape, 3).astype(np.float32), hit.reshape(shape)


@dataclass(frozen=True)
class Looked:
    """A photograph's view and what it says."""

    camera: PhotoCamera
    view: PhotoView
    seen: Observations


def looked(
    mesh: TriangleMesh,
    camera: PhotoCamera,
    picture: NDArray[np.float32],
    usable: NDArray[np.bool_],
    flash: FlashLight | None = FLASH,
    options: WeightOptions | None = None,
) -> Looked:
    """What a photograph says of a mesh's vertices."""
    rays, blocks = SurfaceRays(mesh), blocks_of_mesh(mesh)
    view = view_of_surface(rays, blocks[0].normals, camera).smoothed(5)
    options = options or WeightOptions()
    weights = pixel_weights(view, picture, usable, options)
    if flash is not None:
        weights *= feathered(lit_by_flash(view, rays, flash.position_in_camera), options.feather)
    photo = weighed_photo(view, picture, usable, weights, 64.0)
    return Looked(camera, view, observed(photo, blocks))


def colored(mesh: TriangleMesh, photo: Looked, gain: float = 1.0) -> Colored:
    """The albedo it says."""
    seen = photo.seen
    pose = photo.camera.camera_from_world
    return corrected(seen, mesh.vertices[seen.index], pose, FLASH, gain)
