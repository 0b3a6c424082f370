"""Oriented discs drawn into buffers of depth and number, nearest first."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

NO_DISC = -1
# A disc seen edge-on covers no pixel.
_EDGE_ON = 1e-9


@njit(cache=True, nogil=True)
def draw_discs(
    centers: NDArray[np.float64],
    normals: NDArray[np.float64],
    radii: NDArray[np.float64],
    lens: tuple[float, float, float, float],
    first: int,
    depth: NDArray[np.float64],
    number: NDArray[np.int32],
) -> None:
    """Draw discs through a pinhole; a pixel shows what its middle meets first.

    Parameters
    ----------
    centers, normals : (n, 3) in the camera's frame, x right, y down, z forward; normals unit,
        either way round.
    radii : (n,) in the unit of the centres.
    lens : focal lengths and principal point fx, fy, cx, cy, pixels.
    first : number of the first disc.
    depth : (h, w) along z, infinite where nothing is; brought up to date.
    number : (h, w) of the disc that is seen, `NO_DISC` where none is; brought up to date.
    """
    height, width = depth.shape
    fx, fy, cx, cy = lens
    for i in range(len(centers)):
        center, normal, radius = centers[i], normals[i], radii[i]
        left, right, top, bottom = _window(center, radius, lens, width, height)
        for row in range(top, bottom):
            dy = (row + 0.5 - cy) / fy
            for column in range(left, right):
                dx = (column + 0.5 - cx) / fx
                t, aside = _met(center, normal, dx, dy)
                if 0.0 < t < depth[row, column] and aside <= radius * radius:
                    depth[row, column] = t
                    number[row, column] = first + i


@njit(cache=True, nogil=True)
def blend_discs(
    centers: NDArray[np.float64],
    normals: NDArray[np.float64],
    radii: NDArray[np.float64],
    lens: tuple[float, float, float, float],
    depth: NDArray[np.float64],
    values: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    """Add up, for each pixel, the values of the discs that lie on what it shows.

    Those count whose depth there is no more than their diameter behind ``depth`` (h, w), each
    with a weight of 1 at its middle and 0 at its rim.

    Parameters
    ----------
    centers, normals, radii, lens : as in `draw_discs`.
    depth : (h, w) what `draw_discs` left.
    values : (n, k) of the discs.
    sums : (h, w, k + 1) weighted values and last the weight; added to.
    """
    height, width = depth.shape
    fx, fy, cx, cy = lens
    for i in range(len(centers)):
        center, normal, radius = centers[i], normals[i], radii[i]
        left, right, top, bottom = _window(center, radius, lens, width, height)
        for row in range(top, bottom):
            dy = (row + 0.5 - cy) / fy
            for column in range(left, right):
                dx = (column + 0.5 - cx) / fx
                t, aside = _met(center, normal, dx, dy)
                if not 0.0 < t <= depth[row, column] + 2.0 * radius or aside > radius * radius:
                    continue
                # A rim that is all a pixel has still tells its colour.
                weight = max(1.0 - aside / (radius * radius), 1e-6)
                for k in range(values.shape[1]):
                    sums[row, column, k] += weight * values[i, k]
                sums[row, column, values.shape[1]] += weight


@njit(cache=True, nogil=True)
def _window(
    center: NDArray[np.float64],
    radius: float,
    lens: tuple[float, float, float, float],
    width: int,
    height: int,
) -> tuple[int, int, int, int]:
    """First and last columns and rows, the last ones exclusive, that a disc may show on."""
    fx, fy, cx, cy = lens
    x, y, z = center[0], center[1], center[2]
    if z + radius <= 0.0:
        return 0, 0, 0, 0
    if z <= radius:
        return 0, width, 0, height
    left, right = _span(x, z, radius, fx, cx, width)
    top, bottom = _span(y, z, radius, fy, cy, height)
    return left, right, top, bottom


@njit(cache=True, nogil=True, inline="always")
def _met(
    center: NDArray[np.float64], normal: NDArray[np.float64], dx: float, dy: float
) -> tuple[float, float]:
    """Depth at which a ray (dx, dy, 1) meets a disc's plane, and the square of how far aside.

    The depth is negative where the plane is seen edge-on.
    """
    x, y, z = center[0], center[1], center[2]
    slope = dx * normal[0] + dy * normal[1] + normal[2]
    if abs(slope) < _EDGE_ON:
        return -1.0, 0.0
    t = (x * normal[0] + y * normal[1] + z * normal[2]) / slope
    return t, (t * dx - x) ** 2 + (t * dy - y) ** 2 + (t - z) ** 2


@njit(cache=True, nogil=True)
def _span(
    place: float, z: float, radius: float, focal: float, middle: float, size: int
) -> tuple[int, int]:
    """First pixel of a side and the one after the last that the cube around a ball shows on."""
    near, far = z - radius, z + radius
    low = min((place - radius) / near, (place - radius) / far)
    high = max((place + radius) / near, (place + radius) / far)
    first = math.floor(min(max(low * focal + middle, 0.0), size))
    last = math.ceil(min(max(high * focal + middle, 0.0), size))
    return int(first), int(last)


@njit(cache=True, nogil=True)
def draw_discs_parallel(
    centers: NDArray[np.float64],
    normals: NDArray[np.float64],
    radii: NDArray[np.float64],
    pixel: float,
    depth: NDArray[np.float64],
    number: NDArray[np.int32],
) -> None:
    """`draw_discs` by rays along z; the upper left corner of the picture is at x = y = 0.

    ``pixel`` is the side of one, in the unit of the centres.
    """
    height, width = depth.shape
    for i in range(len(centers)):
        x, y, z = centers[i, 0], centers[i, 1], centers[i, 2]
        u, v, w = normals[i, 0], normals[i, 1], normals[i, 2]
        radius = radii[i]
        if abs(w) < _EDGE_ON:
            continue
        left = max(0, math.floor((x - radius) / pixel))
        right = min(width, math.ceil((x + radius) / pixel))
        top = max(0, math.floor((y - radius) / pixel))
        bottom = min(height, math.ceil((y + radius) / pixel))
        for row in range(top, bottom):
            dy = (row + 0.5) * pixel - y
            for column in range(left, right):
                dx = (column + 0.5) * pixel - x
                dz = -(dx * u + dy * v) / w
                if dx * dx + dy * dy + dz * dz > radius * radius:
                    continue
                if z + dz < depth[row, column]:
                    depth[row, column] = z + dz
                    number[row, column] = i
