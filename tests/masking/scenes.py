"""Two-material scenes: a red, shaded, textured disc on a blue-green, noisy ground."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError


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


def range_map_channels(
    reflectance: NDArray[np.floating],
    range_m: NDArray[np.floating],
    normals: NDArray[np.floating] | None = None,
) -> NDArray[np.uint8]:
    """Reflectance, depth discontinuity and slant of a range map, for graph cuts.

    Parameters
    ----------
    reflectance : (h, w) float in [0, 1], NaN for no return.
    range_m : (h, w) distance along the ray, metres, NaN for no return.
    normals : (h, w, 3) unit normals in the scan's frame, NaN where unknown; None leaves
        the slant out. Its channel is the normal's vertical (third) component.

    Returns
    -------
    (h, w, 3) uint8. A pixel 5 % farther than a neighbour, or more, is 255.
    """
    if reflectance.shape != range_m.shape:
        raise InputError(
            "reflectance and range must be of the same map",
            expected=str(reflectance.shape),
            found=str(range_m.shape),
        )
    known = np.isfinite(range_m)
    distance = np.where(known, range_m, np.inf).astype(np.float32)
    nearest = cv2.erode(distance, np.ones((3, 3), np.uint8))
    # On the far side only: the near surface is whole up to its silhouette.
    jump = np.zeros(distance.shape, np.float32)
    jump[known] = 20.0 * (1.0 - nearest[known] / np.maximum(distance[known], 1e-6))
    if normals is None:
        slant = np.zeros(distance.shape, np.float32)
    else:
        slant = 0.5 + 0.5 * np.nan_to_num(normals[..., 2], nan=0.0).astype(np.float32)
    shown = np.nan_to_num(reflectance, nan=0.0)
    channels = np.clip(np.dstack([shown, jump, slant]), 0, 1)
    return np.asarray((255 * channels).round(), np.uint8)
