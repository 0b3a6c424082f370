"""Which terms of a flash's light are worth having: those that foretell what was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.color.flash_fit import FlashFit, fitted_flash, log_residuals
from workbench.color.flash_light import FlashLight, incidence_trust
from workbench.color.flash_observations import LogObservations
from workbench.color.flash_parameters import FlashParameters, FlashTerm
from workbench.geometry.robust import TUKEY

_STEPS = 8
# What a term has to gain on samples it was not fitted to: of the variance of observations that
# are no outliers, and in standard errors.
_LEAST_GAIN, _LEAST_CERTAINTY = 0.003, 3.0


@dataclass(frozen=True)
class TermTrial:
    """Whether a term of the light was worth keeping.

    Attributes
    ----------
    term : ``falloff``, ``roughness`` or ``indirect``.
    without, with_term : spread of the logarithm of samples that were not fitted to, capped
        where it is an outlier's.
    certainty : how many standard errors lower the spread is with it.
    kept : as said.
    """

    term: FlashTerm
    without: float
    with_term: float
    certainty: float
    kept: bool


def chosen_terms(
    seen: LogObservations,
    halves: NDArray[np.bool_],
    full: FlashFit,
    terms: tuple[FlashTerm, ...],
    gain_sigma: float,
) -> tuple[tuple[FlashTerm, ...], tuple[TermTrial, ...]]:
    """Terms without which samples that were not fitted to are foretold less well.

    One after the other is given up, the least useful first: a model that lacks what matters
    may be far from the truth, and says nothing of what else would matter.

    Parameters
    ----------
    halves : (samples,) of which half a sample is; each is foretold by the other.
    full : a fit with all terms to all samples, to start from.
    """
    kept = terms
    trials: list[TermTrial] = []
    with_all = _held_out_losses(seen, halves, full, terms, kept, gain_sigma)
    while kept:
        shorter = {gone: tuple(term for term in kept if term != gone) for gone in kept}
        losses = {
            gone: _held_out_losses(seen, halves, full, terms, left, gain_sigma)
            for gone, left in shorter.items()
        }
        outcomes = {term: _trial(term, losses[term], with_all, full.sigma) for term in kept}
        doubtful = [term for term in kept if not outcomes[term].kept]
        if not doubtful:
            trials += outcomes.values()
            break
        least = min(doubtful, key=lambda term: float(losses[term].mean()))
        trials.append(outcomes[least])
        kept, with_all = shorter[least], losses[least]
    return kept, tuple(trials)


def _trial(
    term: FlashTerm,
    without: NDArray[np.float64],
    with_term: NDArray[np.float64],
    sigma: float,
) -> TermTrial:
    gained = without - with_term
    error = float(gained.std() / np.sqrt(max(len(gained), 1)))
    certainty = float(gained.mean()) / error if error > 0.0 else 0.0
    spreads = float(np.sqrt(without.mean())), float(np.sqrt(with_term.mean()))
    worth = float(gained.mean()) > _LEAST_GAIN * sigma**2
    return TermTrial(term, *spreads, certainty, worth and certainty > _LEAST_CERTAINTY)


def given_up(
    light: FlashLight, terms: tuple[FlashTerm, ...], kept: tuple[FlashTerm, ...]
) -> FlashLight:
    """The light without those of the terms that are not kept; what was no term stays."""
    gone = set(terms) - set(kept)
    return replace(
        light,
        falloff=() if "falloff" in gone else light.falloff,
        roughness_rad=0.0 if "roughness" in gone else light.roughness_rad,
        indirect=0.0 if "indirect" in gone else light.indirect,
    )


def _held_out_losses(
    seen: LogObservations,
    halves: NDArray[np.bool_],
    base: FlashFit,
    all_terms: tuple[FlashTerm, ...],
    terms: tuple[FlashTerm, ...],
    gain_sigma: float,
) -> NDArray[np.float64]:
    """Capped mean square (samples,) of every sample, foretold by the half it is not in."""
    losses = np.zeros(seen.samples)
    start = given_up(base.light, all_terms, terms)
    # Weights and cap are the base's, so that no model gains by trusting less.
    trust = seen.weights * incidence_trust(base.light.incidence(seen.places, seen.normals))
    for half in (halves, ~halves):
        fit = fitted_flash(
            seen.of_samples(half),
            FlashParameters(True, terms),
            start,
            base.log_gains,
            gain_sigma,
            _STEPS,
        )
        residuals = log_residuals(seen, fit.light, fit.log_gains)
        middle, _ = seen.about_means(residuals, trust * (base.used > 0.0))
        square = np.minimum(middle**2, (TUKEY * base.sigma) ** 2)
        sums, total = seen.sums(square[:, None], trust)
        told = ~half & (total > 0.0)
        losses[told] = sums[told, 0] / total[told]
    return losses
