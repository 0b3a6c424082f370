"""Colours of samples from all photographs that see them, one photograph at a time.

Source: Jaspe, section 3.4.5, after Pintus et al. 2011: every photograph adds weighted colours
to the samples it sees, and what is kept are sums. Any number of photographs passes through the
same memory, in any order; one that comes later changes the samples it sees and no others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_observations import Observations
from workbench.color.flash_light import FlashLight, albedo, incidence_trust
from workbench.errors import InputError
from workbench.geometry.robust import robust_sigma
from workbench.geometry.transforms import Matrix4, apply

# Residuals of the logarithm count by half at so many sigmas from the first mean.
_DOUBTFUL_SIGMAS = 2.0
# However well photographs agree, their values have the noise of single pixels.
_LEAST_SIGMA = 0.01
# The logarithm of nothing is that of a surface far darker than any is.
_DARKEST = 1e-4
# How much of the weight a surface loses that faces halfway between flash and camera, where
# varnish shines, and the sine of the angle over which it comes back: 15°.
_HIGHLIGHT, _HIGHLIGHT_SINE = 0.95, 0.26
_TINY = np.finfo(float).tiny
# Residuals that the spread is taken from, per photograph.
_RESIDUALS_PER_PHOTO = 2000


@dataclass(frozen=True)
class Colored:
    """What one photograph adds.

    Attributes
    ----------
    index : (m,) int64 which samples, none twice.
    colors : (m, 3) float64 linear.
    weights : (m,) float64 ≥ 0.
    """

    index: NDArray[np.int64]
    colors: NDArray[np.float64]
    weights: NDArray[np.float64]

    def __post_init__(self) -> None:
        bad = ~(np.isfinite(self.colors).all(axis=1) & (self.weights >= 0.0))
        if bad.any():
            raise InputError(
                "a photograph's colours cannot be blended",
                found=f"{int(bad.sum())} of {len(bad)} are not finite or have no weight",
                fix="leave those samples out",
            )

    @property
    def levels(self) -> NDArray[np.float64]:
        """(m,) logarithm of how light they are, whatever their hue."""
        return level_of(self.colors)

    def within(self, first: int, last: int) -> Colored:
        """Those of samples in [first, last), counted from ``first``."""
        which = (self.index >= first) & (self.index < last)
        return Colored(self.index[which] - first, self.colors[which], self.weights[which])


def level_of(colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithm (n,) of the mean of linear channels (n, 3)."""
    return np.asarray(np.log(np.maximum(colors.mean(axis=1), _DARKEST)))


def corrected(
    seen: Observations,
    points: NDArray[np.float64],
    camera_from_world: Matrix4,
    light: FlashLight,
    gain: float,
) -> Colored:
    """The albedo of what a photograph saw in a flash's light.

    The weight grows with the light: half the light has twice the noise of its photons, relative
    to what it tells.

    Parameters
    ----------
    points : (m, 3) of the samples seen, in the world.
    gain : value of a white diffuser that gets light 1.
    """
    places = apply(camera_from_world, points)
    normals = seen.normals.astype(np.float64)
    received = light.received(places, normals)
    trust = incidence_trust(light.incidence(places, normals))
    weights = seen.weights * trust * received * _mirror_trust(light, places, normals)
    kept = (received > 0.0) & (weights > 0.0)
    colors = albedo(seen.values[kept], received[kept], gain)
    return Colored(seen.index[kept], colors, weights[kept])


def uncorrected(seen: Observations, gain: float) -> Colored:
    """What a photograph saw, in whatever light it was taken."""
    return Colored(seen.index, seen.values / np.float64(gain), seen.weights.astype(np.float64))


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
    sigma : spread of that logarithm about the result, over all samples, robustly.
    doubted : share of the weight that did not count in the end.
    """

    colors: NDArray[np.float64]
    weights: NDArray[np.float64]
    photos: NDArray[np.int32]
    scatter: NDArray[np.float64]
    sigma: float
    doubted: float


def blended(
    photos: Iterable[Colored], count: int, robust_rounds: int = 2, least_weight: float = 0.0
) -> Blending:
    """Blend photographs.

    Parameters
    ----------
    photos : iterated twice, and twice more per robust round; only one is held at a time.
    count : number of samples.
    robust_rounds : how often photographs count less where they tell something else than most:
        highlights, shadows nobody foresaw. 0 takes the mean.
    least_weight : samples with less than this share of the median weight are taken for unseen:
        the rim of what photographs tell is the worst of it.
    """
    sums = BlendSums(count)
    for photo in photos:
        sums.add(photo)
    scatter, all_weights, seen_by = sums.scatter, sums.weights, sums.photos
    sigma = _spread(photos, sums)
    for _ in range(robust_rounds):
        again = BlendSums(count)
        for photo in photos:
            again.add(_doubted(photo, sums, sigma))
        sums = again
        sigma = _spread(photos, sums)
    total = float(all_weights.sum())
    doubted = 1.0 - float(sums.weights.sum()) / total if total > 0.0 else 0.0
    told = sums.weights > 0.0
    if told.any():
        told &= all_weights >= least_weight * np.median(all_weights[told])
    return Blending(
        np.where(told[:, None], sums.mean_colors, np.nan),
        np.where(told, sums.weights, 0.0),
        np.where(told, seen_by, 0).astype(np.int32),
        np.where(told, scatter, np.nan),
        sigma,
        doubted,
    )


def _doubted(photo: Colored, sums: BlendSums, sigma: float) -> Colored:
    """The photograph, less of it where it differs from the mean of all so far."""
    away = (photo.levels - sums.mean_levels[photo.index]) / (_DOUBTFUL_SIGMAS * sigma)
    return Colored(photo.index, photo.colors, photo.weights / (1.0 + away**2) ** 2)


def _spread(photos: Iterable[Colored], sums: BlendSums) -> float:
    """Robust sigma of levels about their means, where a mean rests on several photographs."""
    residuals = []
    for photo in photos:
        step = max(1, len(photo.index) // _RESIDUALS_PER_PHOTO)
        at = photo.index[::step]
        shared = sums.photos[at] > 2
        residuals.append((photo.levels[::step] - sums.mean_levels[at])[shared])
    together = np.concatenate(residuals) if residuals else np.zeros(0)
    return max(robust_sigma(together), _LEAST_SIGMA)


def _mirror_trust(
    light: FlashLight, places: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(m,) how little of a highlight there can be; small where the flash would mirror itself."""
    to_flash, to_camera = light.position_in_camera - places, -places
    half = to_flash / np.maximum(np.linalg.norm(to_flash, axis=1, keepdims=True), _TINY)
    half += to_camera / np.maximum(np.linalg.norm(to_camera, axis=1, keepdims=True), _TINY)
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), _TINY)
    away = 1.0 - np.minimum((half * normals).sum(axis=1) ** 2, 1.0)
    return np.asarray(1.0 - _HIGHLIGHT * np.exp(-away / _HIGHLIGHT_SINE**2))
