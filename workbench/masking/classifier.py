"""Every pixel's probability to be foreground, learned from a few masked images.

The paper's histogram (reflectance, or hue and saturation) is noisy and, of pixels near black
or white, knows nothing. Of photographs, a forest of trees learns the surroundings of every
pixel too. Of range maps, and where only clutter was marked, histograms of how bright and how
rough the neighbourhood is, at three sizes, add their evidence as log-odds.

Source: Jaspe, section 3.4.3, which uses the first histogram alone; ``PAPER`` does.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.masking.forest import Forest, grown
from workbench.masking.histograms import Example, Histogram, learned
from workbench.masking.quantisation import (
    HueSaturationLevels,
    Quantiser,
    ReflectanceLevels,
    ToneLevels,
    photograph,
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
    trees : of the forest for photographs; 0 for histograms alone.
    forest_side_px : the forest looks at photographs with their longer side this long.
    """

    bins: int = 32
    smoothing_bins: float = 1.0
    working_side_px: int = 400
    tone_sigmas_px: tuple[float, ...] = (3.0, 6.0, 12.0)
    tone_weight: float = 0.4
    noise_sigma_px: float = 1.5
    trees: int = 30
    forest_side_px: int = 800

    def __post_init__(self) -> None:
        if self.trees < 0:
            raise SettingsError("a forest cannot have fewer than no trees")
        if self.bins < 2 or min(self.working_side_px, self.forest_side_px) < 16:
            raise SettingsError("masking needs two bins and sixteen pixels a side at least")
        if min(self.smoothing_bins, self.noise_sigma_px, self.tone_weight) < 0:
            raise SettingsError("smoothing and weights of masking must not be negative")


PAPER = ClassifierOptions(tone_sigmas_px=(), noise_sigma_px=0.0, trees=0)


@dataclass(frozen=True)
class Classifier:
    """What was learned from one set of examples.

    Attributes
    ----------
    appearance : histogram of reflectance, or of hue and saturation.
    tones : histograms of the neighbourhood's brightness and contrast.
    forest : decides alone where there is one.
    options : it was learned with.
    """

    appearance: Histogram
    tones: tuple[Histogram, ...]
    forest: Forest | None
    options: ClassifierOptions

    def probability(self, image: NDArray[np.generic]) -> NDArray[np.float32]:
        """Probability of foreground at the working size.

        Parameters
        ----------
        image : (h, w, 3) uint8 RGB or (h, w) float reflectance in [0, 1], NaN for no return.

        Returns
        -------
        (h', w') float32 in [0, 1], the longer side ``forest_side_px`` or ``working_side_px``
        or as given if smaller; NaN where no histogram knows anything.
        """
        if self.forest is not None:
            seen = at_side(photograph(image), self.options.forest_side_px)
            return self.forest.probability(np.asarray(seen, np.uint8))
        small = at_side(image, self.options.working_side_px)
        first = self.appearance.probability(small)
        evidence = _smooth(log_odds(first), self.options.noise_sigma_px)
        known = np.isfinite(first)
        for tone in self.tones:
            told = tone.probability(small)
            known |= np.isfinite(told)
            evidence += np.float32(self.options.tone_weight) * log_odds(told)
        if self.tones:
            evidence = _smooth(evidence, 1.0)
        probability = 1.0 / (1.0 + np.exp(-evidence))
        return np.where(known, probability, np.nan).astype(np.float32)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """All that ``from_arrays`` needs to make the same classifier, in another process."""
        kind = "reflectance" if isinstance(self.appearance.quantiser, ReflectanceLevels) else "rgb"
        told = json.dumps({"kind": kind, "options": asdict(self.options)}, sort_keys=True)
        packed: dict[str, NDArray[np.generic]] = {"told": np.frombuffer(told.encode(), np.uint8)}
        for n, histogram in enumerate((self.appearance, *self.tones)):
            packed[f"clutter_{n}"] = histogram.clutter
            if histogram.foreground is not None:
                packed[f"foreground_{n}"] = histogram.foreground
        if self.forest is not None:
            packed |= {f"forest_{name}": table for name, table in self.forest.arrays().items()}
        return packed

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> Classifier:
        """The classifier that ``arrays`` came from; it finds the same probabilities."""
        told = json.loads(np.asarray(arrays["told"], np.uint8).tobytes())
        values = told["options"]
        values["tone_sigmas_px"] = tuple(values["tone_sigmas_px"])
        options = ClassifierOptions(**values)
        first, *tones = (
            Histogram(
                quantiser,
                np.asarray(arrays[f"foreground_{n}"], float)
                if f"foreground_{n}" in arrays
                else None,
                np.asarray(arrays[f"clutter_{n}"], float),
            )
            for n, quantiser in enumerate(_quantisers(options, color=told["kind"] == "rgb"))
        )
        table = {
            name.removeprefix("forest_"): value
            for name, value in arrays.items()
            if name.startswith("forest_")
        }
        return cls(first, tuple(tones), Forest.from_arrays(table) if table else None, options)


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
    color = bool(examples) and examples[0].image.ndim == 3
    small = [_example_at_side(example, options.working_side_px) for example in examples]
    first, *tones = _quantisers(options, color=color)
    appearance = learn(first, small, options.smoothing_bins)
    forest = None
    if color and options.trees and appearance.foreground is not None:
        seen = [_example_at_side(example, options.forest_side_px) for example in examples]
        forest = grown(seen, options.trees)
    return Classifier(appearance, tuple(learn(tone, small, 1.0) for tone in tones), forest, options)


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


def _quantisers(options: ClassifierOptions, *, color: bool) -> list[Quantiser]:
    levels = HueSaturationLevels(options.bins) if color else ReflectanceLevels(options.bins)
    return [levels, *(ToneLevels(sigma) for sigma in options.tone_sigmas_px)]


def log_odds(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """Evidence for foreground, float32 within ±7; 0 where the probability is NaN."""
    sure = np.clip(np.nan_to_num(probability, nan=0.5), _SUREST, 1.0 - _SUREST)
    return np.log(sure / (1.0 - sure)).astype(np.float32)


def _smooth(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma)) if sigma > 0 else image
