"""Photographs as stereo looks at them: grey, and as a lens without distortion would show them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rotate

_GREY_STEPS, _MOST_GREY = 256, 255.99


@dataclass(frozen=True)
class StereoView:
    """A photograph without distortion.

    Attributes
    ----------
    lens : (4,) float64 fx, fy, cx, cy in pixels; the middle of the upper left pixel is (0, 0).
    camera_from_world : 4×4 float64 rigid, x right, y down, z forward.
    grey : (h, w) float32, about 0 to 255.
    usable : (h, w) bool, where the object is.
    """

    lens: NDArray[np.float64]
    camera_from_world: NDArray[np.float64]
    grey: NDArray[np.float32]
    usable: NDArray[np.bool_]

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """As stored: grey in steps of a 256th."""
        grey = np.clip(self.grey, 0.0, _MOST_GREY) * _GREY_STEPS
        return {
            "lens": self.lens,
            "camera_from_world": self.camera_from_world,
            "grey": grey.round().astype(np.uint16),
            "usable": self.usable,
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> StereoView:
        """The view that `arrays` told."""
        grey = arrays["grey"].astype(np.float32) / np.float32(_GREY_STEPS)
        return cls(arrays["lens"], arrays["camera_from_world"], grey, arrays["usable"])

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) pixels of directions in the camera's frame."""
        fx, fy, cx, cy = self.lens
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(
        self, points_in_world: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels (n, 2) and depths (n,) of points; NaN pixels for points behind."""
        points = rotate(self.camera_from_world, points_in_world) + self.camera_from_world[:3, 3]
        depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
        return points[:, :2] / depth[:, None] * self.lens[:2] + self.lens[2:], points[:, 2]

    def halved(self) -> StereoView:
        """The same at half the size; a pixel is usable where all its four were."""
        height, width = self.grey.shape[0] // 2, self.grey.shape[1] // 2
        even = (slice(0, 2 * height), slice(0, 2 * width))
        size = (width, height)
        usable = cv2.resize(
            255 * self.usable[even].astype(np.uint8), size, interpolation=cv2.INTER_AREA
        )
        lens = self.lens * 0.5
        # The middle of the upper left pixel is now between the middles of four.
        lens[2:] -= 0.25
        grey = cv2.resize(self.grey[even], size, interpolation=cv2.INTER_AREA)
        return replace(
            self, lens=lens, grey=np.asarray(grey, np.float32), usable=np.asarray(usable == 255)
        )


def stereo_view(
    picture: NDArray[np.uint8],
    mask: NDArray[np.uint8] | None,
    camera: PhotoCamera,
) -> StereoView:
    """A photograph as a pinhole of the same focal length shows it.

    Parameters
    ----------
    picture : (h, w, 3) uint8 sRGB, as large as the view or larger.
    mask : (h, w) uint8 of the picture's size, 255 = keep; None keeps all.
    camera : of the view's size.
    """
    size = (camera.width, camera.height)
    reduced = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    grey = cv2.cvtColor(reduced, cv2.COLOR_RGB2GRAY)
    kept: Any = np.full(grey.shape, 255, np.uint8)
    if mask is not None:
        kept = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    fx = fy = camera.params[0]
    cx, cy = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    lens = np.array([fx, fy, cx, cy])
    maps = _places_in_picture(camera, lens)
    grey = cv2.remap(grey, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    kept = cv2.remap(kept, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return StereoView(
        lens, camera.camera_from_world, np.asarray(grey, np.float32), np.asarray(kept > 127)
    )


def _places_in_picture(
    camera: PhotoCamera, lens: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of the pinhole is found in the picture, column and row (h, w)."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    slopes = np.column_stack(
        [
            (columns.ravel() - lens[2]) / lens[0],
            (rows.ravel() - lens[3]) / lens[1],
            np.ones(columns.size),
        ]
    )
    in_world = slopes @ camera.camera_from_world[:3, :3] + camera.center
    pixels, _ = camera.project(in_world)
    places = (pixels - 0.5).reshape(*columns.shape, 2).astype(np.float32)
    return np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
