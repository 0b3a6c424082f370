"""A lens with COLMAP's distortion models: projection, its exact inverse, vignetting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.formats.colmap import ColmapCamera
from workbench.kernels.lens_distortion import distorted_points, undistorted_points
from workbench.synthetic.photo_options import CameraOptions


@dataclass(frozen=True)
class Lens:
    """The intrinsics of one camera.

    Attributes
    ----------
    model : COLMAP's name, ``SIMPLE_RADIAL``, ``RADIAL`` or ``OPENCV``.
    width, height : pixels; the centre of the upper left pixel is (0.5, 0.5).
    focal_px : focal length, the same along both axes.
    center_px : (2,) principal point.
    coefficients : (4,) k1, k2, p1, p2; those the model does not have are 0.
    cosine_power, corner_loss : vignetting, see `vignetting`.
    """

    model: str
    width: int
    height: int
    focal_px: float
    center_px: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    cosine_power: float
    corner_loss: float

    @classmethod
    def from_options(cls, options: CameraOptions) -> Lens:
        """The lens that the options describe."""
        used = {"SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4}[options.model]
        size = np.array([options.width_px, options.height_px], float)
        focal_mm = options.focal_length_mm * (1.0 + options.focal_deviation)
        return cls(
            options.model,
            options.width_px,
            options.height_px,
            focal_mm / options.pixel_pitch_mm,
            0.5 * size + options.long_side_px * np.array(options.principal_offset),
            np.array(options.distortion) * (np.arange(4) < used),
            options.vignetting_cosine_power,
            options.vignetting_corner_loss,
        )

    def colmap_camera(self, camera_id: int = 1) -> ColmapCamera:
        """The same intrinsics as a line of ``cameras.txt``."""
        focal = [self.focal_px] if self.model != "OPENCV" else [self.focal_px, self.focal_px]
        used = {"SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4}[self.model]
        params = [*focal, *self.center_px, *self.coefficients[:used]]
        return ColmapCamera(
            camera_id, self.model, self.width, self.height, tuple(float(p) for p in params)
        )

    def project(self, points_in_camera: ArrayLike) -> NDArray[np.float64]:
        """Pixels (n, 2) of points (n, 3) before the camera (x right, y down, z forward)."""
        points = np.atleast_2d(np.asarray(points_in_camera, float))
        ideal = points[:, :2] / points[:, 2:]
        imaged: NDArray[np.float64] = distorted_points(ideal, self.coefficients)
        pixels: NDArray[np.float64] = self.focal_px * imaged + self.center_px
        return pixels

    def slopes(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Ray slopes (n, 2), x / z and y / z, of pixels (n, 2); the inverse of `project`."""
        imaged = (np.atleast_2d(np.asarray(pixels, float)) - self.center_px) / self.focal_px
        slopes: NDArray[np.float64] = undistorted_points(
            np.ascontiguousarray(imaged), self.coefficients
        )
        return slopes

    def vignetting(self, first_row: int, rows: int) -> NDArray[np.float64]:
        """Share of the light (rows, width) that pixels from ``first_row`` on receive, (0, 1].

        cosᵖ of the angle to the optical axis, times a loss with the fourth power of the
        radius that reaches ``corner_loss`` at half the frame's diagonal.
        """
        v = first_row + 0.5 + np.arange(rows)[:, None] - self.center_px[1]
        u = 0.5 + np.arange(self.width)[None, :] - self.center_px[0]
        radius2 = u * u + v * v
        cosine = 1.0 / np.sqrt(1.0 + radius2 / self.focal_px**2)
        corner2 = 0.25 * (self.width**2 + self.height**2)
        loss = self.corner_loss * np.minimum(radius2 / corner2, 1.0) ** 2
        light: NDArray[np.float64] = cosine**self.cosine_power * (1.0 - loss)
        return light

    @property
    def corner_slope(self) -> float:
        """Tangent of the field angle at half the frame's diagonal."""
        return 0.5 * float(np.hypot(self.width, self.height)) / self.focal_px
