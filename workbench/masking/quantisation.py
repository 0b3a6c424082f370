"""The bins an image's pixels fall into: reflectance, hue and saturation, tone.

Source: Jaspe, section 3.4.3 (32 reflectance levels; 32 × 32 hue and saturation).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

UNKNOWN = -1
# Contrasts are told apart by their logarithm; 2⁷ − 1 grey levels is the strongest.
_CONTRAST_OCTAVES = 7.0


class Quantiser(Protocol):
    """What maps the pixels of an image to bins of a histogram."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def wraps(self) -> bool:
        """Whether the first axis is a circle."""

    def bins_of(self, image: NDArray[np.generic]) -> NDArray[np.int32]:
        """(h, w) flat bin per pixel; ``UNKNOWN`` where the image does not tell."""


@dataclass(frozen=True)
class ReflectanceLevels:
    """Equal levels of a reflectance in [0, 1], (h, w) float; NaN (no return) is unknown."""

    levels: int = 32

    def __post_init__(self) -> None:
        _require(self.levels >= 2, "a histogram needs two levels or more")

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.levels,)

    @property
    def wraps(self) -> bool:
        return False

    def bins_of(self, image: NDArray[np.generic]) -> NDArray[np.int32]:
        value = _reflectance(image)
        known = np.isfinite(value)
        level = np.clip(np.where(known, value, 0.0) * self.levels, 0, self.levels - 1)
        return np.where(known, level, UNKNOWN).astype(np.int32)


@dataclass(frozen=True)
class HueSaturationLevels:
    """Equal levels of hue and of saturation of an sRGB photograph, (h, w, 3) uint8, RGB order.

    The value is ignored, so shading does not matter. Pixels darker than ``darkest`` in every
    channel, or brighter than ``brightest``, have no hue to speak of and are unknown.
    """

    levels: int = 32
    darkest: int = 25
    brightest: int = 250

    def __post_init__(self) -> None:
        _require(self.levels >= 2, "a histogram needs two levels or more")
        _require(0 <= self.darkest < self.brightest <= 255, "0 ≤ darkest < brightest ≤ 255")

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.levels, self.levels)

    @property
    def wraps(self) -> bool:
        return True

    def bins_of(self, image: NDArray[np.generic]) -> NDArray[np.int32]:
        rgb = photograph(image)
        hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV_FULL).astype(np.int32)
        hue, saturation = hsv[..., 0] * self.levels >> 8, hsv[..., 1] * self.levels >> 8
        unknown = (rgb.max(axis=2) < self.darkest) | (rgb.min(axis=2) > self.brightest)
        return np.where(unknown, UNKNOWN, hue * self.levels + saturation).astype(np.int32)


@dataclass(frozen=True)
class ToneLevels:
    """Levels of the brightness around a pixel and of its contrast there.

    Says something where the hue does not: a black backdrop is smooth, a black tool is not.
    Takes a photograph or a reflectance image; ``sigma_px`` is the Gaussian neighbourhood.
    """

    sigma_px: float
    levels: int = 32

    def __post_init__(self) -> None:
        _require(self.levels >= 2, "a histogram needs two levels or more")
        _require(self.sigma_px > 0, "a neighbourhood needs a size")

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.levels, self.levels)

    @property
    def wraps(self) -> bool:
        return False

    def bins_of(self, image: NDArray[np.generic]) -> NDArray[np.int32]:
        if image.ndim == 3:
            rgb = photograph(image)
            value = rgb.max(axis=2).astype(np.float32)
            grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
            known = np.ones(value.shape, bool)
        else:
            value = 255.0 * _reflectance(image)
            known = np.isfinite(value)
            value = np.clip(np.where(known, value, 0.0), 0, 255).astype(np.float32)
            grey = value
        weight = _blurred(known.astype(np.float32), self.sigma_px) + np.float32(1e-6)
        mean = _blurred(grey, self.sigma_px) / weight
        square = _blurred(grey * grey, self.sigma_px) / weight
        contrast = np.sqrt(np.maximum(square - mean * mean, 0.0))
        around = _blurred(value, self.sigma_px) / weight
        top = self.levels - 1
        bright = np.clip(around * self.levels / 256.0, 0, top).astype(np.int32)
        rough = np.log2(1.0 + contrast) * self.levels / _CONTRAST_OCTAVES
        flat = bright * self.levels + np.clip(rough, 0, top).astype(np.int32)
        return np.where(known, flat, UNKNOWN).astype(np.int32)


def _blurred(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    return cv2.GaussianBlur(image, (0, 0), sigma_px).astype(np.float32, copy=False)


def photograph(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """The image itself if it is (h, w, 3) uint8; raises InputError if it is not."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "a photograph to mask must be 8-bit RGB",
            expected="(h, w, 3) uint8",
            found=f"{image.shape} {image.dtype}",
        )
    return np.ascontiguousarray(image, np.uint8)


def _reflectance(image: NDArray[np.generic]) -> NDArray[np.float32]:
    if image.ndim != 2 or not np.issubdtype(image.dtype, np.floating):
        raise InputError(
            "a reflectance image must be floating point in [0, 1]",
            expected="(h, w) float",
            found=f"{image.shape} {image.dtype}",
        )
    return image.astype(np.float32)


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InputError(message)
