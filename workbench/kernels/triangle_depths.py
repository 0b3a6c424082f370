"""Triangles drawn into a photograph's pixels: how near they are, and which of them it shows.

Between the corners, the nearness 1 / depth is linear over a picture (exactly so without lens
distortion, and closely so over the extent of one triangle with it).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_FLAT = 1e-12
# Along flatter views than this cosine, a pixel's depth is not trusted to be steeper still.
_STEEPEST = 0.15


@njit(cache=True, nogil=True)
def _plane(
    x: NDArray[np.float64], y: NDArray[np.float64], value: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Slopes right and down of what has these values at three corners, and the first of them."""
    ux, uy, vx, vy = x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]
    area = ux * vy - uy * vx
    if abs(area) < _FLAT:
        return 0.0, 0.0, max(value[0], value[1], value[2])
    u, v = value[1] - value[0], value[2] - value[0]
    return (u * vy - v * uy) / area, (v * ux - u * vx) / area, value[0]


@njit(cache=True, nogil=True)
def _corners(
    t: int,
    triangles: NDArray[np.int32],
    pixels: NDArray[np.float64],
    nearness: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    value: NDArray[np.float64],
) -> bool:
    """Fill in where the corners of a triangle are; whether all of them are in front."""
    for k in range(3):
        v = triangles[t, k]
        x[k], y[k], value[k] = pixels[v, 0], pixels[v, 1], nearness[v]
        if not (value[k] > 0.0 and math.isfinite(x[k]) and math.isfinite(y[k])):
            return False
    # So that inside is where all three edges are positive.
    if (x[1] - x[0]) * (y[2] - y[0]) < (y[1] - y[0]) * (x[2] - x[0]):
        x[1], x[2] = x[2], x[1]
        y[1], y[2] = y[2], y[1]
        value[1], value[2] = value[2], value[1]
    return True


@njit(cache=True, nogil=True)
def nearness_buffer(
    pixels: NDArray[np.float64],
    nearness: NDArray[np.float64],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
) -> NDArray[np.float32]:
    """1 / depth of the nearest triangle at every pixel's middle; 0 where there is none.

    Parameters
    ----------
    pixels : (n, 2) of the vertices, the middle of the upper left pixel at (0.5, 0.5); NaN for
        those that are not in front of the camera. Their triangles are passed over.
    nearness : (n,) 1 / depth.
    triangles : (m, 3).

    Returns
    -------
    (height, width) float32.
    """
    buffer = np.zeros((height, width), np.float32)
    x, y, value = np.empty(3), np.empty(3), np.empty(3)
    for t in range(len(triangles)):
        if not _corners(t, triangles, pixels, nearness, x, y, value):
            continue
        first_column = max(0, math.ceil(min(x[0], x[1], x[2]) - 0.5))
        last_column = min(width - 1, math.floor(max(x[0], x[1], x[2]) - 0.5))
        first_row = max(0, math.ceil(min(y[0], y[1], y[2]) - 0.5))
        last_row = min(height - 1, math.floor(max(y[0], y[1], y[2]) - 0.5))
        if first_column > last_column or first_row > last_row:
            continue
        right, down, at = _plane(x, y, value)
        for row in range(first_row, last_row + 1):
            py = row + 0.5
            for column in range(first_column, last_column + 1):
                px = column + 0.5
                inside = True
                for k in range(3):
                    n = (k + 1) % 3
                    edge = (x[n] - x[k]) * (py - y[k]) - (y[n] - y[k]) * (px - x[k])
                    if edge < 0.0:
                        inside = False
                        break
                if inside:
                    near = np.float32(at + right * (px - x[0]) + down * (py - y[0]))
                    if near > buffer[row, column]:
                        buffer[row, column] = near
    return buffer


@njit(cache=True, nogil=True)
def wholly_shown(
    pixels: NDArray[np.float64],
    nearness: NDArray[np.float64],
    triangles: NDArray[np.int32],
    middles: NDArray[np.float64],
    normals: NDArray[np.float64],
    center: NDArray[np.float64],
    buffer: NDArray[np.float32],
    usable: NDArray[np.bool_],
    focal_px: float,
    inside_px: float,
    beside_px: float,
    least_cosine: float,
) -> NDArray[np.bool_]:
    """Which triangles a picture shows with all that reading between its pixels touches.

    Those are the pixels whose middles are less than one pixel to the side of the triangle: all
    must lie in the picture and be usable, and nothing may stand before the triangle's plane there.

    Parameters
    ----------
    pixels, nearness, triangles : as of `nearness_buffer`, which also made ``buffer`` (h, w).
    middles, normals : (m, 3) of the triangles in the world; a normal is zero without area.
    center : (3,) of the camera. Triangles are shown only if the angle between their normal and
        the way there has more than ``least_cosine``.
    usable : (h, w).
    focal_px : focal length; depth over it is a pixel's width on the surface.
    inside_px, beside_px : by how many pixels' widths something must be nearer than the triangle
        to hide it: at pixels inside it, along its slope; at those around it.

    Returns
    -------
    (m,) bool.
    """
    height, width = buffer.shape
    shown = np.zeros(len(triangles), np.bool_)
    x, y, value, reach = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for t in range(len(triangles)):
        along, away = 0.0, 0.0
        for k in range(3):
            way = center[k] - middles[t, k]
            along += way * normals[t, k]
            away += way * way
        cosine = along / math.sqrt(away) if away > 0.0 else 0.0
        if not cosine > least_cosine:
            continue
        if not _corners(t, triangles, pixels, nearness, x, y, value):
            continue
        left, top = min(x[0], x[1], x[2]), min(y[0], y[1], y[2])
        far_right, bottom = max(x[0], x[1], x[2]), max(y[0], y[1], y[2])
        if left < 0.5 or top < 0.5 or far_right > width - 0.5 or bottom > height - 0.5:
            continue
        for k in range(3):
            n = (k + 1) % 3
            reach[k] = abs(x[n] - x[k]) + abs(y[n] - y[k])
        right, down, at = _plane(x, y, value)
        highest, lowest = max(value[0], value[1], value[2]), min(value[0], value[1], value[2])
        whole = True
        for row in range(math.floor(top - 0.5), min(height - 1, math.ceil(bottom - 0.5)) + 1):
            py = row + 0.5
            if abs(py - min(max(py, top), bottom)) >= 1.0:
                continue
            for column in range(
                math.floor(left - 0.5), min(width - 1, math.ceil(far_right - 0.5)) + 1
            ):
                px = column + 0.5
                touched, inside = True, True
                for k in range(3):
                    n = (k + 1) % 3
                    edge = (x[n] - x[k]) * (py - y[k]) - (y[n] - y[k]) * (px - x[k])
                    if edge + reach[k] <= 0.0:
                        touched = False
                        break
                    inside = inside and edge >= 0.0
                if not touched:
                    continue
                if not usable[row, column]:
                    whole = False
                    break
                found = buffer[row, column]
                if found <= 0.0:
                    continue
                near = at + right * (px - x[0]) + down * (py - y[0])
                near = min(max(near, lowest), highest)
                # 1 / z − 1 / z' ≈ (z' − z) / z², and a pixel is z / focal wide.
                limit = inside_px / max(cosine, _STEEPEST) if inside else beside_px
                if found - near > limit * near / focal_px:
                    whole = False
                    break
            if not whole:
                break
        shown[t] = whole
    return shown
