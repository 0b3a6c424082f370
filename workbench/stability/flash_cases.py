"""Photographs freed of their flash and blended, where light and values go to extremes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending import blended
from workbench.color.blending_colors import Colored, corrected
from workbench.color.blending_observations import Observations
from workbench.color.flash_estimation import estimated_flash
from workbench.color.flash_light import FlashLight, albedo, trust, value_trust
from workbench.color.flash_observations import FlashObservations, NoFlashEstimate
from workbench.geometry.transforms import apply, inverse, looking_at, rotate
from workbench.stability.case import Bound, Case, Measured, Refused

_FLASH = "flash correction"

_LIGHT = FlashLight(np.array([-0.13, -0.03, 0.01]), epsilon=0.0)


def _at_angle(degrees: float, distance: float = 1.0) -> tuple[NDArray[np.float64], ...]:
    """Place and normal (1, 3) with that incidence, the flash ``distance`` away along z."""
    angle = np.radians(degrees)
    place = _LIGHT.position_in_camera + np.array([0.0, 0.0, distance])
    # The cosine by the sine of what is left of a right angle keeps its digits near it.
    normal = [np.cos(angle), 0.0, -np.sin(np.pi / 2 - angle)]
    return place[None], np.array([normal])


def _grazing(degrees: float) -> Measured:
    """The albedo of a surface seen at that incidence, and that it does not count."""
    place, normal = _at_angle(degrees)
    cosine = np.sin(np.radians(90.0) - np.radians(degrees))
    found = albedo(np.full((1, 3), 0.4 * cosine), _LIGHT.received(place, normal), 1.0)
    weight = float(trust(_LIGHT, place, normal, np.full((1, 3), 0.5))[0])
    error = float(np.abs(found / 0.4 - 1.0).max())
    return Measured(max(error, weight), f"trusted {weight:.1e}")


def _at_flash() -> Measured:
    """Nothing but finite numbers from a sample at the flash itself, and no trust in it."""
    light = replace(_LIGHT, roughness_rad=0.4, falloff=(0.1, 0.2), indirect=0.1, epsilon=0.1)
    place, normal = light.position_in_camera[None], np.array([[0.0, 0.0, -1.0]])
    received = light.received(place, normal)
    weight = trust(light, place, normal, np.full((1, 3), 0.5))
    seen = Observations(
        np.zeros(1, np.int64), np.full((1, 3), 0.5, np.float32), normal.astype(np.float32),
        np.ones(1, np.float32),
    )  # fmt: skip
    kept = corrected(seen, place, np.eye(4), light, 1.0)
    unsound = not (np.isfinite(received).all() and received[0] > 0)
    return Measured(float(unsound) + float(weight[0]) + len(kept.index), f"light {received[0]:.2g}")


def _inverse_square(distance: float) -> Measured:
    """Light at an extreme distance against the law of eq. 3.1."""
    place, normal = _at_angle(30.0, distance)
    light = float(_LIGHT.received(place, normal)[0])
    exact = place[0, 2] - _LIGHT.position_in_camera[2]
    return Measured(abs(light * exact**2 / np.cos(np.radians(30.0)) - 1.0))


def _black_and_full() -> Measured:
    """Values at and beyond both ends of the sensor, not a number among them: no trust at all."""
    values = np.array([0.0, -0.1, 5e-324, 1.0, 1.5, np.inf, -np.inf, np.nan])
    return Measured(float(value_trust(values).max()))


def _observations(value: float, weight: float = 1.0, photos: int = 6) -> FlashObservations:
    rng = np.random.default_rng(0)
    samples = 200
    sample, photo = (v.ravel() for v in np.meshgrid(np.arange(samples), np.arange(photos)))
    places = rng.uniform([-0.4, -0.4, 1.1], [0.4, 0.4, 1.9], (len(sample), 3))
    normals = np.tile([0.0, 0.0, -1.0], (len(sample), 1))
    return FlashObservations(
        sample, photo, places, normals, np.full(len(sample), value), np.full(len(sample), weight)
    )


def _estimated(seen: FlashObservations) -> Measured | Refused:
    found = estimated_flash(seen)
    if isinstance(found, NoFlashEstimate):
        return Refused(found.reason)
    return Measured.nothing(f"the flash was found at {found.light.position_in_camera}")


def flash_scene() -> FlashObservations:
    """A lumpy ball from all sides, lit by a flash beside the lens, with 1 % of noise."""
    rng = np.random.default_rng(0)
    samples, photos = 400, 12
    way = rng.standard_normal((samples, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    points, paint = 0.35 * way, np.exp(rng.uniform(np.log(0.1), np.log(0.8), samples))
    parts = []
    for k in range(photos):
        turn = 2 * np.pi * k / photos
        distance = 1.2 + 1.2 * (k % 4) / 3
        center = distance * np.array([np.cos(turn), np.sin(turn), 0.3 * (k % 3 - 1)])
        camera_from_world = inverse(looking_at(center, (0.0, 0.0, 0.0)))
        place, normal = apply(camera_from_world, points), rotate(camera_from_world, way)
        to_flash = _LIGHT.position_in_camera - place
        length = np.linalg.norm(to_flash, axis=1)
        cosine = np.einsum("ni,ni->n", normal, to_flash) / length
        shown = np.flatnonzero((cosine > 0.1) & (np.einsum("ni,ni->n", normal, -place) > 0.3))
        value = (paint * cosine / length**2)[shown] * np.exp(0.01 * rng.standard_normal(len(shown)))
        parts.append((shown, np.full(len(shown), k), place[shown], normal[shown], value))
    sample, photo, place, normal, value = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return FlashObservations(sample, photo, place, normal, value, np.ones(len(value)))


def _estimate() -> Measured | Refused:
    """The flash's place against the true one."""
    found = estimated_flash(flash_scene(), terms=())
    if isinstance(found, NoFlashEstimate):
        return Refused(found.reason)
    apart = found.light.position_in_camera - _LIGHT.position_in_camera
    told = f"told ±{1e3 * found.position_sigma.max():.2g} mm, condition {found.condition:.2g}"
    return Measured(float(np.abs(apart).max()), told)


def _one_photograph() -> Measured | Refused:
    return _estimated(_observations(0.3, photos=1))


def _wall_from_one_place() -> Measured | Refused:
    """A flat wall, square on and from one distance: photographs that are all the same."""
    x, y = (v.ravel() for v in np.meshgrid(*(np.linspace(-0.4, 0.4, 15),) * 2))
    place = np.stack([x, y, np.full_like(x, 1.5)], axis=1)
    way = _LIGHT.position_in_camera - place
    distance = np.linalg.norm(way, axis=1)
    value = 0.4 * -way[:, 2] / distance**3
    rng = np.random.default_rng(1)
    n = len(x)
    found = estimated_flash(
        FlashObservations(
            np.tile(np.arange(n), 6), np.repeat(np.arange(6), n), np.tile(place, (6, 1)),
            np.tile([0.0, 0.0, -1.0], (6 * n, 1)),
            np.tile(value, 6) * np.exp(0.01 * rng.standard_normal(6 * n)), np.ones(6 * n),
        )
    )  # fmt: skip
    if isinstance(found, NoFlashEstimate):
        return Refused(found.reason)
    if found.warnings:
        return Refused("; ".join(found.warnings))
    return Measured.nothing(f"position certain to {found.position_sigma}")


def _no_weight() -> Measured:
    """Photographs that show samples with no weight, beside some that do."""
    index = np.arange(10)
    none = Colored(index, np.full((10, 3), 0.9), np.zeros(10))
    some = Colored(index[:5], np.full((5, 3), 0.2), np.full(5, 1e-300))
    found = blended([none, some], 10)
    wrong = np.isfinite(found.colors).all(axis=1) != (index < 5)
    return Measured(float(wrong.sum() + np.abs(found.colors[:5] - 0.2).max()))


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
) -> Case:
    return Case(f"color/{name}", method, stiff, run, bound, refusal)


_EXACT = Bound(1e-12, "", "rounding: the formula has no cancellation")
_NONE = Bound(0.0, "", "none is allowed")

FLASH_CASES = (
    _case("grazing 89.9°", _FLASH, "The light is a sixth of a percent of what faces it.",
          partial(_grazing, 89.9), Bound(1e-4, "", "no trust beyond what the cosine squared is")),
    _case("grazing 89.9999999°", _FLASH, "The light is two billionths of what faces it.",
          partial(_grazing, 89.9999999), Bound(1e-6, "", "digits of the normal near 90°")),
    _case("at the flash", _FLASH, "A sample at the flash itself, at no distance in no direction.",
          _at_flash, _NONE),
    _case("1e-6 m away", _FLASH, "A sample a micrometre before the flash.",
          partial(_inverse_square, 1e-6), Bound(1e-9, "", "digits of 1e-6 m beside a centimetre")),
    _case("1e5 m away", _FLASH, "A sample a hundred kilometres away.",
          partial(_inverse_square, 1e5), _EXACT),
    _case("black and full", _FLASH, "Values at and beyond both ends of the sensor.",
          _black_and_full, _NONE),
    _case("a ball", "estimate of the flash", "An ordinary ball, to compare with.", _estimate,
          Bound(0.01, "m", "1 % of noise over 2000 observations of distances of 1.2 m and more")),
    _case("all black", "estimate of the flash", "Every value is zero.",
          lambda: _estimated(_observations(0.0)), refusal="no sample has light"),
    _case("all saturated", "estimate of the flash", "No value is to be trusted.",
          lambda: _estimated(_observations(1.0, 0.0)), refusal="no sample has light"),
    _case("one photograph", "estimate of the flash", "Nothing tells flash from colours.",
          _one_photograph, refusal="one photograph alone"),
    _case("a wall from one place", "estimate of the flash", "All photographs are the same.",
          _wall_from_one_place, refusal="do not tell"),
    _case("no weight", "blending of photographs", "Weights of 0 and of 1e-300.", _no_weight,
          Bound(1e-12, "", "rounding; no sample without weight may have a colour")),
)  # fmt: skip
