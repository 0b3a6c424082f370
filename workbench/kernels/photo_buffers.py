"""What a photograph's pixels show of a surface or of samples, and pictures between pixels."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.barycentric import corner_shares


@njit(cache=True, nogil=True)
def interpolated_normals(
    points: NDArray[np.float64],
    triangle: NDArray[np.int64],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    normals: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Normals of the vertices (v, 3) as they blend at points (n, 3) on triangles (n,).

    (n, 3) float32 unit; 0 where the triangle is negative or the normals cancel.
    """
    out = np.zeros((len(points), 3), np.float32)
    for i in range(len(points)):
        t = triangle[i]
        if t < 0:
            continue
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        wa, wb, wc = corner_shares(points, i, vertices, a, b, c)
        x, y, z = 0.0, 0.0, 0.0
        x = wa * normals[a, 0] + wb * normals[b, 0] + wc * normals[c, 0]
        y = wa * normals[a, 1] + wb * normals[b, 1] + wc * normals[c, 1]
        z = wa * normals[a, 2] + wb * normals[b, 2] + wc * normals[c, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if length > 1e-12:
            out[i, 0], out[i, 1], out[i, 2] = x / length, y / length, z / length
    return out


@njit(cache=True, nogil=True)
def splat(
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    radii_px: NDArray[np.float64],
    normals: NDArray[np.float64],
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
) -> None:
    """Draw samples as discs that face the camera; the nearest wins, the first among equals.

    Parameters
    ----------
    pixels : (n, 2); NaN draws nothing.
    depths : (n,) along the camera's axis; what is not positive draws nothing.
    radii_px : (n,); the pixel a sample lies in is always drawn.
    normals : (n, 3).
    depth : (h, w) nearest so far, infinite for none; changed in place.
    normal : (h, w, 3) of the nearest; changed in place.
    """
    height, width = depth.shape
    for i in range(len(pixels)):
        x, y, r = pixels[i, 0], pixels[i, 1], radii_px[i]
        z = np.float32(depths[i])
        if not (z > 0.0 and x > -r and y > -r and x < width + r and y < height + r):
            continue
        row, column = math.floor(y), math.floor(x)
        first, last = math.ceil(y - r - 0.5), math.floor(y + r - 0.5)
        for j in range(max(min(first, row), 0), min(max(last, row), height - 1) + 1):
            down = j + 0.5 - y
            reach = math.sqrt(max(r * r - down * down, 0.0))
            left, right = math.ceil(x - reach - 0.5), math.floor(x + reach - 0.5)
            if j == row:
                left, right = min(left, column), max(right, column)
            for i2 in range(max(left, 0), min(right, width - 1) + 1):
                if z < depth[j, i2]:
                    depth[j, i2] = z
                    for k in range(3):
                        normal[j, i2, k] = normals[i, k]


@njit(cache=True, nogil=True)
def between_pixels(
    picture: NDArray[np.float32], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Linear values (n, c) of a picture (h, w, c) at pixels (n, 2), middles at halves.

    The picture goes on at its edges as they are; NaN for pixels that are NaN.
    """
    height, width, channels = picture.shape
    out = np.empty((len(pixels), channels))
    for i in range(len(pixels)):
        x, y = pixels[i, 0] - 0.5, pixels[i, 1] - 0.5
        if not (math.isfinite(x) and math.isfinite(y)):
            out[i, :] = np.nan
            continue
        x = min(max(x, 0.0), width - 1.0)
        y = min(max(y, 0.0), height - 1.0)
        left, top = int(x), int(y)
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        u, v = x - left, y - top
        for k in range(channels):
            above = (1.0 - u) * picture[top, left, k] + u * picture[top, right, k]
            below = (1.0 - u) * picture[bottom, left, k] + u * picture[bottom, right, k]
            out[i, k] = (1.0 - v) * above + v * below
    return out
