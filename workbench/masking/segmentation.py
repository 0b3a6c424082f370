"""From probabilities to a clean mask: graph cuts, coarse to fine, then morphology.

The whole image is cut at a coarse level only; finer levels move the boundary within a band.

Source: Jaspe, section 3.4.3, "Graph cut segmentation" and "Morphological post-pass".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.masking import graphcut
from workbench.masking.classifier import at_side, log_odds
from workbench.masking.energy import cut_by_evidence


@dataclass(frozen=True)
class SegmentationOptions:
    """How a mask is cut out and cleaned.

    Attributes
    ----------
    method : ``evidence`` keeps every pixel's learned evidence in the cut; ``grabcut`` starts
        from it and goes by the image's own colours, as the paper does.
    coarse_side_px : longer side of the level that is cut as a whole.
    finer_levels : levels, each twice as fine, at which the boundary is cut again; fewer
        where the image ends before. The boundary is interpolated from the finest. Finer
        cuts know the image's own colours only: they pay where both sides are well lit.
    iterations : of ``grabcut``: rounds of learning colours and cutting at the coarse level.
        More of them trust the image's own colours more and the training less.
    smoothness : of ``evidence``: log-odds that a boundary costs per pixel of its length
        where there is no edge.
    band_px : half the width of the band that is cut again, pixels of its level.
    sure_foreground, sure_clutter : of ``grabcut``: probabilities beyond which a pixel is
        not asked again.
    least_piece : smaller pieces go, as a part of the largest one's area.
    largest_hole : smaller holes close, as a part of the image's area.
    median_px : side of the median filter, odd; 0 for none.
    erosion_px : how far the octagon eats into the mask; 0 for none.
    """

    method: Literal["evidence", "grabcut"] = "evidence"
    coarse_side_px: int = 800
    finer_levels: int = 0
    iterations: int = 1
    smoothness: float = 32.0
    band_px: int = 4
    sure_foreground: float = 0.97
    sure_clutter: float = 0.03
    least_piece: float = 0.02
    largest_hole: float = 0.002
    median_px: int = 5
    erosion_px: int = 4

    def __post_init__(self) -> None:
        if min(self.finer_levels, self.median_px, self.erosion_px) < 0:
            raise SettingsError("levels, median and erosion of masking must not be negative")
        if min(self.iterations, self.band_px) < 1 or self.coarse_side_px < 16:
            raise SettingsError("masking needs an iteration, a band and sixteen pixels a side")
        if self.median_px and self.median_px % 2 == 0:
            raise SettingsError("the median filter's side must be odd", found=str(self.median_px))
        if not 0 <= self.sure_clutter < 0.5 < self.sure_foreground <= 1:
            raise SettingsError("0 ≤ sure_clutter < 0.5 < sure_foreground ≤ 1 must hold")
        if self.smoothness < 0:
            raise SettingsError("the smoothness of masks must not be negative")


def segmented(
    image: NDArray[np.uint8],
    probability: NDArray[np.float32],
    options: SegmentationOptions | None = None,
) -> NDArray[np.uint8]:
    """The mask of what is probably foreground, along the image's own boundaries.

    Parameters
    ----------
    image : (h, w, 3) uint8 RGB, or any three channels in which regions differ.
    probability : (h', w') float32 of foreground in [0, 1], of any size; NaN, unknown, is
        taken from the neighbourhood.

    Returns
    -------
    (h, w) uint8, 255 = keep, 0 = clutter.

    Raises
    ------
    InputError : the image is not three channels of 8 bits.
    """
    options = options or SegmentationOptions()
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "graph cuts need three channels of 8 bits",
            expected="(h, w, 3) uint8",
            found=f"{image.shape} {image.dtype}",
        )
    coarse = np.asarray(at_side(image, options.coarse_side_px), np.uint8)
    height, width = coarse.shape[:2]
    size = (width, height)
    if options.method == "evidence":
        told = cv2.resize(log_odds(probability), size, interpolation=cv2.INTER_LINEAR)
        evidence = np.asarray(told, np.float32)
        found = cut_by_evidence(coarse, evidence, options.smoothness)
        return _refined(image, found, options)
    likely = cv2.resize(_filled(probability), size, interpolation=cv2.INTER_LINEAR)
    seeds = np.where(likely > 0.5, graphcut.MAYBE_FOREGROUND, graphcut.MAYBE_CLUTTER)
    seeds[likely > options.sure_foreground] = graphcut.SURE_FOREGROUND
    seeds[likely < options.sure_clutter] = graphcut.SURE_CLUTTER
    return cut(image, seeds.astype(np.uint8), options)


def cut(
    image: NDArray[np.uint8], seeds: NDArray[np.uint8], options: SegmentationOptions
) -> NDArray[np.uint8]:
    """The mask that grows from seeds at the coarse level, (h', w') uint8 of ``graphcut``."""
    coarse = np.asarray(at_side(image, options.coarse_side_px), np.uint8)
    solution = graphcut.solved(coarse, seeds, options.iterations)
    return _refined(image, solution.foreground, options)


def _refined(
    image: NDArray[np.uint8], coarse: NDArray[np.bool_], options: SegmentationOptions
) -> NDArray[np.uint8]:
    """The coarse cut's boundary cut again at finer levels, and cleaned."""
    height, width = image.shape[:2]
    found = _without_specks(coarse, options)
    side, full = max(found.shape), max(height, width)
    for _ in range(options.finer_levels if found.any() and not found.all() else 0):
        if side >= full:
            break
        # Twice as fine, and all the way where little would be left.
        side = full if side * 2 * 1.25 >= full else side * 2
        level = np.asarray(at_side(image, side), np.uint8)
        guess = _enlarged(found, level.shape[:2])
        models = graphcut.colours_of(level, guess, coarse.size)
        found = guess
        if models is not None:
            found = graphcut.resolved_in_band(level, guess, models, options.band_px)
    if side < full:
        found = _enlarged(found, (height, width))
    return _finished(found, options)


def _filled(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unknown pixels get the mean of the known ones around, near ones first; else 0.5."""
    filled, radius = probability.astype(np.float32), 2.0
    while np.isnan(filled).any() and radius < max(filled.shape):
        known = np.isfinite(filled)
        weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), radius)
        total = cv2.GaussianBlur(np.where(known, filled, 0).astype(np.float32), (0, 0), radius)
        reached = ~known & (weight > 0.01)
        filled[reached] = total[reached] / weight[reached]
        radius *= 2.0
    return np.asarray(np.nan_to_num(filled, nan=0.5), np.float32)


def _without_specks(found: NDArray[np.bool_], options: SegmentationOptions) -> NDArray[np.bool_]:
    areas, labels = _pieces(found)
    if len(areas):
        kept = 1 + np.flatnonzero(areas >= options.least_piece * areas.max())
        found = np.isin(labels, kept)
    areas, labels = _pieces(~found)
    holes = 1 + np.flatnonzero(areas < options.largest_hole * found.size)
    return found | np.isin(labels, holes)


def _pieces(region: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=4)
    return np.asarray(stats[1:, cv2.CC_STAT_AREA], np.int64), np.asarray(labels, np.int32)


def _enlarged(found: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    size = (shape[1], shape[0])
    soft = cv2.resize(found.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(soft > 0.5)


def _finished(found: NDArray[np.bool_], options: SegmentationOptions) -> NDArray[np.uint8]:
    mask = np.where(found, 255, 0).astype(np.uint8)
    if options.median_px:
        mask = np.asarray(cv2.medianBlur(mask, options.median_px), np.uint8)
    if options.erosion_px:
        # Beyond the frame nothing is known, and nothing there bounds the object.
        mask = np.asarray(
            cv2.erode(mask, octagon(options.erosion_px), borderType=cv2.BORDER_REPLICATE),
            np.uint8,
        )
    return mask


def octagon(radius_px: int) -> NDArray[np.uint8]:
    """A regular octagon as a structuring element, (2r + 1, 2r + 1) uint8."""
    offset = np.abs(np.arange(-radius_px, radius_px + 1))
    diagonal = offset[:, None] + offset[None, :]
    return np.asarray(diagonal <= round(radius_px * np.sqrt(2.0)), np.uint8)
