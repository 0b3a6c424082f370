"""Samples drawn as discs in their own planes, blended where they lie on one surface.

Source: Botsch, Hornung, Zwicker and Kobbelt 2005: nearest depth first, then Gaussian-weighted
means of what lies within a tolerance of it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Depths and normals of a disc's middle count e^2 times those of its rim.
_SHARPNESS = 2.0
# A disc seen edge-on has no depth of its own within its pixel.
_EDGE_ON = 0.02


@njit(cache=True, nogil=True)
def draw_fronts(
    pixels: NDArray[np.float64],
    places: NDArray[np.float64],
    normals: NDArray[np.float64],
    radii: NDArray[np.float64],
    focal_px: float,
    slopes: NDArray[np.float32],
    fronts: NDArray[np.float64],
) -> None:
    """The nearest depth of any disc at each pixel.

    Parameters
    ----------
    pixels : (n, 2); NaN draws nothing. The pixel a sample lies in is always drawn.
    places, normals : (n, 3) in the camera's frame, unit normals.
    radii : (n,) in the world's units.
    slopes : (h, w, 2) of rays through pixels' middles, per forward.
    fronts : (h, w) nearest so far, infinite for none; changed in place.
    """
    h, w = fronts.shape
    for k in range(len(pixels)):
        top, bottom, first, last = _reach(pixels[k], places[k], radii[k], focal_px, h, w)
        for j in range(top, bottom):
            for i in range(first, last):
                depth, _ = _met(pixels[k], places[k], normals[k], radii[k], slopes, j, i)
                if depth < fronts[j, i]:
                    fronts[j, i] = depth


@njit(cache=True, nogil=True)
def blend_splats(
    pixels: NDArray[np.float64],
    places: NDArray[np.float64],
    normals: NDArray[np.float64],
    radii: NDArray[np.float64],
    focal_px: float,
    slopes: NDArray[np.float32],
    fronts: NDArray[np.float64],
    thickness: float,
    totals: NDArray[np.float64],
) -> None:
    """Add weight, weighted depth and weighted normal (h, w, 5) of discs near the front.

    Parameters are those of `draw_fronts`; a disc counts where it is no further behind the front
    than ``thickness`` times its radius.
    """
    h, w = fronts.shape
    for k in range(len(pixels)):
        top, bottom, first, last = _reach(pixels[k], places[k], radii[k], focal_px, h, w)
        for j in range(top, bottom):
            for i in range(first, last):
                depth, weight = _met(pixels[k], places[k], normals[k], radii[k], slopes, j, i)
                if depth <= fronts[j, i] + thickness * radii[k]:
                    totals[j, i, 0] += weight
                    totals[j, i, 1] += weight * depth
                    for c in range(3):
                        totals[j, i, 2 + c] += weight * normals[k, c]


@njit(cache=True, nogil=True)
def _reach(
    pixel: NDArray[np.float64], place: NDArray[np.float64], radius: float, focal_px: float,
    h: int, w: int,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Rows from, to, columns from, to that a disc may touch; empty for one that draws nothing."""
    x, y, z = pixel[0], pixel[1], place[2]
    if not (z > 0.0 and radius >= 0.0 and math.isfinite(x) and math.isfinite(y)):
        return 0, 0, 0, 0
    # Rays off the axis are spread wider than those on it, by their slope.
    spread = 1.0 + (place[0] * place[0] + place[1] * place[1]) / (z * z)
    r = min(focal_px * radius * spread / max(z - radius, 0.1 * z), float(h + w))
    if not (x > -r and y > -r and x < w + r and y < h + r):
        return 0, 0, 0, 0
    top, bottom = max(math.floor(y - r), 0), min(math.floor(y + r) + 1, h)
    first, last = max(math.floor(x - r), 0), min(math.floor(x + r) + 1, w)
    return top, bottom, first, last


@njit(cache=True, nogil=True)
def _met(
    pixel: NDArray[np.float64], place: NDArray[np.float64], normal: NDArray[np.float64],
    radius: float, slopes: NDArray[np.float32], j: int, i: int,
) -> tuple[float, float]:  # fmt: skip
    """Depth and weight of a disc at a pixel; an infinite depth where it is not met."""
    right, down = float(slopes[j, i, 0]), float(slopes[j, i, 1])
    against = normal[0] * right + normal[1] * down + normal[2]
    own = math.floor(pixel[0]) == i and math.floor(pixel[1]) == j
    # Discs that turn their backs are the far side, seen through a gap.
    if normal[0] * place[0] + normal[1] * place[1] + normal[2] * place[2] >= 0.0:
        return np.inf, 0.0
    if against < -_EDGE_ON:
        plane = normal[0] * place[0] + normal[1] * place[1] + normal[2] * place[2]
        depth = plane / against
        x, y, z = depth * right - place[0], depth * down - place[1], depth - place[2]
        share = (x * x + y * y + z * z) / (radius * radius) if radius > 0.0 else np.inf
        if share <= 1.0:
            return depth, math.exp(-_SHARPNESS * share)
    if own:
        return place[2], math.exp(-_SHARPNESS)
    return np.inf, 0.0
