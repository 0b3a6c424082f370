"""The colours one photograph tells, brought from its flash's light to the albedo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_observations import Observations
from workbench.color.flash_light import FlashLight, albedo, incidence_trust
from workbench.errors import InputError
from workbench.geometry.transforms import Matrix4, apply

# The logarithm of nothing is that of a surface far darker than any is.
_DARKEST = 1e-4
# How much of the weight a surface loses that faces halfway between flash and camera, where
# varnish shines, and the sine of the angle over which it comes back: 15°.
_HIGHLIGHT, _HIGHLIGHT_SINE = 0.95, 0.26
_TINY = np.finfo(float).tiny


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
