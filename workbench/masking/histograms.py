"""What foreground and clutter look like, learned from a few masked images.

Counts of both classes are accumulated over the examples and smoothed; their ratio,
back-projected, is each pixel's probability to be foreground.

Source: Jaspe, section 3.4.3, "Histogram-based classification".
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.masking.quantisation import UNKNOWN, Quantiser

# Half a pixel of either class in every bin: a bin never seen says nothing, 0.5.
_PRIOR_PIXELS = 0.5
# Above it, a threshold on the histogram errs on a third of the pixels or more.
_MOST_OVERLAP = 0.9


@dataclass(frozen=True)
class Example:
    """An image and its mask, as the user drew it.

    Attributes
    ----------
    image : (h, w, 3) uint8 RGB or (h, w) float reflectance in [0, 1].
    mask : (h, w) uint8, 255 = keep, 0 = clutter.
    """

    image: NDArray[np.generic]
    mask: NDArray[np.uint8]

    def __post_init__(self) -> None:
        if self.mask.ndim != 2 or self.mask.shape != self.image.shape[:2]:
            raise InputError(
                "a mask must be as large as its image",
                expected=f"{self.image.shape[1]} × {self.image.shape[0]} pixels",
                found=" × ".join(str(n) for n in self.mask.shape[::-1]),
                fix="draw the mask on the image at its own size",
            )

    @property
    def foreground(self) -> NDArray[np.bool_]:
        return self.mask > 127


@dataclass(frozen=True)
class Histogram:
    """Pixels per bin of foreground and of clutter, smoothed.

    Attributes
    ----------
    quantiser : what its bins are.
    foreground, clutter : (…) float64 counts; ``foreground`` is None where only clutter
        was shown, and then what does not look like clutter is foreground.
    """

    quantiser: Quantiser
    foreground: NDArray[np.float64] | None
    clutter: NDArray[np.float64]

    @property
    def bin_probability(self) -> NDArray[np.float64]:
        """Probability of foreground per bin, in [0, 1], classes as frequent as seen."""
        if self.foreground is None:
            # The clutter's commonest colour is clutter for certain; half as common, half.
            return np.asarray(1.0 - self.clutter / self.clutter.max(), np.float64)
        seen = self.foreground + self.clutter
        return np.asarray((self.foreground + _PRIOR_PIXELS) / (seen + 2.0 * _PRIOR_PIXELS))

    def probability(self, image: NDArray[np.generic]) -> NDArray[np.float32]:
        """(h, w) float32 probability of foreground in [0, 1]; NaN where unknown."""
        bins = self.quantiser.bins_of(image)
        probability = self.bin_probability.ravel()[np.maximum(bins, 0)].astype(np.float32)
        probability[bins == UNKNOWN] = np.nan
        return probability


@dataclass(frozen=True)
class Separability:
    """Whether a histogram can tell foreground from clutter; falsy where not.

    Attributes
    ----------
    overlap : Bhattacharyya coefficient of the two classes, 0 apart … 1 the same.
    reason : why it cannot, in plain words; empty where it can.
    """

    overlap: float
    reason: str

    def __bool__(self) -> bool:
        return not self.reason


def learned(
    quantiser: Quantiser, examples: Iterable[Example], smoothing_bins: float = 1.0
) -> Histogram:
    """Histograms of both classes over all examples.

    Parameters
    ----------
    smoothing_bins : standard deviation of the Gaussian along each axis, bins; 0 for none.

    Raises
    ------
    InputError : no examples, or none with a known pixel of foreground or of clutter.
    """
    kept, clutter, shown = _counts(quantiser, examples)
    if not shown:
        raise _nothing_shown()
    if not kept.any() or not clutter.any():
        missing = "foreground" if not kept.any() else "clutter"
        raise InputError(
            f"the masked examples show no {missing} whose appearance can be learned",
            fix="mask an image that shows both",
        )
    blurred = [_smoothed(counts, quantiser.wraps, smoothing_bins) for counts in (kept, clutter)]
    return Histogram(quantiser, blurred[0], blurred[1])


def learned_from_clutter(
    quantiser: Quantiser, examples: Iterable[Example], smoothing_bins: float = 1.0
) -> Histogram:
    """The clutter's histogram alone, where the masks are 0 only on *some* clutter.

    Raises
    ------
    InputError : no examples, or none with a known pixel of clutter.
    """
    _, clutter, shown = _counts(quantiser, examples)
    if not shown:
        raise _nothing_shown()
    if not clutter.any():
        raise InputError("the masked examples show no clutter", fix="mark some clutter with 0")
    return Histogram(quantiser, None, _smoothed(clutter, quantiser.wraps, smoothing_bins))


def separability(histogram: Histogram) -> Separability:
    """Whether masking by this histogram can work, for leaving it out where it cannot."""
    if histogram.foreground is None:
        spread = np.count_nonzero(histogram.bin_probability < 0.5) / histogram.clutter.size
        reason = "clutter has every appearance" if spread > _MOST_OVERLAP else ""
        return Separability(float(spread), reason)
    kept = histogram.foreground / histogram.foreground.sum()
    clutter = histogram.clutter / histogram.clutter.sum()
    overlap = float(min(1.0, np.sqrt(kept * clutter).sum()))
    alike = overlap > _MOST_OVERLAP
    return Separability(overlap, "foreground and clutter look alike" if alike else "")


def is_unimodal(quantiser: Quantiser, images: Iterable[NDArray[np.generic]]) -> bool:
    """Whether images without any mask show one appearance only: nothing to separate.

    Splits the first axis of the histogram where the classes differ most (Otsu 1979); one
    Gaussian lets the split explain 2/π = 64 % of the variance, two that are apart more.
    """
    total = np.zeros(quantiser.shape)
    for image in images:
        total += _count(quantiser, quantiser.bins_of(image), np.ones(image.shape[:2], bool))
    if not total.any():
        return True
    line = total.reshape(total.shape[0], -1).sum(axis=1)
    line /= line.sum()
    place = np.arange(len(line)) + 0.5
    below, moment = np.cumsum(line)[:-1], np.cumsum(line * place)[:-1]
    mean = float(line @ place)
    variance = float(line @ (place - mean) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (mean * below - moment) ** 2 / (below * (1.0 - below))
    explained = float(np.nanmax(np.nan_to_num(between, posinf=0.0))) / max(variance, 1e-12)
    # Within one level nothing can be told apart, however the two halves differ.
    return variance < 1.0 or explained < 0.75


def _counts(
    quantiser: Quantiser, examples: Iterable[Example]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    kept, clutter, shown = np.zeros(quantiser.shape), np.zeros(quantiser.shape), 0
    for example in examples:
        bins = quantiser.bins_of(example.image)
        kept += _count(quantiser, bins, example.foreground)
        clutter += _count(quantiser, bins, ~example.foreground)
        shown += 1
    return kept, clutter, shown


def _count(
    quantiser: Quantiser, bins: NDArray[np.int32], where: NDArray[np.bool_]
) -> NDArray[np.float64]:
    size = int(np.prod(quantiser.shape))
    counted = np.bincount(bins[where & (bins != UNKNOWN)], minlength=size)
    return counted.reshape(quantiser.shape).astype(np.float64)


def _smoothed(counts: NDArray[np.float64], wraps: bool, sigma: float) -> NDArray[np.float64]:
    if sigma <= 0:
        return counts
    table = counts.reshape(len(counts), -1)
    rim = min(len(table), int(np.ceil(4 * sigma)))
    edge = cv2.BORDER_WRAP if wraps else cv2.BORDER_REPLICATE
    # Borders are made by hand: the blur itself knows no circle.
    rimmed = cv2.copyMakeBorder(table, rim, rim, 0, 0, edge)
    columns = 1e-9 if table.shape[1] == 1 else sigma
    blurred = cv2.GaussianBlur(rimmed, (0, 0), sigmaX=columns, sigmaY=sigma)
    return np.asarray(blurred[rim:-rim], np.float64).reshape(counts.shape)


def _nothing_shown() -> InputError:
    return InputError(
        "no masked examples to learn from", fix="mask three images or give a rectangle"
    )
