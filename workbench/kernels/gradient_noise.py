"""Perlin gradient noise and scattered pits as functions of position."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def lattice_hash(i: int, j: int, k: int, seed: int) -> int:
    """A well-mixed integer in [0, 2³¹) for an integer lattice point and a seed."""
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791) ^ (seed * 2654435761)
    h = (h ^ (h >> 15)) * 2246822519
    h &= 0xFFFFFFFF
    h = (h ^ (h >> 13)) * 3266489917
    h &= 0xFFFFFFFF
    return (h ^ (h >> 16)) & 0x7FFFFFFF


@njit(cache=True, nogil=True)
def _corner(h: int, x: float, y: float, z: float) -> float:
    """Dot product of an offset with one of Perlin's twelve edge gradients."""
    g = h & 15
    u = x if g < 8 else y
    if g < 4:
        v = y
    elif g == 12 or g == 14:
        v = x
    else:
        v = z
    return (u if g & 1 == 0 else -u) + (v if g & 2 == 0 else -v)


@njit(cache=True, nogil=True)
def gradient_noise(x: float, y: float, z: float, seed: int) -> float:
    """Perlin's improved noise (Perlin 2002) with unit wavelength, about [−1, 1]."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - i, y - j, z - k
    ux = fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0)
    uy = fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0)
    uz = fz * fz * fz * (fz * (fz * 6.0 - 15.0) + 10.0)
    total = 0.0
    for dx in range(2):
        wx = ux if dx else 1.0 - ux
        for dy in range(2):
            wy = uy if dy else 1.0 - uy
            for dz in range(2):
                wz = uz if dz else 1.0 - uz
                h = lattice_hash(i + dx, j + dy, k + dz, seed)
                total += wx * wy * wz * _corner(h, fx - dx, fy - dy, fz - dz)
    return total


@njit(cache=True, nogil=True)
def pit_depth(x: float, y: float, z: float, density: float, seed: int) -> float:
    """Depth in [0, 1] of round pits, at most one per unit cell, of radius 0.15 to 0.5.

    ``density`` is the share of the cells that hold a pit. The eight nearest cells are
    enough because no pit reaches further than half a cell from its centre.
    """
    i0, j0, k0 = math.floor(x - 0.5), math.floor(y - 0.5), math.floor(z - 0.5)
    deepest = 0.0
    for i in range(i0, i0 + 2):
        for j in range(j0, j0 + 2):
            for k in range(k0, k0 + 2):
                h = lattice_hash(i, j, k, seed)
                if (h & 0xFFFF) / 65536.0 >= density:
                    continue
                g = lattice_hash(i, j, k, seed + 101)
                px = i + 0.5 + ((g & 255) / 255.0 - 0.5) * 0.5
                py = j + 0.5 + (((g >> 8) & 255) / 255.0 - 0.5) * 0.5
                pz = k + 0.5 + (((g >> 16) & 255) / 255.0 - 0.5) * 0.5
                radius = 0.15 + 0.35 * (((h >> 16) & 1023) / 1023.0) ** 2
                s = ((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2) / (radius * radius)
                if s < 1.0:
                    deepest = max(deepest, 2.0 * radius * (1.0 - s) * (1.0 - s))
    return deepest


@njit(cache=True, nogil=True)
def _noise_at(
    points: NDArray[np.float64], wavelength: NDArray[np.float64], seed: int
) -> NDArray[np.float64]:
    out = np.empty(len(points))
    for n in range(len(points)):
        out[n] = gradient_noise(
            points[n, 0] / wavelength[0],
            points[n, 1] / wavelength[1],
            points[n, 2] / wavelength[2],
            seed,
        )
    return out


def noise_at(
    points: NDArray[np.float64], wavelength_m: tuple[float, float, float] | float, seed: int
) -> NDArray[np.float64]:
    """Gradient noise (n,) float64 in about [−1, 1] at points (n, 3).

    Parameters
    ----------
    points : (n, 3) float64, metres.
    wavelength_m : one wavelength, or one per axis for stretched noise.
    seed : which noise.

    Notes
    -----
    Zero on the noise's own lattice, smooth in between (Perlin 2002, "Improving noise").
    """
    wavelength = np.broadcast_to(np.asarray(wavelength_m, float), (3,)).copy()
    values: NDArray[np.float64] = _noise_at(np.ascontiguousarray(points, float), wavelength, seed)
    return values
