"""An oriented photograph: where its camera stood and how its lens images, by COLMAP's models."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import apply, inverse


@dataclass(frozen=True)
class PhotoCamera:
    """One photograph's camera.

    Attributes
    ----------
    model : COLMAP's name of the lens model, ``SIMPLE_RADIAL``, ``OPENCV`` …
    width, height : pixels; the centre of the upper left pixel is (0.5, 0.5).
    params : in COLMAP's order, pixels.
    camera_from_world : 4×4 float64 rigid, x right, y down, z forward.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]
    camera_from_world: NDArray[np.float64]

    @property
    def center(self) -> NDArray[np.float64]:
        """Where the camera stood, (3,) in the world."""
        return np.asarray(inverse(self.camera_from_world)[:3, 3])

    def project(
        self, points_in_world: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels (n, 2) and depths (n,) of points (n, 3); NaN pixels for points behind."""
        points = apply(self.camera_from_world, points_in_world)
        before = points[:, 2] > 0.0
        if before.all() and len(points):
            # Copying the rows would take many times as long as projecting them.
            return np.asarray(self._lens.img_from_cam(points)), points[:, 2]
        pixels = np.full((len(points), 2), np.nan)
        if before.any():
            pixels[before] = self._lens.img_from_cam(points[before])
        return pixels, points[:, 2]

    def directions(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Unit directions (n, 3) in the world of the rays through pixels (n, 2)."""
        slopes = np.asarray(self._lens.cam_from_img(np.ascontiguousarray(pixels, float)))
        rays = np.column_stack([slopes, np.ones(len(slopes))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return np.asarray(rays @ self.camera_from_world[:3, :3])

    @cached_property
    def _lens(self) -> Any:
        import pycolmap

        return pycolmap.Camera(
            model=self.model, width=self.width, height=self.height, params=list(self.params)
        )
