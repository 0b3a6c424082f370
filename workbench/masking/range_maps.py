"""Masks of range maps: which samples are the object, from a few masked examples.

A scanner records reflectance × cosine of the incidence, so dark metal that faces it looks
like pale stone seen obliquely. The histogram of the paper is therefore taken over both,
the signal and the incidence on the surface that the grid samples, for both classes; its
log-odds, with those of the chromaticity where scans have colour, are the data term of one
graph cut whose links end at depth steps.

Source: Jaspe, section 3.4.3, which takes the reflectance alone and GrabCut; incidence and
depth steps are further evidence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from workbench.errors import InputError, SettingsError
from workbench.geometry.rangemap import RangeMap
from workbench.masking.grid_surface import (
    GridSurface,
    grid_image,
    grid_of,
    grid_surface,
)
from workbench.masking.histograms import Separability
from workbench.masking.range_map_signal import (
    Signal,
    Span,
    chroma_bins,
    common_signal,
    sample_signal,
    span_of,
)
from workbench.masking.sample_filters import eroded, median_of_samples, neighbours_on_surface
from workbench.masking.surface_cut import surface_cut

# Half a sample of either class in every bin: a bin never seen says nothing.
_PRIOR_SAMPLES = 0.5
_CHROMA_SMOOTHING = (1.0, 1.0)
# Bhattacharyya coefficient above which a threshold errs on a third of the samples or more.
_MOST_OVERLAP = 0.9
# Bins with this part of the commonest bin's clutter say how much of it was left unmarked.
_TELLING_PART = 0.1
_LEAST_FOREGROUND_PART = 0.01


@dataclass(frozen=True)
class RangeMapMaskingOptions:
    """How range maps are masked.

    Attributes
    ----------
    bins : of the signal's square root, between the ends of its span.
    incidence_bins : of the cosine of incidence; 1 leaves the surface's orientation out.
    smoothing_bins : Gaussian on the histogram along both, levels.
    keep_odds : a sample is kept where the object is this many times likelier than clutter;
        above 1 masks are conservative.
    smoothness : cost of a border between two samples of one surface, log-odds; 0 for the
        classifier alone.
    step_decay : by how many spacings two neighbours must lie too far apart for the
        smoothness between them to fall to 1/e.
    least_neighbours : a sample with fewer of its eight neighbours on the same surface is a
        stray return and not kept; 0 keeps them.
    median_px : side of the median filter over the samples in the window, odd; 0 for none.
    erosion_px : how far an octagon eats into the mask from clutter and from depth steps, and
        from nowhere else; 0 for none.
    """

    bins: int = 32
    incidence_bins: int = 10
    smoothing_bins: tuple[float, float] = (2.5, 1.0)
    keep_odds: float = 2.0
    smoothness: float = 1.0
    step_decay: float = 3.0
    least_neighbours: int = 1
    median_px: int = 0
    erosion_px: int = 0

    def __post_init__(self) -> None:
        if self.bins < 2 or self.incidence_bins < 1:
            raise SettingsError("masking needs two levels of the signal and one of the incidence")
        if min(*self.smoothing_bins, self.smoothness, *self._filters) < 0:
            raise SettingsError("smoothing and filters of masking must not be negative")
        if self.keep_odds <= 0 or self.step_decay <= 0:
            raise SettingsError("keep_odds and step_decay of masking must be positive")
        if self.median_px and self.median_px % 2 == 0:
            raise SettingsError("the median filter's side must be odd", found=str(self.median_px))

    @property
    def _filters(self) -> tuple[int, int, int]:
        return self.least_neighbours, self.median_px, self.erosion_px


@dataclass(frozen=True)
class RangeMapClassifier:
    """Log-odds of the object by appearance; falsy where nothing can be told apart.

    Attributes
    ----------
    signal : what was learned from.
    span : its values at the ends of the levels.
    log_odds : (levels, incidence levels) float64, by signal and incidence.
    chroma_log_odds : (levels, levels) float64, by chromaticity, classes equally frequent;
        (0, 0) where not all examples have colour, or theirs tells nothing.
    separability : how much the classes overlap and, where too much, why masking cannot work.
    """

    signal: Signal
    span: Span
    log_odds: NDArray[np.float64]
    chroma_log_odds: NDArray[np.float64]
    separability: Separability

    def __bool__(self) -> bool:
        return bool(self.separability)

    def evidence(self, scan: RangeMap, surface: GridSurface) -> NDArray[np.float64]:
        """(n,) float64 log-odds that a sample is the object; 0 where its signal is unknown.

        Raises
        ------
        InputError : the scan does not have the signal.
        """
        shape = cast(tuple[int, int], self.log_odds.shape)
        bins, known = _bins(scan, surface, self.signal, self.span, shape)
        evidence = np.where(known, self.log_odds.ravel()[bins], 0.0)
        if self.chroma_log_odds.size and scan.color is not None:
            bins, known = chroma_bins(scan.color, len(self.chroma_log_odds))
            evidence += np.where(known, self.chroma_log_odds.ravel()[bins], 0.0)
        return np.asarray(evidence, np.float64)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Plain arrays that ``from_arrays`` restores exactly, for an ``.npz``."""
        return {
            "signal": np.array(self.signal),
            "span": np.array(self.span, np.float64),
            "log_odds": self.log_odds,
            "chroma_log_odds": self.chroma_log_odds,
            "overlap": np.array(self.separability.overlap, np.float64),
            "reason": np.array(self.separability.reason),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> RangeMapClassifier:
        """The classifier that ``arrays`` came from.

        Raises
        ------
        InputError : an array is missing or of another kind.
        """
        try:
            signal = str(arrays["signal"])
            low, high = (float(end) for end in np.asarray(arrays["span"], np.float64))
            log_odds = np.asarray(arrays["log_odds"], np.float64)
            chroma = np.asarray(arrays["chroma_log_odds"], np.float64)
            told = Separability(
                float(np.asarray(arrays["overlap"], np.float64)), str(arrays["reason"])
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("not a classifier of range maps", found=str(error)) from error
        if signal not in get_args(Signal) or log_odds.ndim != 2 or chroma.ndim != 2:
            raise InputError("not a classifier of range maps", found=f"{signal} {log_odds.shape}")
        return cls(cast(Signal, signal), (low, high), log_odds, chroma, told)


def learned_range_maps(
    examples: Sequence[tuple[RangeMap, NDArray[np.uint8]]],
    options: RangeMapMaskingOptions | None = None,
    *,
    clutter_only: bool = False,
) -> RangeMapClassifier:
    """A classifier for scans of the same instrument and object as the examples.

    Parameters
    ----------
    examples : range maps and their masks, (rows, cols) uint8, 255 = keep, 0 = clutter;
        cells without a sample do not count.
    clutter_only : the masks are 0 on *some* clutter, and 255 says nothing: the object is
        what is left of such samples when clutter like the marked is taken away.

    Returns
    -------
    The classifier; falsy, with the reason in ``separability``, where it cannot work.

    Raises
    ------
    InputError : no examples; a scan without a grid; a mask of another size; no sample of
        the object or of clutter.
    """
    options = options or RangeMapMaskingOptions()
    if not examples:
        raise InputError("no masked range maps to learn from", fix="mask two of them")
    signal = common_signal(scan for scan, _ in examples)
    span = span_of(signal, [scan for scan, _ in examples])
    shape = (options.bins, options.incidence_bins)
    counts, chroma = np.zeros((2, *shape)), np.zeros((2, options.bins, options.bins))
    colored = all(scan.color is not None for scan, _ in examples)
    for scan, mask in examples:
        surface, keep = grid_surface(scan), _marks(scan, mask)
        counts += _counts(*_bins(scan, surface, signal, span, shape), keep, shape)
        if colored and scan.color is not None:
            chroma += _counts(*chroma_bins(scan.color, options.bins), keep, chroma.shape[1:])
    clutter, kept = _classes(counts, options.smoothing_bins, clutter_only)
    told = _separability(kept, clutter)
    log_odds = np.log((kept + _PRIOR_SAMPLES) / (clutter + _PRIOR_SAMPLES))
    untold = RangeMapClassifier(signal, span, log_odds, np.zeros((0, 0)), told)
    # Too dark for hues is no colour, and one class's colours alone say nothing.
    if not chroma.any(axis=(1, 2)).all():
        return untold
    other, own = _classes(chroma, _CHROMA_SMOOTHING, clutter_only)
    if not own.any():
        return untold
    told = min(told, _separability(own, other), key=lambda each: each.overlap)
    # How frequent the classes are is in the first histogram already.
    frequency = (other.sum() + _PRIOR_SAMPLES) / (own.sum() + _PRIOR_SAMPLES)
    odds = frequency * (own + _PRIOR_SAMPLES) / (other + _PRIOR_SAMPLES)
    return RangeMapClassifier(signal, span, log_odds, np.log(odds), told)


def mask_of_range_map(
    scan: RangeMap,
    classifier: RangeMapClassifier,
    options: RangeMapMaskingOptions | None = None,
) -> NDArray[np.uint8]:
    """The mask of a range map.

    Returns
    -------
    (rows, cols) uint8, 255 = keep, 0 = clutter and cells without a sample.

    Raises
    ------
    InputError : the scan has no grid, or not the signal that the classifier knows.
    """
    options = options or RangeMapMaskingOptions()
    surface = grid_surface(scan)
    evidence = classifier.evidence(scan, surface) - np.log(options.keep_odds)
    if options.smoothness > 0:
        kept = surface_cut(scan, surface, evidence, options.smoothness, options.step_decay)
    else:
        kept = evidence > 0
    if options.least_neighbours:
        kept &= neighbours_on_surface(scan, surface) >= options.least_neighbours
    if options.median_px:
        kept = median_of_samples(scan, kept, options.median_px)
    if options.erosion_px:
        kept = eroded(scan, surface, kept, options.erosion_px)
    return np.asarray(grid_image(scan, np.where(kept, 255, 0).astype(np.uint8), 0), np.uint8)


def _bins(
    scan: RangeMap, surface: GridSurface, signal: Signal, span: Span, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Flat bin (n,) of every sample and whether its signal is known."""
    value = sample_signal(scan, surface, signal)
    known = np.isfinite(value)
    part = np.clip((np.where(known, value, 0.0) - span[0]) / (span[1] - span[0]), 0.0, 1.0)
    # Noise grows with the signal, and dark materials differ by little: finer levels there.
    level = np.minimum(np.sqrt(part) * shape[0], shape[0] - 1).astype(np.int64)
    facing = np.nan_to_num(surface.incidence_cos, nan=1.0)
    incidence = np.minimum(facing * shape[1], shape[1] - 1).astype(np.int64)
    return level * shape[1] + incidence, known


def _marks(scan: RangeMap, mask: NDArray[np.uint8]) -> NDArray[np.int8]:
    """What a mask says (n,) of the samples: 1 keep, 0 clutter, −1 for those off the grid."""
    grid = grid_of(scan)
    if mask.shape != grid.shape:
        raise InputError(
            f"the mask of {scan.name} is not of the scan's grid",
            expected=" × ".join(str(n) for n in grid.shape[::-1]) + " pixels",
            found=" × ".join(str(n) for n in mask.shape[::-1]),
            fix="draw the mask on the range map's picture at its own size",
        )
    marks = np.full(len(scan), -1, np.int8)
    marks[grid[grid >= 0]] = mask[grid >= 0] > 127
    return marks


def _counts(
    bins: NDArray[np.int64],
    known: NDArray[np.bool_],
    marks: NDArray[np.int8],
    shape: tuple[int, ...],
) -> NDArray[np.float64]:
    """Samples (2, …) per bin of what the mask removes and of what it keeps."""
    size = int(np.prod(shape))
    each = [np.bincount(bins[known & (marks == mark)], minlength=size) for mark in (0, 1)]
    return np.stack(each).reshape(2, *shape).astype(np.float64)


def _classes(
    counts: NDArray[np.float64], smoothing_bins: tuple[float, float], clutter_only: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Smoothed histograms of clutter and of the object.

    Raises
    ------
    InputError : one of them was never shown.
    """
    clutter, kept = (gaussian_filter(each, smoothing_bins, mode="nearest") for each in counts)
    if not clutter.any():
        raise InputError("the masked range maps show no clutter", fix="mask one that does")
    if clutter_only:
        kept = _without_unmarked(kept, clutter)
    elif not kept.any():
        raise InputError("the masked range maps show nothing to keep", fix="mask one that does")
    return clutter, kept


def _without_unmarked(
    unmarked: NDArray[np.float64], clutter: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What of the unmarked samples is not clutter like the marked: the object's histogram.

    Where the object never falls, unmarked clutter is all there is, and its ratio to the
    marked one the least. None is where all differ by less than the least object would: the
    subtraction would leave noise, which overlaps with nothing.
    """
    if _overlap(unmarked, clutter) > np.sqrt(1.0 - _LEAST_FOREGROUND_PART):
        return np.zeros_like(unmarked)
    telling = clutter >= _TELLING_PART * clutter.max()
    share = float((unmarked[telling] / clutter[telling]).min())
    return np.maximum(unmarked - share * clutter, 0.0)


def _separability(kept: NDArray[np.float64], clutter: NDArray[np.float64]) -> Separability:
    if kept.sum() < _LEAST_FOREGROUND_PART * clutter.sum():
        return Separability(1.0, "all that is not marked looks like the marked clutter")
    overlap = _overlap(kept, clutter)
    alike = overlap > _MOST_OVERLAP
    return Separability(overlap, "object and clutter look alike" if alike else "")


def _overlap(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Bhattacharyya coefficient of two histograms, 0 apart … 1 alike; 0 where one is empty."""
    size = one.sum() * other.sum()
    return float(min(1.0, np.sqrt(one * other).sum() / np.sqrt(size))) if size > 0 else 0.0
