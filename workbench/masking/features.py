"""What a pixel and its neighbourhood look like, as numbers for a learned classifier."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.masking.quantisation import photograph

# Gaussian neighbourhoods, pixels of the image looked at.
_COLOR_SIGMAS_PX = (0.0, 2.5, 6.0, 14.0)
_TINT_SIGMAS_PX = (0.7, 2.5, 6.0)
_SHAPE_SIGMAS_PX = (1.0, 2.5, 6.0, 14.0)
# Of 255: below it a channel's share of the light is mostly noise.
_DARK_LEVEL = 12.0
FEATURES = 3 * len(_COLOR_SIGMAS_PX) + 2 * len(_TINT_SIGMAS_PX) + 3 * len(_SHAPE_SIGMAS_PX)


def pixel_features(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Colour, tint and texture around every pixel at several sizes.

    Parameters
    ----------
    image : (h, w, 3) uint8 sRGB.

    Returns
    -------
    (h, w, ``FEATURES``) float32: CIE L*a*b* means; red's and blue's share of the light,
    which shading does not change; and per size the contrast of L* and the two eigenvalues of
    its Hessian, largest first, times the size squared: what tells a rod from a fold.

    Raises
    ------
    InputError : not 8-bit RGB.
    """
    rgb = photograph(image).astype(np.float32)
    lab = np.asarray(cv2.cvtColor(rgb / np.float32(255), cv2.COLOR_RGB2LAB), np.float32)
    found = np.empty((*image.shape[:2], FEATURES), np.float32)
    place = 0
    for sigma in _COLOR_SIGMAS_PX:
        found[..., place : place + 3] = _blurred(lab, sigma)
        place += 3
    for sigma in _TINT_SIGMAS_PX:
        mean = _blurred(rgb, sigma)
        light = mean.sum(axis=2) + np.float32(3.0 * _DARK_LEVEL)
        for channel in (0, 2):
            found[..., place] = (mean[..., channel] + np.float32(_DARK_LEVEL)) / light
            place += 1
    lightness = np.ascontiguousarray(lab[..., 0])
    for sigma in _SHAPE_SIGMAS_PX:
        found[..., place : place + 3] = _texture(lightness, sigma)
        place += 3
    return found


def _texture(lightness: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    wide = 2.0 * sigma
    mean = _blurred(lightness, wide)
    variance = _blurred(lightness * lightness, wide) - mean * mean
    smooth = _blurred(lightness, sigma)
    xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((2, 0), (0, 2), (1, 1)))
    apart = np.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)
    scale = np.float32(0.5 * sigma * sigma)
    return np.dstack(
        [
            np.sqrt(np.maximum(variance, 0.0)),
            (xx + yy + apart) * scale,
            (xx + yy - apart) * scale,
        ]
    )


def _blurred(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    if not sigma_px:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)
