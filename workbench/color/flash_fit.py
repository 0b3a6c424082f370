"""The flash, the gain of every photograph and the albedo of every sample, fitted together.

The logarithm of a sample's light is a sum: its albedo's, its photograph's gain's and that of what
it receives from the flash. Albedos and gains are linear in it and are eliminated (variable
projection, Golub and Pereyra 1973); what is left is a small system for the flash, solved by Gauss
and Newton's method with Tukey's weights, which leave out highlights, shadows and samples whose
normal is wrong.

Lengths in this module are in median distances of the samples from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from workbench.color.flash_light import FlashLight, incidence_trust
from workbench.color.flash_observations import LogObservations
from workbench.color.flash_parameters import FlashParameters
from workbench.geometry.robust import robust_sigma, tukey_weights

# Residuals below this are the numbers' own noise.
_LEAST_SIGMA = 1e-9
# A sample's own mean follows its observations; this share of an observation at least is left.
_LEAST_LEFT = 0.05
# Keeps the gains' system solvable where photographs lost all their weight, relative to its mean.
_RIDGE = 1e-9
_LONGEST_STEP = 0.15
_SETTLED = 3e-4


@dataclass(frozen=True)
class FlashFit:
    """A fitted flash.

    Attributes
    ----------
    light : the flash.
    log_gains : (photos,) natural logarithms, their mean 0.
    covariance : (3, 3) of the position; the errors of one sample may depend on each other, as
        those of a wrong normal do.
    sigma : spread of the trusted observations' logarithms, relative to their samples' means.
    trusted : share of the observations' weight that is not at grazing incidence.
    used : (m,) weights from 0 to 1 of the last step.
    iterations : steps taken.
    converged : whether the last step moved nothing.
    """

    light: FlashLight
    log_gains: NDArray[np.float64]
    covariance: NDArray[np.float64]
    sigma: float
    trusted: float
    used: NDArray[np.float64]
    iterations: int
    converged: bool

    @property
    def cost(self) -> float:
        """What fits are compared by: a small spread that is not bought by trusting little."""
        return self.sigma / max(self.trusted, 1e-9)


def fitted_flash(
    seen: LogObservations,
    parameters: FlashParameters,
    start: FlashLight,
    log_gains: NDArray[np.float64],
    gain_sigma: float,
    most_iterations: int,
) -> FlashFit:
    """Flash and gains from a start near enough.

    Parameters
    ----------
    parameters : which of the light's numbers are free.
    start : its other numbers stay as they are.
    log_gains : (photos,) to start from.
    gain_sigma : standard deviation of the gains' logarithms about their mean; infinite where
        each photograph had its own exposure.
    """
    light, gains = start, np.asarray(log_gains, float)
    weighed = _weighed(seen, light, gains, None)
    converged, step = False, 0
    while step < most_iterations and not converged:
        step += 1
        system = _System(seen, parameters, light, gains, weighed, gain_sigma)
        change = system.change()
        moved = parameters.moved(light, change)
        converged = system.size(change) < _SETTLED
        gains = gains + system.gain_change(change)
        light = moved
        weighed = _weighed(seen, light, gains, weighed.weights)
    system = _System(seen, parameters, light, gains, weighed, gain_sigma)
    share = float(weighed.trust.sum() / seen.weights.sum())
    used = weighed.weights / np.maximum(seen.weights, np.finfo(float).tiny)
    return FlashFit(light, gains, system.covariance(), weighed.sigma, share, used, step, converged)


def log_residuals(
    seen: LogObservations, light: FlashLight, log_gains: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Logarithm (m,) of what is left of the light when flash and gains are taken out.

    That of the albedo, but for errors.
    """
    return np.asarray(seen.log_values - log_received(seen, light) - log_gains[seen.photo])


def log_received(seen: LogObservations, light: FlashLight) -> NDArray[np.float64]:
    """Natural logarithm (m,) of what observations receive; finite also where that is nothing."""
    return np.log(np.maximum(light.received(seen.places, seen.normals), 1e-12))


@dataclass(frozen=True)
class _Weighed:
    """Weights (m,), the trust in incidence that they include, and the residuals' spread."""

    weights: NDArray[np.float64]
    trust: NDArray[np.float64]
    sigma: float


def _weighed(
    seen: LogObservations,
    light: FlashLight,
    gains: NDArray[np.float64],
    before: NDArray[np.float64] | None,
) -> _Weighed:
    """Tukey's weights about the samples' means as the weights before had them.

    At first about medians: one outlier moves a mean so far that all others seem to be outliers.
    """
    trust = seen.weights * incidence_trust(light.incidence(seen.places, seen.normals))
    logarithms = log_residuals(seen, light, gains)
    residuals, left = seen.about_means(logarithms, trust if before is None else before)
    if before is None:
        residuals = seen.about_medians(logarithms)
    # Of two observations, each lies half their difference from the mean: what the mean took
    # away is given back.
    residuals /= np.sqrt(np.maximum(left, _LEAST_LEFT))
    # Of a sample that lost all other observations nothing can be said.
    told = (left > 1e-6) & (trust > 0.1 * seen.weights)
    sigma = max(robust_sigma(residuals[told]), _LEAST_SIGMA)
    return _Weighed(trust * tukey_weights(residuals, sigma), trust, sigma)


class _System:
    """Normal equations about one state, albedos and gains eliminated."""

    def __init__(
        self,
        seen: LogObservations,
        parameters: FlashParameters,
        light: FlashLight,
        gains: NDArray[np.float64],
        weighed: _Weighed,
        gain_sigma: float,
    ) -> None:
        self._seen, self._parameters = seen, parameters
        self._weights, self._variance = weighed.weights, weighed.sigma**2
        self._values = parameters.values(light)
        columns = parameters.derivatives(seen.places, seen.normals, light)
        both = np.column_stack([columns, log_residuals(seen, light, gains)])
        by_sample, total = seen.sums(both, self._weights)
        share = by_sample / np.where(total > 0.0, total, 1.0)[:, None]
        weighted = self._weights[:, None] * both
        matrix = csr_array(
            (self._weights, seen.sample, seen.first_rows), shape=(seen.photos, seen.samples)
        )
        by_photo = np.stack(
            [np.bincount(seen.photo, column, seen.photos) for column in weighted.T], axis=1
        )
        inner = both.T @ weighted - by_sample.T @ share
        crossed = by_photo - matrix @ share
        # B D⁻¹ Bᵀ as the square of B D⁻½, which is symmetric to the last digit.
        root = np.sqrt(np.where(total > 0.0, total, 1.0))
        scaled = csr_array(
            (self._weights / root[seen.sample], seen.sample, seen.first_rows),
            shape=(seen.photos, seen.samples),
        )
        own = np.bincount(seen.photo, self._weights, seen.photos)
        gram = np.diag(own) - np.asarray((scaled @ scaled.T).todense())
        held = self._variance / gain_sigma**2
        # Only differences of gains can be told: their mean is set to 0.
        gram += held * np.eye(seen.photos) + own.mean() / seen.photos**2
        gram[np.diag_indices(seen.photos)] += _RIDGE * own.mean() + np.finfo(float).tiny
        crossed[:, -1] -= held * gains
        self._gains = cho_solve(cho_factor(gram), crossed)
        reduced = inner - crossed.T @ self._gains
        self._normal, self._right = reduced[:-1, :-1], reduced[:-1, -1]
        prior = self._variance * parameters.priors
        self._normal = self._normal + np.diag(prior)
        self._right = self._right - prior * self._values
        self._columns, self._residuals, self._share = columns, both[:, -1], share

    def change(self) -> NDArray[np.float64]:
        """Step (k,) of the parameters, inside their bounds and not too long."""
        free = np.ones(len(self._values), bool)
        while True:
            step = np.zeros(len(self._values))
            step[free] = np.linalg.solve(self._normal[np.ix_(free, free)], self._right[free])
            held = free & self._parameters.leaves(self._values, step)
            if not held.any():
                break
            free &= ~held
        longest = float(np.abs(step[:3]).max(initial=0.0))
        step *= min(1.0, _LONGEST_STEP / max(longest, 1e-300))
        return np.asarray(self._parameters.inside(self._values + step) - self._values)

    def gain_change(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Step (photos,) of the gains that belongs to one of the parameters."""
        return np.asarray(self._gains[:, -1] - self._gains[:, :-1] @ change)

    def size(self, change: NDArray[np.float64]) -> float:
        """Largest change of a gain, or of another number in parts of what it may be at all."""
        parts = np.abs(change) * np.sqrt(self._parameters.priors)
        return float(max(parts.max(initial=0.0), np.abs(self.gain_change(change)).max()))

    def covariance(self) -> NDArray[np.float64]:
        """(3, 3) of the position, from the spread of the samples' own pulls on it."""
        count = len(self._values)
        if not count:
            return np.full((3, 3), np.inf)
        seen = self._seen
        pulled = self._columns - self._gains[seen.photo, :-1]
        left, _ = seen.about_means(self._residuals - self._gains[seen.photo, -1], self._weights)
        means, total = seen.sums(pulled, self._weights)
        pulled = pulled - (means / np.where(total > 0.0, total, 1.0)[:, None])[seen.sample]
        pulls, _ = seen.sums(pulled * left[:, None], self._weights)
        inverse = np.linalg.inv(self._normal)
        prior = self._variance**2 * np.diag(self._parameters.priors)
        return np.asarray((inverse @ (pulls.T @ pulls + prior) @ inverse)[:3, :3])
