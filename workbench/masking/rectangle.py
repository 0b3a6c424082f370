"""A mask from nothing but a rectangle drawn around the object.

Plain GrabCut starts by believing that all inside the rectangle is the object. Here the
histogram outside says which colours inside are the background's, so the cut starts nearer
its end, and it is made in CIE L*a*b*, where Gaussians fit shaded colours better.

Source: Rother, Kolmogorov and Blake 2004, section 3; Jaspe, section 3.4.3.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from workbench.errors import InputError
from workbench.masking import graphcut
from workbench.masking.classifier import at_side
from workbench.masking.segmentation import SegmentationOptions, cut

_BINS = 24
# How much of a rectangle is background, before looking.
_BACKGROUND_PART = 0.6
_NOISE_SIGMA_PX = 5.0

RECTANGLE_DEFAULTS = SegmentationOptions(coarse_side_px=640, finer_levels=4, iterations=5)


def segmented_in_rectangle(
    image: NDArray[np.uint8],
    rectangle: tuple[int, int, int, int],
    options: SegmentationOptions = RECTANGLE_DEFAULTS,
) -> NDArray[np.uint8]:
    """The mask of the object inside a rectangle.

    Parameters
    ----------
    image : (h, w, 3) uint8 RGB.
    rectangle : left, top, right, bottom in pixels, the last two exclusive; the object is
        inside, and some background is outside.

    Returns
    -------
    (h, w) uint8, 255 = keep.

    Raises
    ------
    InputError : the rectangle is empty, leaves the image or covers all of it.
    """
    height, width = image.shape[:2]
    left, top, right, bottom = rectangle
    if not (0 <= left < right <= width and 0 <= top < bottom <= height):
        raise InputError(
            "the rectangle must lie in the image",
            expected=f"0 ≤ left < right ≤ {width}, 0 ≤ top < bottom ≤ {height}",
            found=str(rectangle),
        )
    if (right - left) * (bottom - top) == width * height:
        raise InputError(
            "the rectangle covers the whole image, so nothing shows the background",
            fix="draw it tighter around the object",
        )
    coarse = np.asarray(at_side(image, options.coarse_side_px), np.uint8)
    scale = coarse.shape[1] / width
    inside = np.zeros(coarse.shape[:2], bool)
    inside[
        int(np.floor(top * scale)) : int(np.ceil(bottom * scale)),
        int(np.floor(left * scale)) : int(np.ceil(right * scale)),
    ] = True
    likely = _foreground_probability(_lab(coarse), inside)
    seeds = np.full(inside.shape, graphcut.SURE_CLUTTER, np.uint8)
    seeds[inside] = graphcut.MAYBE_CLUTTER
    maybe = inside & (likely >= 0.5)
    # An object of the background's colours: nothing to start from but the rectangle.
    seeds[maybe if maybe.sum() > 0.01 * inside.sum() else inside] = graphcut.MAYBE_FOREGROUND
    return cut(_lab(image), seeds, options)


def _lab(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2LAB), np.uint8)


def _foreground_probability(
    lab: NDArray[np.uint8], inside: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """How much commoner a pixel's colour is inside than the background there explains."""
    level = lab.astype(np.int32) * _BINS // 256
    bins = (level[..., 0] * _BINS + level[..., 1]) * _BINS + level[..., 2]
    inner, outer = (_density(bins[where]) for where in (inside, ~inside))
    ratio = np.clip(1.0 - _BACKGROUND_PART * outer / np.maximum(inner, 1e-12), 0.0, 1.0)
    probability = np.where(inside, ratio[bins], 0.0).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(probability, (0, 0), _NOISE_SIGMA_PX), np.float32)


def _density(bins: NDArray[np.int32]) -> NDArray[np.float64]:
    counts = np.bincount(bins, minlength=_BINS**3).astype(np.float64)
    smooth = np.asarray(gaussian_filter(counts.reshape(_BINS, _BINS, _BINS), 1.0)).ravel()
    return np.asarray(smooth / max(smooth.sum(), 1.0), np.float64)
