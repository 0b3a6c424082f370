"""Masks where evidence is certain, absent or even, and learning has next to nothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.masking.energy import cut_by_evidence
from workbench.masking.histograms import Example, learned, separability
from workbench.masking.quantisation import ReflectanceLevels
from workbench.stability.case import Bound, Case, Measured, Refused

_CUT, _LEARNT = "cut by evidence", "learned masks"
_GRAY = np.full((24, 24, 3), 100, np.uint8)


def _square() -> NDArray[np.bool_]:
    square = np.zeros((24, 24), bool)
    square[6:18, 6:18] = True
    return square


def _cut(strength: float, smoothness: float, noise: float = 0.0) -> Measured:
    """Share of pixels that are wrong, of a square that evidence of that strength tells of."""
    rng = np.random.default_rng(0)
    evidence = np.where(_square(), strength, -strength)
    evidence = (evidence + noise * strength * rng.standard_normal((24, 24))).astype(np.float32)
    return Measured(float((cut_by_evidence(_GRAY, evidence, smoothness) != _square()).mean()))


def _nothing_known() -> Measured:
    """Without evidence the mask is the clutter's: masks are conservative."""
    found = cut_by_evidence(_GRAY, np.zeros((24, 24), np.float32), 1.0)
    return Measured(float(found.mean()))


def _broken(value: float) -> Measured | Refused:
    evidence = np.ones((24, 24), np.float32)
    evidence[3, 4] = value
    return Measured.nothing(f"{cut_by_evidence(_GRAY, evidence, 1.0).mean():.0%} kept")


def _same_colors() -> Measured | Refused:
    """An example whose object and clutter look the same is told to be of no use."""
    rng = np.random.default_rng(1)
    image = rng.random((60, 60)).astype(np.float32)
    mask = np.where(rng.random((60, 60)) < 0.5, 255, 0).astype(np.uint8)
    found = separability(learned(ReflectanceLevels(), [Example(image, mask)]))
    if found:
        return Measured.nothing(f"told apart with an overlap of {found.overlap:.2f}")
    return Refused(found.reason)


def _probability(values: NDArray[np.float32]) -> Measured:
    """Learned from one pixel of each kind: every probability is one, NaN where nothing is."""
    example = Example(np.array([[0.2, 0.8]], np.float32), np.array([[0, 255]], np.uint8))
    found = learned(ReflectanceLevels(), [example]).probability(values)
    known = np.isfinite(values)
    right = np.where(known, (found >= 0) & (found <= 1), np.isnan(found))
    return Measured(float((~right).sum()))


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
) -> Case:
    return Case(f"masks/{name}", method, stiff, run, bound, refusal)


_NONE = Bound(0.0, "", "none is allowed")
_CORNERS = Bound(0.0, "of the pixels", "the least energy: a corner costs more to cut than to keep")

MASK_CASES = (
    _case("evidence 1e30", _CUT, "Evidence at the end of single precision.",
          partial(_cut, 1e30, 1.0), _CORNERS),
    _case("evidence 1e-30", _CUT, "Evidence and smoothness next to nothing.",
          partial(_cut, 1e-30, 0.0), _CORNERS),
    _case("noise 1.5 times the evidence", _CUT, "One pixel in four has the wrong sign.",
          partial(_cut, 1.0, 0.75, 1.5),
          Bound(0.08, "of the pixels", "a pixel along the square's outline of 48")),
    _case("no evidence", _CUT, "Nothing is known of any pixel.", _nothing_known, _NONE),
    _case("NaN", _CUT, "Evidence that is no number.", partial(_broken, np.nan),
          refusal="not finite"),
    _case("infinite", _CUT, "Evidence without bound.", partial(_broken, np.inf),
          refusal="not finite"),
    _case("object like clutter", _LEARNT, "Object and clutter have the same colours.",
          _same_colors, refusal="look alike"),
    _case("one pixel of each", _LEARNT, "One pixel to learn from, and values out of any range.",
          partial(_probability, np.array([[0.0, 1.0, -3.0, 1e30, 5e-324, np.nan]], np.float32)),
          _NONE),
)  # fmt: skip
