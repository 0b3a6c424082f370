"""Where the flash is, how it shines and how strong it was each time, from the photographs.

A place of the surface has one colour; what differs between the photographs that show it is the
flash's doing. Terms beyond position and gains are kept only where they foretell samples that
they were not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.color.flash_fit import FlashFit, fitted_flash, log_residuals
from workbench.color.flash_light import FlashLight, incidence_trust
from workbench.color.flash_observations import (
    FlashObservations,
    LogObservations,
    usable_observations,
)
from workbench.color.flash_observations import (
    NoFlashEstimate as NoFlashEstimate,
)
from workbench.color.flash_parameters import FlashParameters, FlashTerm
from workbench.color.flash_terms import TermTrial, chosen_terms, given_up
from workbench.errors import InputError

# Lengths are in median distances of the samples from the camera.
_RING, _ROUND = 0.3, 4
_FEWEST_SPARE = 30
# Observations that the search, the choice of terms and the last fit look at.
_FEW, _SOME, _MORE = 6_000, 20_000, 60_000
_SEARCH_STEPS, _TRIAL_STEPS, _LAST_STEPS, _GAIN_STEPS = 8, 8, 60, 2
# A direction in which the flash is known no better than this is told of; a flash of which no
# direction is known better than that is not.
_LOOSE, _UNKNOWN = 0.05, 0.15
_ENOUGH_PHOTOS, _ENOUGH_SAMPLES = 4, 20
_AXES = ("sideways", "up or down", "along the view")


@dataclass(frozen=True)
class FlashEstimate:
    """The flash as the photographs tell it.

    Attributes
    ----------
    light : with the median distance of the samples as its reference distance.
    gains : (photos,) of each photograph relative to their geometric mean; NaN where the
        observations do not tell it.
    position_covariance : (3, 3) of the flash's position in the camera frame, squared units:
        from the spread of the samples; from how far the position moves when only the half of
        the observations that face the flash best is asked, as it does where normals are wrong or
        the surface reflects otherwise than the model says; and from how far the terms that were
        given up would move it.
    loose : (k, 3) unit directions in the camera frame in which the position is known no better
        than to 5 % of the distance; loose_sigmas (k,) are its standard deviations there.
    trials : the terms that were tried.
    scatter_as_shot, scatter_with_gains, scatter : standard deviation of the logarithm of a
        sample's luminance over the photographs, the median of all samples: as it is, with the
        best gain for every photograph, and with flash and gains taken out.
    scatter_held_out : the same as the last, of samples that flash and gains were not fitted to.
    sigma : robust standard deviation of a single observation's logarithm.
    observations : that were usable; used is the share of them that had weight in the end.
    iterations, converged : of the last fit.
    """

    light: FlashLight
    gains: NDArray[np.float64]
    position_covariance: NDArray[np.float64]
    loose: NDArray[np.float64]
    loose_sigmas: NDArray[np.float64]
    trials: tuple[TermTrial, ...]
    scatter_as_shot: float
    scatter_with_gains: float
    scatter: float
    scatter_held_out: float
    sigma: float
    observations: int
    used: float
    iterations: int
    converged: bool

    @property
    def position_sigma(self) -> NDArray[np.float64]:
        """(3,) standard deviation of the position, right, down, forward."""
        return np.asarray(np.sqrt(np.diag(self.position_covariance)))

    @property
    def condition(self) -> float:
        """How much better the best known direction of the position is known than the worst."""
        variances = np.linalg.eigvalsh(self.position_covariance)
        return float(np.sqrt(variances[-1] / max(variances[0], np.finfo(float).tiny)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the photographs leave open, in sentences."""
        told = [
            f"the flash's place {_AXES[int(np.abs(way).argmax())]} is known to "
            f"±{sigma:.3g} only: photographs from other distances and sides would tell it"
            for way, sigma in zip(self.loose, self.loose_sigmas, strict=True)
        ]
        missing = np.flatnonzero(np.isnan(self.gains))
        if len(missing):
            told.append(f"{len(missing)} photographs share no sample with the others")
        if not self.converged:
            told.append("the fit of the flash had not come to rest")
        return tuple(told)


def estimated_flash(
    seen: FlashObservations,
    *,
    gain_sigma: float = np.inf,
    terms: Sequence[FlashTerm] = ("falloff", "roughness", "indirect"),
    epsilon: float = 0.0,
    roughness_rad: float = 0.0,
) -> FlashEstimate | NoFlashEstimate:
    """Position, gains and further terms of the flash that lit the observations.

    Parameters
    ----------
    seen : samples that the flash lights, without those known to lie in shadow; what is left of
        shadows and highlights is found and left out. Of more than some 60,000 the flash is
        fitted to so many, all observations of samples drawn blindly; the gains are to all.
    gain_sigma : standard deviation of the logarithm of the photographs' gains: some 0.03 for a
        flash set by hand, infinite for one that metered each photograph.
    terms : that may be tried beyond position and gains.
    epsilon : of eq. 3.2, which stays as it is. It is there to guard a division, and moves the
        position when it is part of the model: 0 is the physical light.
    roughness_rad : of the surface, where it is known; it stays as it is, and is no term.

    Raises
    ------
    InputError : a number is out of its range.
    """
    if not gain_sigma > 0.0:
        raise InputError("the spread of the gains must be positive", found=str(gain_sigma))
    if roughness_rad > 0.0:
        terms = [term for term in terms if term != "roughness"]
    # Raises where a number is out of its range.
    bare = FlashLight(np.zeros(3), epsilon=epsilon, roughness_rad=roughness_rad)
    usable = usable_observations(seen)
    if isinstance(usable, NoFlashEstimate):
        return usable
    ready, _, photos, distance = usable
    spare = len(ready.sample) - ready.samples - ready.photos
    if spare < _FEWEST_SPARE:
        return NoFlashEstimate(
            f"{len(ready.sample)} observations of {ready.samples} samples in {ready.photos} "
            "photographs are too few to tell the flash from colours and gains"
        )
    rng = np.random.default_rng(0)
    few, some, more = (_some(ready, most, rng) for most in (_FEW, _SOME, _MORE))
    found = _searched(few, bare, tuple(terms), gain_sigma)
    model = FlashParameters(True, tuple(terms))
    fit = fitted_flash(some, model, found.light, found.log_gains, gain_sigma, _LAST_STEPS)
    halves = rng.random(some.samples) < 0.5
    kept, trials = chosen_terms(some, halves, fit, tuple(terms), gain_sigma)
    parameters = FlashParameters(True, kept)
    full, start = fit.light, given_up(fit.light, tuple(terms), kept)
    fit = fitted_flash(more, parameters, start, fit.log_gains, gain_sigma, _LAST_STEPS)
    # What light there is, so many tell as well as all; of its strength, each tells its own.
    final = fitted_flash(
        ready, FlashParameters(False), fit.light, fit.log_gains, gain_sigma, _GAIN_STEPS
    )
    # Where the terms that were given up would have it, if they are there after all.
    shifts = np.stack(
        [
            _shift_when_facing(more, fit, gain_sigma),
            full.position_in_camera - fit.light.position_in_camera,
        ]
    )
    covariance = fit.covariance + shifts.T @ shifts
    variances, ways = np.linalg.eigh(covariance)
    sigmas = np.sqrt(np.maximum(variances, 0.0))
    if not np.isfinite(sigmas).all() or sigmas[0] > _UNKNOWN:
        return NoFlashEstimate("the photographs do not tell in any direction where the flash is")
    loose = sigmas > _LOOSE
    gains = np.full(int(seen.photo.max()) + 1, np.nan)
    gains[photos] = np.exp(final.log_gains)
    return FlashEstimate(
        _scaled(fit.light, distance),
        gains,
        covariance * distance**2,
        ways.T[loose],
        sigmas[loose] * distance,
        trials,
        *_scatters(more, fit, gain_sigma),
        _held_out_scatter(some, halves, fit, parameters, gain_sigma),
        final.sigma,
        len(ready.sample),
        float((final.used > 0.0).mean()),
        fit.iterations,
        fit.converged,
    )


def sample_scatter(
    logarithms: NDArray[np.float64],
    sample: NDArray[np.integer],
    least_photos: int = _ENOUGH_PHOTOS,
) -> float:
    """Standard deviation over the photographs, the median of all samples.

    Parameters
    ----------
    logarithms : (m,) of a sample's luminance in a photograph.
    sample : (m,) integer.
    least_photos : samples with fewer observations say too little of a standard deviation; they
        count where hardly any has more.
    """
    _, number, count = np.unique(sample, return_inverse=True, return_counts=True)
    if not len(count):
        return float("nan")
    means = np.bincount(number, logarithms) / count
    apart = logarithms - means[number]
    deviations = np.sqrt(np.bincount(number, apart**2) / count)
    enough = count >= least_photos
    if enough.sum() < _ENOUGH_SAMPLES:
        enough = count >= 2
    return float(np.median(deviations[enough])) if enough.any() else float("nan")


def _some(seen: LogObservations, most: int, rng: np.random.Generator) -> LogObservations:
    """All observations of so many samples, drawn blindly, that they are no more than asked."""
    if len(seen.sample) <= most:
        return seen
    order = rng.permutation(seen.samples)
    counts = np.bincount(seen.sample, minlength=seen.samples)
    kept = np.zeros(seen.samples, bool)
    kept[order[np.cumsum(counts[order]) <= most]] = True
    return seen.of_samples(kept)


def _searched(
    seen: LogObservations, bare: FlashLight, terms: tuple[FlashTerm, ...], gain_sigma: float
) -> FlashFit:
    """The best fit of a model with all terms, started from the lens and from around it."""
    angles = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
    ring = _RING * np.stack([np.cos(angles), np.sin(angles), np.zeros(_ROUND)], axis=1)
    none = np.zeros(seen.photos)
    fits = [
        fitted_flash(
            seen,
            FlashParameters(True, model),
            replace(bare, position_in_camera=place),
            none,
            gain_sigma,
            _SEARCH_STEPS,
        )
        # A start that the terms lead astray may be found without them, and the other way round.
        for model in dict.fromkeys(((), terms))
        for place in [np.zeros(3), *ring]
    ]
    return min(fits, key=lambda fit: fit.cost)


def _shift_when_facing(
    seen: LogObservations, fit: FlashFit, gain_sigma: float
) -> NDArray[np.float64]:
    """How far (3,) the position moves without the half of the observations of less incidence."""
    cosine = fit.light.incidence(seen.places, seen.normals)
    facing = cosine >= np.median(cosine)
    chosen = replace(seen, weights=np.where(facing, seen.weights, 1e-6 * seen.weights))
    other = fitted_flash(
        chosen, FlashParameters(), fit.light, fit.log_gains, gain_sigma, _TRIAL_STEPS
    )
    return other.light.position_in_camera - fit.light.position_in_camera


def _scatters(
    seen: LogObservations, fit: FlashFit, gain_sigma: float
) -> tuple[float, float, float]:
    """As shot, with the best gains alone, and with flash and gains taken out."""
    sure = _sure(seen, fit)
    none = FlashLight(np.zeros(3), epsilon=1.0)
    even = replace(seen, places=np.tile([0.0, 0.0, 1.0], (len(seen.sample), 1)))
    alone = fitted_flash(
        even, FlashParameters(False), none, np.zeros(seen.photos), gain_sigma, _LAST_STEPS
    )
    return (
        sample_scatter(seen.log_values[sure], seen.sample[sure]),
        sample_scatter((seen.log_values - alone.log_gains[seen.photo])[sure], seen.sample[sure]),
        sample_scatter(log_residuals(seen, fit.light, fit.log_gains)[sure], seen.sample[sure]),
    )


def _held_out_scatter(
    seen: LogObservations,
    halves: NDArray[np.bool_],
    fit: FlashFit,
    parameters: FlashParameters,
    gain_sigma: float,
) -> float:
    """The scatter of each half with flash and gains of the other, averaged."""
    scatters = []
    for half in (halves, ~halves):
        other = fitted_flash(
            seen.of_samples(half), parameters, fit.light, fit.log_gains, gain_sigma, _TRIAL_STEPS
        )
        measured = _sure(seen, fit) & ~half[seen.sample]
        logarithms = log_residuals(seen, other.light, other.log_gains)
        scatters.append(sample_scatter(logarithms[measured], seen.sample[measured]))
    return float(np.mean(scatters))


def _sure(seen: LogObservations, fit: FlashFit) -> NDArray[np.bool_]:
    """(m,) observations that are trusted more than half."""
    trust = incidence_trust(fit.light.incidence(seen.places, seen.normals))
    return np.asarray(seen.weights * trust > 0.5)


def _scaled(light: FlashLight, distance: float) -> FlashLight:
    """The light with lengths in units of which the median distance has so many."""
    return replace(
        light,
        position_in_camera=light.position_in_camera * distance,
        reference_distance=distance,
    )
