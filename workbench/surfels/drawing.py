"""Surfels drawn as oriented discs: what each pixel shows, and a picture of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.gltf import srgb_from_linear
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.point_set import PointSet
from workbench.geometry.transforms import apply
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.kernels.surfel_discs import NO_DISC, blend_discs, draw_discs

_BACKGROUND = (255, 255, 255, 0)
_STONE = np.array([206, 200, 190], np.uint8)
_AMBIENT = 0.25
# To the light, in the camera's frame: from above, left, and behind the viewer.
_LIGHT = (-0.5, -0.8, -0.7)


@dataclass(frozen=True)
class DiscView:
    """What the pixels of a camera show, rows first.

    Attributes
    ----------
    depth : (h, w) float64 along the camera's z, infinite where nothing is.
    number : (h, w) int32 row of the surfel, ``NO_DISC`` where there is none.
    """

    depth: NDArray[np.float64]
    number: NDArray[np.int32]

    @property
    def covered(self) -> NDArray[np.bool_]:
        """(h, w) whether there is a surfel."""
        return np.asarray(self.number != NO_DISC)


def disc_view(
    surfels: PointSet, radius: float | NDArray[np.floating], camera: PhotoCamera
) -> DiscView:
    """Draw surfels as opaque discs (Brandt 2019, 4.2).

    Parameters
    ----------
    surfels
        With unit normals; which way these point does not matter.
    radius
        Of all, or (n,) of each, in the unit of the surfels.
    camera
        A pinhole camera in their frame.

    Raises
    ------
    InputError
        Surfels without normals, radii that are negative or not finite, or a camera with
        another lens.
    """
    discs = _discs(surfels, radius, camera)
    shape = (camera.height, camera.width)
    depth = np.full(shape, np.inf)
    number = np.full(shape, NO_DISC, np.int32)
    draw_discs(*discs, pinhole(camera), 0, depth, number)
    return DiscView(depth, number)


def _discs(
    surfels: PointSet, radius: float | NDArray[np.floating], camera: PhotoCamera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Centres (n, 3), normals (n, 3) and radii (n,) in the camera's frame."""
    centers = apply(camera.camera_from_world, surfels.points)
    normals = _normals(surfels).astype(np.float64) @ camera.camera_from_world[:3, :3].T
    radii = np.broadcast_to(np.asarray(radius, np.float64), (len(surfels),)).copy()
    sound = (radii >= 0.0) & (radii < np.inf)
    if not sound.all():
        raise InputError(
            "Discs of such radii cannot be drawn.",
            where=f"surfel {int(np.argmin(sound))}",
            expected="finite radii from 0 on",
            found=f"{int((~sound).sum())} of {len(sound)} that are not",
            fix="Give a radius to each, or one for all.",
        )
    return np.ascontiguousarray(centers), np.ascontiguousarray(normals), radii


def _normals(surfels: PointSet) -> NDArray[np.float32]:
    if surfels.normals is None:
        raise InputError(
            "Points without normals cannot be drawn as discs.",
            expected="a unit normal for each",
            fix="Export them as surfels first: that finds their normals.",
        )
    return surfels.normals


def pinhole(camera: PhotoCamera) -> tuple[float, float, float, float]:
    """Focal lengths and principal point of a camera without distortion, pixels.

    Raises
    ------
    InputError
        The camera has another lens.
    """
    if camera.model == "PINHOLE":
        fx, fy, cx, cy = camera.params
    elif camera.model == "SIMPLE_PINHOLE":
        fx, cx, cy = camera.params
        fy = fx
    else:
        raise InputError(
            "Discs are drawn through a pinhole only.",
            expected="PINHOLE or SIMPLE_PINHOLE",
            found=camera.model,
            fix="Undistort the photograph, or draw without its distortion.",
        )
    return float(fx), float(fy), float(cx), float(cy)


def disc_picture(
    surfels: PointSet,
    radius: float | NDArray[np.floating],
    camera: PhotoCamera,
    *,
    blended: bool = True,
) -> NDArray[np.uint8]:
    """A picture (h, w, 4), sRGB, of surfels lit by one light; alpha 0 where nothing is.

    Parameters
    ----------
    surfels, radius, camera
        As in `disc_view`.
    blended
        Discs that overlap on one surface mix in linear light, as the paper suggests (4.2);
        without, each pixel shows the nearest alone.
    """
    image = np.empty((camera.height, camera.width, 4), np.uint8)
    image[:] = _BACKGROUND
    colors = np.broadcast_to(_STONE, (len(surfels), 3)) if surfels.color is None else surfels.color
    light = lit(colors, _normals(surfels), camera)
    if blended:
        seen, linear = blended_light(surfels, radius, camera, light)
    else:
        view = disc_view(surfels, radius, camera)
        seen, linear = view.covered, light[view.number[view.covered]]
    image[seen, :3] = srgb_from_linear(linear)
    image[seen, 3] = 255
    return image


def blended_light(
    surfels: PointSet,
    radius: float | NDArray[np.floating],
    camera: PhotoCamera,
    light: NDArray[np.float64],
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which pixels show surfels (h, w), and the light (k, 3) of those, rows first.

    Parameters
    ----------
    surfels, radius, camera
        As in `disc_view`.
    light
        (n, 3) linear, of each surfel; discs that overlap on one surface mix (Brandt 2019, 4.2).
    """
    view = disc_view(surfels, radius, camera)
    sums = np.zeros((*view.number.shape, 4))
    blend_discs(*_discs(surfels, radius, camera), pinhole(camera), view.depth, light, sums)
    seen = view.covered
    return seen, sums[seen, :3] / sums[seen, 3:]


def lit(
    color: NDArray[np.uint8], normals: NDArray[np.floating], camera: PhotoCamera
) -> NDArray[np.float64]:
    """Linear light (n, 3) of surfaces with sRGB colours and unit normals (n, 3) before a camera.

    Normals may point either way: what is seen is what faces the viewer.
    """
    along = np.asarray(normals, np.float64) @ camera.camera_from_world[:3, :3].T
    light = np.array(_LIGHT) / np.linalg.norm(_LIGHT)
    facing = np.where(along[:, 2] > 0.0, -1.0, 1.0) * (along @ light)
    bright = _AMBIENT + (1.0 - _AMBIENT) * np.clip(facing, 0.0, 1.0)
    return np.asarray(LINEAR_OF_BYTE[color] * bright[:, None])


def pixel_size(bounds: NDArray[np.float64], camera: PhotoCamera) -> float:
    """Side of a pixel at the place of a box that is nearest to the camera (Brandt 2019, 4.1).

    Parameters
    ----------
    bounds
        (2, 3) lower and upper corner.
    camera
        A pinhole camera.

    Returns
    -------
    In the unit of the box; 0 for a camera inside it.
    """
    nearest = np.clip(camera.center, bounds[0], bounds[1])
    fx, fy, _, _ = pinhole(camera)
    return float(np.linalg.norm(nearest - camera.center)) / max(fx, fy)


def surfel_radius(bounds: NDArray[np.float64], camera: PhotoCamera, size_px: float) -> float:
    """The radius of surfels that are ``size_px`` across at the nearest place of a box."""
    return 0.5 * size_px * pixel_size(bounds, camera)
