"""Two-material scenes: a red, shaded, textured disc on a blue-green, noisy ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def photograph(
    seed: int, side: int = 240, centre: tuple[float, float] = (0.5, 0.5)
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """(side, side, 3) uint8 RGB and (side, side) uint8 true mask."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side] / side
    disc = np.hypot(x - centre[0], y - centre[1]) < 0.28
    shade = 0.5 + 0.5 * x
    color = np.where(disc[..., None], (190.0, 70.0, 60.0), (60.0, 120.0, 140.0))
    image = color * shade[..., None] + rng.normal(0, 18, (side, side, 3))
    return np.clip(image, 0, 255).astype(np.uint8), np.where(disc, 255, 0).astype(np.uint8)


def range_map(seed: int, side: int = 200) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Reflectance in [0, 1], one corner without return, and the true mask."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side] / side
    disc = np.hypot(x - 0.5, y - 0.5) < 0.3
    value = np.where(disc, 0.7, 0.35) + rng.normal(0, 0.12, disc.shape)
    value[: side // 10, : side // 10] = np.nan
    return value.astype(np.float32), np.where(disc, 255, 0).astype(np.uint8)
