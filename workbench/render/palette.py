"""Colours of pictures: the provenance pair, scales for numbers, sRGB coding, the background.

All colours are sRGB-encoded unless a name says linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

MEASURED, INFILLED, BY_PHOTOGRAPHS = 0, 1, 2

# A light stone grey, a clear orange and a dark blue differ in lightness and along the
# blue-yellow axis, so that they stay apart in protanopia, deuteranopia and tritanopia alike.
PROVENANCE_COLORS: dict[int, tuple[int, int, int]] = {
    MEASURED: (214, 210, 201),
    INFILLED: (230, 120, 10),
    BY_PHOTOGRAPHS: (62, 100, 158),
}
STONE: tuple[int, int, int] = (226, 220, 210)
UNKNOWN_COLOR: tuple[int, int, int] = (120, 118, 114)
BACKGROUND: tuple[tuple[int, int, int], tuple[int, int, int]] = ((234, 235, 234), (203, 205, 205))


@dataclass(frozen=True)
class ColorScale:
    """How numbers become colours; outside the limits the end colours hold.

    Attributes
    ----------
    low, high : the limits, in the unit of ``label``.
    colormap : a name Matplotlib knows.
    label : quantity and unit, for the colour bar.
    """

    low: float
    high: float
    colormap: str
    label: str

    @classmethod
    def diverging(cls, limit: float, label: str) -> ColorScale:
        """Blue below zero, near white at zero, red above: for signed deviations."""
        return cls(-limit, limit, "RdBu_r", label)

    @classmethod
    def sequential(cls, limit: float, label: str) -> ColorScale:
        """Pale at zero to deep blue at the limit: for distances without a sign."""
        return cls(0.0, limit, "YlGnBu", label)

    def colors(self, values: ArrayLike) -> NDArray[np.uint8]:
        """Colours (..., 3) uint8 of values (...); `UNKNOWN_COLOR` for NaN."""
        from matplotlib import colormaps

        numbers = np.asarray(values, float)
        span = self.high - self.low
        share = (numbers - self.low) / (span if span > 0 else 1.0)
        rgba = colormaps[self.colormap](np.clip(share, 0, 1), bytes=True)
        colors = np.array(rgba[..., :3], np.uint8)
        colors[np.isnan(numbers)] = UNKNOWN_COLOR
        return colors


def provenance_colors(provenance: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Colours (n, 3) uint8 of vertices: stone grey where measured, orange where infilled,
    blue where photographs measured what scans did not.
    """
    known = (MEASURED, INFILLED, BY_PHOTOGRAPHS)
    table = np.array([PROVENANCE_COLORS[kind] for kind in known], np.uint8)
    kinds = np.asarray(provenance)
    return np.asarray(table[np.where(np.isin(kinds, known), kinds, INFILLED).astype(np.intp)])


_SRGB = np.arange(256) / 255
_LINEAR_FROM_SRGB = np.where(
    _SRGB <= 0.04045, _SRGB / 12.92, ((_SRGB + 0.055) / 1.055) ** 2.4
).astype(np.float32)
# Power functions over millions of pixels take longer than the ray casting; 4096 steps of a
# table in linear light resolve the darkest sRGB codes that shading leaves.
_STEPS = 4096
_GRID = np.arange(_STEPS) / (_STEPS - 1)
_SRGB_FROM_LINEAR = np.round(
    255 * np.where(_GRID <= 0.0031308, 12.92 * _GRID, 1.055 * _GRID ** (1 / 2.4) - 0.055)
).astype(np.uint8)


def linear_from_srgb(colors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Linear light in [0, 1] of sRGB codes (IEC 61966-2-1)."""
    return np.take(_LINEAR_FROM_SRGB, colors)


def srgb_from_linear(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """SRGB codes of linear light; values outside [0, 1] are clipped."""
    steps = np.clip(light * np.float32(_STEPS - 1) + np.float32(0.5), 0, _STEPS - 1)
    return np.asarray(np.take(_SRGB_FROM_LINEAR, steps.astype(np.intp)), np.uint8)


def background(height: int, width: int) -> NDArray[np.float32]:
    """A quiet studio background (height, width, 3) in linear light, darker towards the floor."""
    top, bottom = linear_from_srgb(np.array(BACKGROUND, np.uint8))
    share = np.linspace(0, 1, max(height, 1), dtype=np.float32)[:, None, None]
    return np.broadcast_to(top + share * (bottom - top), (height, width, 3))
