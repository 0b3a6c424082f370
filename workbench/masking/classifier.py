"""Every pixel's probability to be foreground, from all histograms together.

The paper's histogram (reflectance, or hue and saturation) is noisy and, of pixels near black
or white, knows nothing. How bright and how rough the neighbourhood is, at three sizes,
is learned from the same masks, and the evidence is added as log-odds.

Source: Jaspe, section 3.4.3, which uses the first histogram alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.masking.histograms import Example, Histogram, learned
from workbench.masking.quantisation import (
    HueSaturationLevels,
    Quantiser,
    ReflectanceLevels,
    ToneLevels,
)

_SUREST = 1e-3
Learn = Callable[[Quantiser, Sequence[Example], float], Histogram]


@dataclass(frozen=True)
class ClassifierOptions:
    """How the probability is learned and computed.

    Attributes
    ----------
    bins : levels of reflectance, and of hue and of saturation.
    smoothing_bins : Gaussian on the histograms, bins.
    working_side_px : images are looked at with their longer side this long.
    tone_sigmas_px : neighbourhoods of the tone histograms at that size; empty for none.
    tone_weight : of each tone's evidence; neighbourhoods overlap, so below 1.
    noise_sigma_px : Gaussian on the first histogram's evidence at that size; 0 for none.
    """

    bins: int = 32
    smoothing_bins: float = 1.0
    working_side_px: int = 400
    tone_sigmas_px: tuple[float, ...] = (3.0, 6.0, 12.0)
    tone_weight: float = 0.4
    noise_sigma_px: float = 1.5

    def __post_init__(self) -> None:
        if self.bins < 2 or self.working_side_px < 16:
            raise SettingsError("masking needs two bins and sixteen pixels a side at least")
        if min(self.smoothing_bins, self.noise_sigma_px, self.tone_weight) < 0:
            raise SettingsError("smoothing and weights of masking must not be negative")


@dataclass(frozen=True)
class Classifier:
    """Histograms of appearance and of tone, learned from the same examples."""

    appearance: Histogram
    tones: tuple[Histogram, ...]
    options: ClassifierOptions

    def probability(self, image: NDArray[np.generic]) -> NDArray[np.float32]:
        """Probability of foreground at the working size.

        Parameters
        ----------
        image : (h, w, 3) uint8 RGB or (h, w) float reflectance in [0, 1], NaN for no return.

        Returns
        -------
        (h', w') float32 in [0, 1], the longer side ``working_side_px`` or as given if
        smaller; NaN where no histogram knows anything.
        """
        small = at_side(image, self.options.working_side_px)
        first = self.appearance.probability(small)
        evidence = _smooth(_log_odds(first), self.options.noise_sigma_px)
        known = np.isfinite(first)
        for tone in self.tones:
            told = tone.probability(small)
            known |= np.isfinite(told)
            evidence += np.float32(self.options.tone_weight) * _log_odds(told)
        if self.tones:
            evidence = _smooth(evidence, 1.0)
        probability = 1.0 / (1.0 + np.exp(-evidence))
        return np.where(known, probability, np.nan).astype(np.float32)


def trained(
    examples: Sequence[Example],
    options: ClassifierOptions | None = None,
    learn: Learn = learned,
) -> Classifier:
    """A classifier for images like those of the examples, photographs or range maps.

    Parameters
    ----------
    learn : ``learned``, or ``learned_from_clutter`` where the masks mark clutter only.

    Raises
    ------
    InputError : no examples; photographs among range maps; one class never shown.
    """
    options = options or ClassifierOptions()
    if len({example.image.ndim for example in examples}) > 1:
        raise InputError("photographs and range maps cannot train one classifier")
    side = options.working_side_px
    small = [_example_at_side(example, side) for example in examples]
    color = bool(small) and small[0].image.ndim == 3
    levels = HueSaturationLevels(options.bins) if color else ReflectanceLevels(options.bins)
    tones = [ToneLevels(sigma) for sigma in options.tone_sigmas_px]
    return Classifier(
        learn(levels, small, options.smoothing_bins),
        tuple(learn(tone, small, 1.0) for tone in tones),
        options,
    )


def at_side(image: NDArray[np.generic], side_px: int) -> NDArray[np.generic]:
    """The image with its longer side ``side_px``, box-filtered; unchanged if smaller.

    A float image is averaged over its known pixels, and NaN where there are none.
    """
    height, width = image.shape[:2]
    scale = side_px / max(height, width)
    if scale >= 1.0:
        return image
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if image.ndim == 3 or not np.issubdtype(image.dtype, np.floating):
        return np.asarray(cv2.resize(image.astype(np.uint8), size, interpolation=cv2.INTER_AREA))
    known = np.isfinite(image)
    weight = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    value = np.where(known, image, 0.0).astype(np.float32)
    mean = cv2.resize(value, size, interpolation=cv2.INTER_AREA)
    return np.where(weight > 0.25, mean / np.maximum(weight, 1e-6), np.nan).astype(np.float32)


def _example_at_side(example: Example, side_px: int) -> Example:
    mask = np.asarray(at_side(example.mask, side_px), np.uint8) > 127
    return Example(at_side(example.image, side_px), np.where(mask, 255, 0).astype(np.uint8))


def _log_odds(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    sure = np.clip(np.nan_to_num(probability, nan=0.5), _SUREST, 1.0 - _SUREST)
    return np.log(sure / (1.0 - sure)).astype(np.float32)


def _smooth(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma)) if sigma > 0 else image
