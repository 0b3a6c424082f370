"""Local features of photographs: where they are, how they look, which colour they have.

SIFT (Lowe 2004) as RootSIFT (Arandjelović and Zisserman 2012), found on the picture doubled
in size and scaled to whole numbers, so that products of descriptors are exact in float32 and
no order of summation changes them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.orientation.photographs import PhotoToOrient

DESCRIPTOR_NORM = 512.0
# A quarter of what is usual: stone and paint in the dark have faint features, and where there
# are too many the strongest are kept.
_CONTRAST = 0.01
_MARGIN_PX = 32
# Twice the size both ways, eleven layers of float32 in the first octave, a third in the others.
_BYTES_PER_PIXEL = 4 * 11 * 4 * 4 / 3


@dataclass(frozen=True)
class FeatureSettings:
    """How features are found.

    Attributes
    ----------
    max_image_px : larger pictures are reduced until their longer side has this; None never.
    max_features : so many of the strongest are kept per photograph.
    """

    max_image_px: int | None = 3200
    max_features: int = 6000


@dataclass(frozen=True)
class PhotoFeatures:
    """Features of one photograph, coarsest first.

    Attributes
    ----------
    width, height : of the full picture, pixels.
    points : (n, 2) float32 pixels of the full picture; the centre of its upper left pixel is
        (0.5, 0.5).
    scales : (n,) float32 diameters in pixels of the full picture, falling.
    descriptors : (n, 128) uint8, of length `DESCRIPTOR_NORM` within rounding.
    colors : (n, 3) uint8 sRGB-encoded.
    """

    width: int
    height: int
    points: NDArray[np.float32]
    scales: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    colors: NDArray[np.uint8]


def feature_memory_bytes(width: int, height: int, settings: FeatureSettings) -> int:
    """Memory at the peak of finding the features of one photograph of that size, roughly."""
    ratio = 1.0
    if settings.max_image_px is not None:
        ratio = min(1.0, settings.max_image_px / max(width, height))
    return int(_BYTES_PER_PIXEL * ratio * width * ratio * height) + 6 * width * height


def features_of(photo: PhotoToOrient, settings: FeatureSettings) -> PhotoFeatures:
    """The features of a photograph inside its mask.

    Raises
    ------
    InputError
        The photograph or its mask cannot be read, or their sizes differ.
    """
    picture = photo.pixels()
    height, width = picture.shape[:2]
    kept = photo.kept(height, width)
    corner = np.zeros(2)
    if kept is not None:
        rows, columns = _extent(kept.max(axis=1)), _extent(kept.max(axis=0))
        picture, kept = picture[rows, columns], kept[rows, columns]
        corner = np.array([columns.start, rows.start], float)
    if picture.size == 0:
        return _none(width, height)
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    if settings.max_image_px is not None and max(width, height) > settings.max_image_px:
        ratio = settings.max_image_px / max(width, height)
        grey = cv2.resize(grey, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA)
    seen, most = None, settings.max_features
    if kept is not None:
        shape = grey.shape[::-1]
        seen = cv2.resize(kept.astype(np.uint8), shape, interpolation=cv2.INTER_NEAREST)
        # OpenCV would look for the strongest before it looks at the mask.
        most = 0
    sift = cv2.SIFT.create(most, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    found, descriptors = sift.detectAndCompute(grey, seen)
    if not found:
        return _none(width, height)
    pixel = np.array(picture.shape[1::-1]) / grey.shape[1::-1]
    points = (np.array([key.pt for key in found]) + 0.5) * pixel
    scales = np.array([key.size for key in found]) * pixel.mean()
    strength = np.array([key.response for key in found])
    # OpenCV gives them in a fixed order, so that of equals is fixed as well.
    strongest = np.argsort(-strength, kind="stable")[: settings.max_features]
    order = strongest[np.argsort(-scales[strongest], kind="stable")]
    column, row = np.minimum(points[order].astype(int), np.array(picture.shape[1::-1]) - 1).T
    return PhotoFeatures(
        width,
        height,
        (points[order] + corner).astype(np.float32),
        scales[order].astype(np.float32),
        _root(np.asarray(descriptors, np.float32)[order]),
        picture[row, column],
    )


def _extent(used: NDArray[np.bool_]) -> slice:
    """The part of an axis from the first to the last used place, with room for a gradient."""
    places = np.flatnonzero(used)
    if len(places) == 0:
        return slice(0, 0)
    return slice(max(int(places[0]) - _MARGIN_PX, 0), int(places[-1]) + 1 + _MARGIN_PX)


def _root(descriptors: NDArray[np.float32]) -> NDArray[np.uint8]:
    """RootSIFT of SIFT descriptors (n, 128)."""
    sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1.0)
    rooted = np.rint(DESCRIPTOR_NORM * np.sqrt(descriptors / sums))
    return np.asarray(np.minimum(rooted, 255), np.uint8)


def _none(width: int, height: int) -> PhotoFeatures:
    return PhotoFeatures(
        width,
        height,
        np.zeros((0, 2), np.float32),
        np.zeros(0, np.float32),
        np.zeros((0, 128), np.uint8),
        np.zeros((0, 3), np.uint8),
    )
