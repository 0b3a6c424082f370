"""Colour and gloss of worn paint over weathered stone, as functions of position."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.gradient_noise import gradient_noise, pit_depth

# Zones of paint, rows of the palette that callers give.
DRESS, MANTLE, TRIM, BAND, SKIN, HAIR, ZONES = 0, 1, 2, 3, 4, 5, 6


@njit(cache=True, nogil=True)
def _step(value: float, low: float, high: float) -> float:
    """0 below ``low``, 1 above ``high``, smooth between."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(cache=True, nogil=True)
def _zone(x: float, y: float, z: float, warp: float) -> int:
    """Which paint a point of the figure wears; coordinates in figure heights."""
    azimuth = np.arctan2(x, y)
    if z > 0.832 - 0.40 * y + 0.006 * warp:
        if y < -0.012 + 0.25 * (z - 0.93) + 0.02 * warp or z > 0.965 + 0.012 * warp:
            return HAIR
        return SKIN
    edge = 0.60 + 0.10 * np.sin(azimuth + 0.7) + 0.012 * warp
    if z > edge:
        return MANTLE
    if z > edge - 0.022:
        return BAND
    if z < 0.15 + 0.004 * warp:
        # A band of lozenges along the hem.
        lozenge = abs(((azimuth * 7.0) / np.pi) % 1.0 - 0.5) * 0.05
        return TRIM if abs(z - 0.122) + lozenge > 0.020 else BAND
    return DRESS


@njit(cache=True, nogil=True)
def weathered_stone(
    x: float, y: float, z: float, detail: float, seed: int
) -> tuple[float, float, float]:
    """Linear RGB of weathered limestone; coordinates in metres at the scale of a figure."""
    clouds = gradient_noise(x / 0.21, y / 0.21, z / 0.21, seed + 11)
    blotch = gradient_noise(x / 0.047, y / 0.047, z / 0.047, seed + 12)
    streak = gradient_noise(x / 0.021, y / 0.021, z / 0.24, seed + 13)
    iron = gradient_noise(x / 0.083, y / 0.083, z / 0.083, seed + 14)
    grain = gradient_noise(x / 0.0042, y / 0.0042, z / 0.0042, seed + 15)
    fine = gradient_noise(x / 0.0013, y / 0.0013, z / 0.0013, seed + 16)
    value = 1.0 + 0.15 * clouds + 0.10 * blotch - 0.22 * _step(streak, 0.15, 0.55)
    value *= 1.0 + detail * (0.13 * grain + 0.12 * fine)
    value *= 1.0 - detail * 0.55 * pit_depth(x / 0.009, y / 0.009, z / 0.009, 0.5, seed + 17)
    value *= 1.0 - detail * 0.45 * pit_depth(x / 0.0033, y / 0.0033, z / 0.0033, 0.4, seed + 18)
    rust = _step(iron, 0.12, 0.5)
    red = 0.56 * value * (1.0 - 0.10 * rust)
    green = 0.485 * value * (1.0 - 0.28 * rust)
    blue = 0.385 * value * (1.0 - 0.52 * rust)
    crust = _step(blotch + 0.8 * clouds + 0.35 * grain * detail, 0.45, 0.75)
    return (
        red + crust * (0.115 - red) * 0.75,
        green + crust * (0.110 - green) * 0.75,
        blue + crust * (0.095 - blue) * 0.75,
    )


@njit(cache=True, nogil=True)
def object_paint(
    points: NDArray[np.float64],
    scale: float,
    height: float,
    base_top: float,
    palette: NDArray[np.float64],
    seed: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Albedo, gloss and roughness of a painted or bare object.

    Parameters
    ----------
    points : (n, 3) local coordinates, z up, the figure facing +y.
    scale : size of all patterns relative to those of a figure of 1.2 m.
    height : of the figure in metres; where its zones of paint lie.
    base_top : below this height the stone is bare.
    palette : (`ZONES`, 3) linear RGB of each zone, or (0, 3) for bare stone.
    seed : which pattern.

    Returns
    -------
    albedo : (n, 3) float32 linear RGB in (0, 1).
    gloss : (n,) float32, 1 for a full coat of varnish.
    roughness : (n,) float32 of the gloss, GGX α.
    """
    n = len(points)
    albedo = np.empty((n, 3), np.float32)
    gloss = np.empty(n, np.float32)
    roughness = np.empty(n, np.float32)
    for i in range(n):
        x, y, z = points[i, 0] / scale, points[i, 1] / scale, points[i, 2] / scale
        # Calm areas alternate with busy ones, for matching and for labelling alike.
        busy = gradient_noise(x / 0.26, y / 0.26, z / 0.26, seed + 1)
        detail = 0.18 + 0.95 * _step(busy, -0.30, 0.12)
        red, green, blue = weathered_stone(x, y, z, detail, seed)
        sheen, rough = 0.10, 0.60
        if len(palette) > 0 and points[i, 2] > base_top:
            warp = gradient_noise(x / 0.05, y / 0.05, z / 0.05, seed + 2)
            warp += 0.4 * gradient_noise(x / 0.011, y / 0.011, z / 0.011, seed + 3)
            zone = _zone(points[i, 0] / height, points[i, 1] / height, points[i, 2] / height, warp)
            survival = 0.13 + 0.38 * gradient_noise(x / 0.19, y / 0.19, z / 0.19, seed + 4)
            survival += 0.20 * warp
            chips = gradient_noise(x / 0.017, y / 0.017, z / 0.017, seed + 5)
            chips += 0.75 * gradient_noise(x / 0.0055, y / 0.0055, z / 0.0055, seed + 6)
            chips += 0.45 * gradient_noise(x / 0.0021, y / 0.0021, z / 0.0021, seed + 19)
            if zone >= SKIN:
                survival += 0.10
            survival += 0.26 * chips * (0.35 + 0.65 * detail)
            cover = _step(survival, -0.01, 0.015)
            if cover > 0.0:
                thin = 0.70 + 0.30 * _step(survival, 0.0, 0.16)
                fade = 0.5 + 0.5 * gradient_noise(x / 0.12, y / 0.12, z / 0.12, seed + 7)
                stroke = gradient_noise(x / 0.0024, y / 0.0024, z / 0.015, seed + 8)
                crack = abs(gradient_noise(x / 0.0045, y / 0.0045, z / 0.0045, seed + 9))
                pigment = gradient_noise(x / 0.0011, y / 0.0011, z / 0.0011, seed + 22)
                tone = 1.0 + 0.30 * (fade - 0.5) + detail * (0.14 * stroke + 0.13 * pigment)
                # Old paint crackles in patches, and the lines open and close.
                crackled = detail * _step(fade + 0.5 * stroke + 0.4 * chips, 0.35, 0.85)
                tone *= 1.0 - 0.45 * crackled * (1.0 - _step(crack, 0.01, 0.09))
                tone *= 1.0 - detail * 0.5 * pit_depth(
                    x / 0.006, y / 0.006, z / 0.006, 0.5, seed + 23
                )
                share = cover * thin
                # Old paint lets the stone shine through and takes on its warm grey.
                pale = 0.16 + 0.22 * fade
                pr = palette[zone, 0] + pale * (0.9 * red - palette[zone, 0])
                pg = palette[zone, 1] + pale * (0.9 * green - palette[zone, 1])
                pb = palette[zone, 2] + pale * (0.9 * blue - palette[zone, 2])
                red += share * (pr * tone - red)
                green += share * (pg * tone - green)
                blue += share * (pb * tone - blue)
                coat = gradient_noise(x / 0.23, y / 0.23, z / 0.23, seed + 10)
                varnish = _step(coat, -0.05, 0.15) * cover
                sheen += varnish * (1.0 - sheen)
                rough += varnish * (0.13 + 0.08 * fade - rough)
        # Grime ran down and settled in spots, over paint and stone alike.
        run = gradient_noise(x / 0.014, y / 0.014, z / 0.17, seed + 20)
        spots = gradient_noise(x / 0.03, y / 0.03, z / 0.03, seed + 21)
        grime = 0.42 * _step(run + 0.5 * busy, 0.18, 0.62) + 0.30 * _step(spots, 0.2, 0.6)
        red += grime * (0.085 - red)
        green += grime * (0.075 - green)
        blue += grime * (0.062 - blue)
        sheen *= 1.0 - 0.8 * grime
        albedo[i, 0] = min(max(red, 0.012), 0.92)
        albedo[i, 1] = min(max(green, 0.012), 0.92)
        albedo[i, 2] = min(max(blue, 0.012), 0.92)
        gloss[i] = sheen
        roughness[i] = rough
    return albedo, gloss, roughness


@njit(cache=True, nogil=True)
def mottled_color(
    points: NDArray[np.float64],
    color: NDArray[np.float64],
    coarse_m: float,
    fine_m: float,
    amount: float,
    seed: int,
) -> NDArray[np.float32]:
    """One linear RGB colour (3,) with two scales of blotches: albedo (n, 3) float32."""
    albedo = np.empty((len(points), 3), np.float32)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        tone = 1.0 + amount * gradient_noise(x / coarse_m, y / coarse_m, z / coarse_m, seed)
        tone += 0.8 * amount * gradient_noise(x / fine_m, y / fine_m, z / fine_m, seed + 1)
        for k in range(3):
            albedo[i, k] = max(color[k] * tone, 0.005)
    return albedo
