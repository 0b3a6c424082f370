"""GrabCut on arrays: five Gaussians per region, the same mask each time.

Source: Rother, Kolmogorov and Blake 2004; OpenCV's ``grabCut``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

# OpenCV's models hold five Gaussians of three channels: weight, mean, covariance.
_MODEL = (1, 65)
_NO_RECTANGLE = (0, 0, 1, 1)
# k-means on fewer pixels than this makes singular Gaussians.
_LEAST_PIXELS = 32
_TILE_PX, _CONTEXT_PX = 128, 8

SURE_CLUTTER, SURE_FOREGROUND = cv2.GC_BGD, cv2.GC_FGD
MAYBE_CLUTTER, MAYBE_FOREGROUND = cv2.GC_PR_BGD, cv2.GC_PR_FGD


@dataclass(frozen=True)
class Solution:
    """A cut and the colour models it ended with; no models where there was nothing to cut.

    Attributes
    ----------
    foreground : (h, w) bool.
    models : (2, 65) float64, clutter and foreground, or None.
    """

    foreground: NDArray[np.bool_]
    models: NDArray[np.float64] | None


def solved(image: NDArray[np.uint8], seeds: NDArray[np.uint8], iterations: int) -> Solution:
    """Learn both regions' colours from the seeds and cut, again and again.

    Parameters
    ----------
    image : (h, w, 3) uint8, any three channels in which regions differ.
    seeds : (h, w) uint8 of this module's four constants.
    """
    labels = seeds.copy()
    foreground = (labels & 1) > 0
    size = int(foreground.sum())
    if min(size, foreground.size - size) < _LEAST_PIXELS:
        return Solution(foreground, None)
    clutter_model, foreground_model = np.zeros(_MODEL), np.zeros(_MODEL)
    cv2.setRNGSeed(0)
    cv2.grabCut(
        image,
        labels,
        _NO_RECTANGLE,
        clutter_model,
        foreground_model,
        iterations,
        cv2.GC_INIT_WITH_MASK,
    )
    return Solution((labels & 1) > 0, np.vstack([clutter_model, foreground_model]))


def colours_of(
    image: NDArray[np.uint8], foreground: NDArray[np.bool_], most_pixels: int
) -> NDArray[np.float64] | None:
    """Both regions' colour models from every n-th row and column.

    Picked, not averaged: a coarse level's noise is too small for the finer one's pixels.
    """
    step = max(1, int(np.sqrt(foreground.size / most_pixels)))
    seeds = np.where(foreground[::step, ::step], SURE_FOREGROUND, SURE_CLUTTER)
    return solved(
        np.ascontiguousarray(image[::step, ::step]), seeds.astype(np.uint8), iterations=1
    ).models


def resolved_in_band(
    image: NDArray[np.uint8],
    guess: NDArray[np.bool_],
    models: NDArray[np.float64],
    band_px: int,
) -> NDArray[np.bool_]:
    """Cut again within ``band_px`` of the guess's boundary, the colours known.

    Solved tile by tile: memory and time follow the boundary's length, not the image's area.
    """
    height, width = guess.shape
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * band_px + 1, 2 * band_px + 1))
    inside = guess.astype(np.uint8)
    grown, shrunk = cv2.dilate(inside, disc), cv2.erode(inside, disc)
    seeds = np.where(inside > 0, MAYBE_FOREGROUND, MAYBE_CLUTTER).astype(np.uint8)
    seeds[grown == 0], seeds[shrunk == 1] = SURE_CLUTTER, SURE_FOREGROUND
    found = guess.copy()
    for top in range(0, height, _TILE_PX):
        for left in range(0, width, _TILE_PX):
            core = np.s_[top : top + _TILE_PX, left : left + _TILE_PX]
            if not (seeds[core] > 1).any():
                continue
            y, x = max(0, top - _CONTEXT_PX), max(0, left - _CONTEXT_PX)
            around = np.s_[y : top + _TILE_PX + _CONTEXT_PX, x : left + _TILE_PX + _CONTEXT_PX]
            labels = seeds[around].copy()
            tile = np.ascontiguousarray(image[around])
            clutter, foreground = models[:1].copy(), models[1:].copy()
            cv2.grabCut(
                tile, labels, _NO_RECTANGLE, clutter, foreground, 1, cv2.GC_EVAL_FREEZE_MODEL
            )
            cut = (labels & 1) > 0
            found[core] = cut[top - y :, left - x :][:_TILE_PX, :_TILE_PX]
    return found
