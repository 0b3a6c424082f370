"""Rays that sample pixels, the aperture of a lens and the window of a flash."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.gradient_noise import lattice_hash
from workbench.kernels.lens_distortion import undistorted_point

# Steps of the R2 sequence (Roberts 2018): the most even spread of points in a square.
_R2_X, _R2_Y = 0.7548776662466927, 0.5698402909980532


@njit(cache=True, nogil=True)
def _spread(place: int) -> tuple[float, float]:
    """Point of the unit square number ``place``; pairs are mirrored about the middle."""
    half = place // 2 + 1
    x, y = (0.5 + half * _R2_X) % 1.0, (0.5 + half * _R2_Y) % 1.0
    if place % 2 == 1:
        return 1.0 - x, 1.0 - y
    return x, y


@njit(cache=True, nogil=True)
def _shifted_spread(place: int, pixel: int, salt: int, seed: int) -> tuple[float, float]:
    """A point of the unit square, the whole sequence shifted at random for every pixel."""
    h = lattice_hash(pixel, salt, 7, seed)
    x, y = (h & 0x7FFF) / 32768.0, ((h >> 15) & 0x7FFF) / 32768.0
    return (x + (place + 1) * _R2_X) % 1.0, (y + (place + 1) * _R2_Y) % 1.0


@njit(cache=True, nogil=True)
def camera_rays(
    pixels: NDArray[np.int64],
    samples: NDArray[np.int64],
    count: int,
    width: int,
    intrinsics: NDArray[np.float64],
    rotation: NDArray[np.float64],
    origin: NDArray[np.float64],
    lens: NDArray[np.float64],
    seed: int,
) -> NDArray[np.float32]:
    """Rays (n, 6) float32 through samples of pixels: origin and unit direction.

    Parameters
    ----------
    pixels : (n,) row · width + column.
    samples : (n,) which sample of its pixel, in [0, count).
    count : samples that share a pixel's area; a single one goes through its centre.
    width : columns of the picture.
    intrinsics : focal length, cx, cy, k1, k2, p1, p2; pixels.
    rotation, origin : camera to local frame.
    lens : radius of the aperture and distance of sharp focus, metres; radius 0 is a pinhole.
    seed : of the points on the aperture.
    """
    out = np.empty((len(pixels), 6), np.float32)
    focal, cx, cy, k1, k2, p1, p2 = intrinsics
    for i in range(len(pixels)):
        su, sv = 0.5, 0.5
        if count > 1:
            su, sv = _spread(samples[i])
        u = (pixels[i] % width + su - cx) / focal
        v = (pixels[i] // width + sv - cy) / focal
        x, y = undistorted_point(u, v, k1, k2, p1, p2)
        ax, ay = 0.0, 0.0
        z = 1.0
        if lens[0] > 0.0:
            r, turn = _shifted_spread(samples[i], pixels[i], 3, seed)
            ax = lens[0] * math.sqrt(r) * math.cos(2.0 * math.pi * turn)
            ay = lens[0] * math.sqrt(r) * math.sin(2.0 * math.pi * turn)
            x, y, z = x * lens[1] - ax, y * lens[1] - ay, lens[1]
        length = math.sqrt(x * x + y * y + z * z)
        for k in range(3):
            out[i, k] = origin[k] + rotation[k, 0] * ax + rotation[k, 1] * ay
            out[i, 3 + k] = (rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z) / length
    return out


@njit(cache=True, nogil=True)
def flash_rays(
    points: NDArray[np.float64],
    normals: NDArray[np.float32],
    pixels: NDArray[np.int64],
    samples: NDArray[np.int64],
    middle: NDArray[np.float64],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
    clearance: float,
    seed: int,
) -> NDArray[np.float32]:
    """Rays (n, 6) float32 from surface points to points of the flash; direction not unit.

    Parameters
    ----------
    points, normals : (n, 3) of the surface.
    pixels, samples : (n,) choose the point of the flash.
    middle, across, down : (3,) middle and edge vectors of the rectangular flash.
    clearance : how far the rays start off the surface, metres.
    seed : of the points on the flash.
    """
    out = np.empty((len(points), 6), np.float32)
    for i in range(len(points)):
        s, t = _shifted_spread(samples[i], pixels[i], 5, seed)
        for k in range(3):
            start = points[i, k] + clearance * normals[i, k]
            target = middle[k] + (s - 0.5) * across[k] + (t - 0.5) * down[k]
            out[i, k] = start
            out[i, 3 + k] = target - start
    return out
