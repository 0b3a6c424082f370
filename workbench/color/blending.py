"""Colours of samples from all photographs that see them, one photograph at a time.

Source: Jaspe, section 3.4.5, after Pintus et al. 2011: every photograph adds weighted colours
to the samples it sees, and what is kept are sums. Any number of photographs passes through the
same memory, in any order; one that comes later changes the samples it sees and no others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_colors import Colored
from workbench.color.blending_votes import OBSERVATIONS_AT_ONCE, median_levels
from workbench.geometry.robust import robust_sigma

# A photograph counts a quarter where it is so many sigmas from the middle of all.
_DOUBTFUL_SIGMAS = 2.0
# However well photographs agree, their values have the noise of single pixels.
_LEAST_SIGMA = 0.01
# Residuals that the spread is taken from, of all photographs.
_RESIDUALS = 200_000


class BlendSums:
    """Sums over photographs for ``count`` samples; what they came from is not kept.

    Attributes
    ----------
    colors : (n, 3) float64 weighted sum.
    weights, levels, squares : (n,) float64 sums of weights, and of levels and their squares
        by weight.
    photos : (n,) int32 photographs that see a sample.
    """

    def __init__(self, count: int) -> None:
        self.colors = np.zeros((count, 3))
        self.weights = np.zeros(count)
        self.levels = np.zeros(count)
        self.squares = np.zeros(count)
        self.photos = np.zeros(count, np.int32)

    def add(self, photo: Colored) -> None:
        """One more photograph."""
        at, weights, levels = photo.index, photo.weights, photo.levels
        self.colors[at] += weights[:, None] * photo.colors
        self.weights[at] += weights
        self.levels[at] += weights * levels
        self.squares[at] += weights * levels**2
        self.photos[at] += weights > 0.0

    @property
    def mean_colors(self) -> NDArray[np.float64]:
        """(n, 3); NaN where no photograph tells."""
        return self.colors / np.where(self.weights > 0.0, self.weights, np.nan)[:, None]

    @property
    def mean_levels(self) -> NDArray[np.float64]:
        """(n,); NaN where no photograph tells."""
        return self.levels / np.where(self.weights > 0.0, self.weights, np.nan)

    @property
    def scatter(self) -> NDArray[np.float64]:
        """(n,) standard deviation of the levels; NaN where fewer than two photographs tell."""
        known = np.where((self.weights > 0.0) & (self.photos > 1), self.weights, np.nan)
        return np.asarray(
            np.sqrt(np.maximum(self.squares / known - (self.levels / known) ** 2, 0.0))
        )


@dataclass(frozen=True)
class Blending:
    """Blended colours.

    Attributes
    ----------
    colors : (n, 3) float64 linear; NaN where no photograph tells.
    weights : (n,) float64, 0 where no photograph tells.
    photos : (n,) int32 photographs that see a sample.
    scatter : (n,) float64 standard deviation of the logarithm over photographs, before any was
        doubted; NaN where fewer than two tell.
    sigma : robust spread of that logarithm about the middle, over all samples.
    doubted : share of the weight that did not count in the end.
    """

    colors: NDArray[np.float64]
    weights: NDArray[np.float64]
    photos: NDArray[np.int32]
    scatter: NDArray[np.float64]
    sigma: float
    doubted: float


def blended(
    photos: Iterable[Colored],
    count: int,
    robust: Literal["median", "none"] = "median",
    least_weight: float = 0.0,
    at_once: int = OBSERVATIONS_AT_ONCE,
) -> Blending:
    """Blend photographs.

    Parameters
    ----------
    photos : iterated several times; only one is held at a time.
    count : number of samples.
    robust : let photographs count less where they differ from the median of all, as highlights
        do, and shadows nobody foresaw; or take the mean as it is.
    least_weight : samples with less than this share of the median weight are taken for unseen:
        the rim of what photographs tell is the worst of it.
    at_once : observations that are sorted for their medians at once, some 60 bytes each; with
        more, the photographs pass once for each so many.
    """
    sums = BlendSums(count)
    for photo in photos:
        sums.add(photo)
    final, middle, doubted = sums, sums.mean_levels, 0.0
    if robust == "median":
        middle = median_levels(photos, sums.photos, at_once)
    sigma = _spread(photos, middle, sums.photos)
    if robust == "median":
        final = BlendSums(count)
        for photo in photos:
            final.add(_doubted(photo, middle, sigma))
        total = float(sums.weights.sum())
        doubted = 1.0 - float(final.weights.sum()) / total if total > 0.0 else 0.0
    told = final.weights > 0.0
    if told.any():
        told &= sums.weights >= least_weight * np.median(sums.weights[told])
    return Blending(
        np.where(told[:, None], final.mean_colors, np.nan),
        np.where(told, final.weights, 0.0),
        np.where(told, sums.photos, 0).astype(np.int32),
        np.where(told, sums.scatter, np.nan),
        sigma,
        doubted,
    )


def _doubted(photo: Colored, middle: NDArray[np.float64], sigma: float) -> Colored:
    """The photograph, less of it where it differs from the middle (n,) of all."""
    # Where no photograph has weight there is no middle, and nothing to doubt.
    between = np.where(photo.weights > 0.0, middle[photo.index], photo.levels)
    away = (photo.levels - between) / (_DOUBTFUL_SIGMAS * sigma)
    return Colored(photo.index, photo.colors, photo.weights / (1.0 + away**2) ** 2)


def _spread(
    photos: Iterable[Colored], middle: NDArray[np.float64], counts: NDArray[np.int32]
) -> float:
    """Robust sigma of levels about the middle (n,), where several photographs tell."""
    residuals = [np.zeros(0)]
    step = max(1, int(counts.sum(dtype=np.int64)) // _RESIDUALS)
    for photo in photos:
        at = photo.index[::step]
        residuals.append((photo.levels[::step] - middle[at])[counts[at] > 2])
    return max(robust_sigma(np.concatenate(residuals)), _LEAST_SIGMA)
