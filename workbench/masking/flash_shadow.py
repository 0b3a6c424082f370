"""The sharp shadows that clutter throws on the object in a flash's light.

Source: Jaspe, section 3.4.2: they are identified "by the masking process and by taking into
account geometric occlusion"; the two functions are these two ways.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera

# Embree computes in float32: a shadow ray starts this much of its length nearer to the flash.
_START = 1e-3
_ROWS_AT_ONCE = 256
# Rays through a pixel, (down, right) from its corner; most of them decide.
_WITHIN_PIXEL = ((0.125, 0.375), (0.375, 0.875), (0.625, 0.125), (0.875, 0.625))

# Neighbourhood that tells how the surface is lit around, and of the border, pixels per
# thousand of the longer side.
_AROUND_PER_MILLE, _BORDER_PER_MILLE = 25.0, 2.0
_AROUND_SIDE_PX = 800
# Linear light against the surroundings', and the least step of its logarithm at the border.
_DARK_PART, _STEP = 0.25, 0.7
_LEAST_BORDER_PART = 0.5


def flash_shadows_by_geometry(
    surface: TriangleMesh, camera: PhotoCamera, flash_in_world: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Pixels whose surface does not see the flash: occluded, or turned away from it.

    Parameters
    ----------
    surface : all that stands in the scene, clutter too, in the camera's world.
    flash_in_world : (3,) middle of the flash.

    Returns
    -------
    (height, width) bool; False where there is no surface, and where less than half of a
    pixel is in shadow.

    Raises
    ------
    InputError : the flash is not a finite point, or the surface is empty.
    """
    import open3d as o3d

    flash = np.asarray(flash_in_world, np.float64)
    if flash.shape != (3,) or not np.isfinite(flash).all() or not len(surface.triangles):
        raise InputError("shadows need a surface and the place of the flash", found=str(flash))
    # Rays are cast about the camera: float32 far from the origin is coarse.
    origin = camera.center
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy((surface.vertices - origin).astype(np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(surface.triangles, np.uint32)),
    )
    shape = (camera.height, camera.width)
    seen, hidden = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for top in range(0, camera.height, _ROWS_AT_ONCE):
        rows, columns = np.mgrid[top : min(top + _ROWS_AT_ONCE, camera.height), : camera.width]
        for down, right in _WITHIN_PIXEL:
            pixels = np.column_stack([columns.ravel() + right, rows.ravel() + down])
            hit, dark = _hit_and_hidden(scene, camera.directions(pixels), flash - origin)
            seen[rows, columns] += hit.reshape(rows.shape)
            hidden[rows, columns] += dark.reshape(rows.shape)
    return np.asarray((seen > 0) & (2 * hidden > seen))


def _hit_and_hidden(
    scene: Any, directions: NDArray[np.float64], flash: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which rays (n, 3) from the origin meet a surface, and one the flash does not light."""
    import open3d as o3d

    rays = np.hstack([np.zeros_like(directions), directions]).astype(np.float32)
    answer = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
    distance = answer["t_hit"].numpy().astype(np.float64)
    normal = answer["primitive_normals"].numpy().astype(np.float64)
    hit = np.isfinite(distance)
    places = distance[hit, None] * directions[hit]
    towards = flash - places
    # Which way a triangle is wound does not matter: its lit side is the one seen.
    facing = -np.sign((normal[hit] * directions[hit]).sum(axis=1))
    away = facing * (normal[hit] * towards).sum(axis=1) <= 0.0
    # Lengths are parts of the way to the flash, 1 at the flash itself.
    back = o3d.core.Tensor.from_numpy(np.hstack([places, towards]).astype(np.float32))
    blocked = scene.test_occlusions(back, tnear=_START, tfar=1.0 - _START).numpy()
    hidden = np.zeros(len(hit), bool)
    hidden[hit] = blocked | away
    return hit, hidden


def flash_shadows_by_value(image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Regions of the object that are much darker than around, with a sharp border.

    For where no geometry is known yet. Conservative: dark paint with a sharp outline looks the
    same, so only what gets less than a quarter of the light around is taken.

    Parameters
    ----------
    image : (h, w, 3) uint8 sRGB.
    mask : (h, w) uint8, 255 = object.

    Returns
    -------
    (h, w) bool, within the mask.

    Raises
    ------
    InputError : sizes differ.
    """
    if mask.shape != image.shape[:2]:
        raise InputError(
            "a mask must be as large as its image",
            expected=str(image.shape[:2]),
            found=str(mask.shape),
        )
    inside = mask > 127
    side = max(mask.shape)
    light = (image.max(axis=2).astype(np.float32) / np.float32(255)) ** np.float32(2.2)
    log_light = np.log(light + np.float32(1e-3))
    around = _lit_around(light, inside)
    dark = inside & (light < _DARK_PART * around)
    size = 2 * max(1, round(_BORDER_PER_MILLE * side / 1000.0)) + 1
    box = np.ones((size, size), np.uint8)
    highest = cv2.dilate(np.where(inside, log_light, -9.0).astype(np.float32), box)
    lowest = cv2.erode(np.where(inside, log_light, 9.0).astype(np.float32), box)
    sharp = highest - lowest > _STEP
    count, labels = cv2.connectedComponents(dark.astype(np.uint8), connectivity=4)
    # Pixels just outside a region, still on the object, are its border with lit surface.
    ring = cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int32)
    ring[dark | ~inside] = 0
    border = np.bincount(ring.ravel(), minlength=count).astype(np.float64)
    crisp = np.bincount(ring[sharp].ravel(), minlength=count)
    kept = crisp >= _LEAST_BORDER_PART * np.maximum(border, 1.0)
    kept[0] = False
    return np.asarray(kept[labels])


def _lit_around(light: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Root mean square of the light on the object around: the lit part counts most."""
    # So wide a mean needs no fine pixels, and would take a minute of 24 million.
    share = min(1.0, _AROUND_SIDE_PX / max(light.shape))
    size = tuple(max(1, round(share * side)) for side in light.shape[::-1])
    sigma_px = _AROUND_PER_MILLE * max(size) / 1000.0
    part, power = (
        cv2.GaussianBlur(cv2.resize(values, size, interpolation=cv2.INTER_AREA), (0, 0), sigma_px)
        for values in (inside.astype(np.float32), np.where(inside, light**2, np.float32(0.0)))
    )
    mean = np.sqrt(power / np.maximum(part, np.float32(1e-3)))
    return np.asarray(
        cv2.resize(mean, light.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32
    )
