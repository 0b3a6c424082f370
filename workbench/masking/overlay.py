"""Masks to look at: over their picture, and beside their truth."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# Apart in lightness as well as in hue, so that nobody mistakes one for another.
CLUTTER_TINT = (38, 66, 132)
OUTLINE = (255, 214, 64)
RIGHT_KEPT, RIGHT_AWAY = (240, 238, 232), (46, 45, 43)
KEPT_WRONGLY, MISSED, MISSED_FOR_GOOD = (240, 196, 32), (34, 139, 120), (196, 44, 32)


def overlay(picture: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture with what is masked away darkened and blue, and the mask's edge as a line.

    Parameters
    ----------
    picture : (h, w, 3) uint8 sRGB.
    mask : (h, w) uint8, 255 = keep.
    """
    away = mask <= 127
    shown = picture.copy()
    tint = np.array(CLUTTER_TINT, np.float32)
    shown[away] = (0.35 * picture[away] + 0.65 * tint * 0.8).astype(np.uint8)
    kept = np.where(away, 0, 1).astype(np.uint8)
    inner = cv2.erode(kept, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    shown[kept != inner] = OUTLINE
    return shown


def difference(
    mask: NDArray[np.uint8],
    truth: NDArray[np.uint8],
    covered: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Where a mask is right and wrong, (h, w, 3) uint8, in the colours of this module.

    Parameters
    ----------
    mask, truth : (h, w) uint8, 255 = keep.
    covered : (h, w) bool, places that another scan or photograph keeps; without it every
        missed one is painted as `MISSED`.
    """
    kept, model = mask > 127, truth > 127
    shown = np.empty((*mask.shape, 3), np.uint8)
    shown[kept & model], shown[~kept & ~model] = RIGHT_KEPT, RIGHT_AWAY
    shown[kept & ~model], shown[~kept & model] = KEPT_WRONGLY, MISSED
    if covered is not None:
        shown[~kept & model & ~covered] = MISSED_FOR_GOOD
    return shown
