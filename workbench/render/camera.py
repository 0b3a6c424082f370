"""Pinhole cameras that look at an object from a given side.

COLMAP's conventions: x right, y down, z forward; the centre of the upper left pixel is
(0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry import transforms

UpAxis = Literal["x", "y", "z"]

# Horizontal axes per vertical axis: (right, towards the viewer) of someone who sees the front.
_FRONT_VIEW: dict[UpAxis, tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = {
    "z": (np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), np.array([0, 0, 1.0])),
    "y": (np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0])),
    "x": (np.array([0, 1.0, 0]), np.array([0, 0, -1.0]), np.array([1.0, 0, 0])),
}


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion.

    Attributes
    ----------
    width, height : picture size, pixels.
    K : (3, 3) float64 intrinsics, pixels.
    camera_from_world : (4, 4) float64 rigid transform, metres.
    """

    width: int
    height: int
    K: NDArray[np.float64]
    camera_from_world: NDArray[np.float64]

    @property
    def center_in_world(self) -> NDArray[np.float64]:
        """(3,) float64, where the camera stands."""
        return transforms.inverse(self.camera_from_world)[:3, 3]

    def project(self, points_in_world: ArrayLike) -> NDArray[np.float64]:
        """Pixel positions (n, 2) float64 of points (n, 3) in front of the camera."""
        points = transforms.apply(self.camera_from_world, points_in_world)
        image = points @ self.K.T
        return image[:, :2] / image[:, 2:]


def orbit_camera(
    mesh_bounds: ArrayLike,
    azimuth_deg: float,
    elevation_deg: float,
    width: int,
    height: int,
    *,
    up: UpAxis = "z",
    vertical_fov_deg: float = 22.0,
    margin: float = 0.06,
) -> Camera:
    """A camera that looks at the middle of an object and holds all of it.

    Parameters
    ----------
    mesh_bounds
        (2, 3) lower and upper corner in world coordinates, metres; any (n, 3)
        set of points to hold serves as well and frames more tightly.
    azimuth_deg
        0 is the front (seen along +y when ``up`` is z, along −z when it is y);
        90 shows the object's right side, that is the one at the right of the front view.
    elevation_deg
        height of the camera above the horizontal, in [−90, 90].
    width, height
        pixels.
    up
        the world axis that is vertical.
    vertical_fov_deg
        opening angle; the default is that of a short telephoto lens, which
        keeps proportions natural.
    margin
        share of the picture left free at each border.
    """
    return orbit_cameras(
        mesh_bounds,
        [azimuth_deg],
        elevation_deg,
        width,
        height,
        up=up,
        vertical_fov_deg=vertical_fov_deg,
        margin=margin,
    )[0]


def orbit_cameras(
    mesh_bounds: ArrayLike,
    azimuths_deg: Sequence[float],
    elevation_deg: float,
    width: int,
    height: int,
    *,
    up: UpAxis = "z",
    vertical_fov_deg: float = 22.0,
    margin: float = 0.06,
) -> list[Camera]:
    """Cameras around an object, all at one distance so that their pictures compare in scale.

    Parameters are those of `orbit_camera`, with one azimuth per camera.
    """
    points = np.asarray(mesh_bounds, float)
    lower, upper = points.min(axis=0), points.max(axis=0)
    target = 0.5 * (lower + upper)
    if len(points) == 2:
        points = np.array(list(product(*zip(lower, upper, strict=True))))
    focal = 0.5 * height / np.tan(np.radians(vertical_fov_deg) / 2)
    tangents = np.array([width, height]) * (0.5 - margin) / focal
    rotations = [_looking_inwards(azimuth, elevation_deg, up) for azimuth in azimuths_deg]
    distance = 0.0
    for rotation in rotations:
        # A point at (x, y, z) from the target stays in the picture when |x| ≤ t (d + z).
        x, y, z = rotation @ (points - target).T
        needed = np.maximum(np.abs(x) / tangents[0], np.abs(y) / tangents[1]) - z
        distance = max(distance, float(needed.max()))
    if distance <= 0:  # A single point: any distance shows it.
        distance = 1.0
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return [
        Camera(width, height, K, transforms.rigid(rotation, [0, 0, distance] - rotation @ target))
        for rotation in rotations
    ]


def _looking_inwards(azimuth_deg: float, elevation_deg: float, up: UpAxis) -> NDArray[np.float64]:
    """Rotation (3, 3) camera from world of a camera that looks at the origin."""
    right, viewer, vertical = _FRONT_VIEW[up]
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    outward = np.cos(azimuth) * viewer + np.sin(azimuth) * right
    toward_camera = np.cos(elevation) * outward + np.sin(elevation) * vertical
    x = np.cos(azimuth) * right - np.sin(azimuth) * viewer
    z = -toward_camera
    return np.stack([x, np.cross(z, x), z])
