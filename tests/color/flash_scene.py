"""A lumpy ball photographed with a flash, lit by formulas written without the code under test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.color.flash_observations import FlashObservations


@dataclass(frozen=True)
class FlashScene:
    """Observations and what made them."""

    seen: FlashObservations
    gains: NDArray[np.float64]
    albedo: NDArray[np.float64]  # of every observation
    outlier: NDArray[np.bool_]


def rough_reflection(
    normals: NDArray[np.float64],
    lights: NDArray[np.float64],
    views: NDArray[np.float64],
    sigma: float,
) -> NDArray[np.float64]:
    """Oren and Nayar 1994, eq. 30 with angles, for an albedo of 1 and light of 1 when facing."""
    theta_l = np.arccos(np.clip((normals * lights).sum(axis=1), -1, 1))
    theta_v = np.arccos(np.clip((normals * views).sum(axis=1), -1, 1))

    def around(ways):
        flat = ways - (ways * normals).sum(axis=1, keepdims=True) * normals
        return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)

    azimuth = np.maximum((around(lights) * around(views)).sum(axis=1), 0)
    a = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33)
    b = 0.45 * sigma**2 / (sigma**2 + 0.09)
    wide, narrow = np.maximum(theta_l, theta_v), np.minimum(theta_l, theta_v)
    lobe = azimuth * np.sin(wide) * np.tan(narrow)
    return np.maximum(np.cos(theta_l), 0) * (a + b * lobe)


def flash_scene(
    seed: int = 0,
    samples: int = 1500,
    photos: int = 30,
    flash: tuple[float, float, float] = (-0.13, -0.05, 0.02),
    distances: tuple[float, float] = (1.2, 2.4),
    sigma: float = 0.0,
    beam: float = 0.0,
    indirect: float = 0.0,
    gain_sigma: float = 0.0,
    noise: float = 0.01,
    normal_error: float = 0.0,
    outliers: float = 0.0,
    radius: float = 0.35,
    lumps: float = 0.15,
    scale: float = 1.0,
    flat: bool = False,
) -> FlashScene:
    """A ball with lumps, seen from all sides; or a flat wall, from the front.

    ``beam`` is the loss of intensity per squared tangent about an axis tilted by 2° and −3°;
    ``indirect`` is light relative to that of a facing surface at 1 m.
    """
    rng = np.random.default_rng(seed)
    if flat:
        points = np.column_stack([rng.uniform(-0.6, 0.6, (samples, 2)), np.zeros(samples)])
        normals = np.tile([0.0, 0.0, 1.0], (samples, 1))
    else:
        normals, points = _lumpy(rng, samples, radius, lumps)
    paint = np.exp(rng.uniform(np.log(0.1), np.log(0.8), samples))
    gains = np.exp(gain_sigma * rng.standard_normal(photos))
    gains /= np.exp(np.log(gains).mean())
    tilted = normals + normal_error * rng.standard_normal(normals.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    parts = []
    for k in range(photos):
        camera = _camera(rng, k / photos, distances, flat, 0.05 if flat else radius / 7)
        place = (points - camera[1]) @ camera[0].T
        normal = normals @ camera[0].T
        view = -place / np.linalg.norm(place, axis=1, keepdims=True)
        way = np.array(flash) - place
        distance = np.linalg.norm(way, axis=1)
        to_flash = way / distance[:, None]
        axis = np.array([np.tan(np.radians(2)), np.tan(np.radians(-3)), 1.0])
        along = -(to_flash @ axis) / np.linalg.norm(axis)
        light = (1 - beam * (1 / along**2 - 1)) / distance**2
        value = light * rough_reflection(normal, to_flash, view, sigma) + indirect
        lit = ((normal * view).sum(axis=1) > 0.25) & ((normal * to_flash).sum(axis=1) > 0.05)
        lit &= rng.random(samples) < 0.8
        which = np.flatnonzero(lit)
        parts.append(
            (
                which,
                np.full(len(which), k),
                scale * place[which],
                (tilted @ camera[0].T)[which],
                gains[k] * paint[which] * value[which],
            )
        )
    sample, photo, place, normal, value = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    value = value * np.exp(noise * rng.standard_normal(len(value)))
    strange = rng.random(len(value)) < outliers
    value[strange] *= np.where(rng.random(strange.sum()) < 0.5, 0.2, 3.0)
    seen = FlashObservations(sample, photo, place, normal, value, np.ones(len(value)))
    return FlashScene(seen, gains, paint[sample], strange)


def _lumpy(rng, samples: int, mean: float, lumps: float):
    """Normals and points of the surface r = mean (1 + lumps · waves of the direction)."""
    ways = rng.standard_normal((samples, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    waves = rng.standard_normal((3, 3)) * 3.0
    phase = rng.uniform(0, 6, 3)

    def radius(at):
        unit = at / np.linalg.norm(at, axis=1, keepdims=True)
        return mean * (1 + lumps * np.sin(unit @ waves.T + phase).mean(axis=1))

    points = ways * radius(ways)[:, None]
    # The surface is where |x| − r(x) is 0; its gradient is the normal.
    steps = 1e-6 * mean * np.eye(3)

    def height(at):
        return np.linalg.norm(at, axis=1) - radius(at)

    gradient = np.stack([height(points + s) - height(points - s) for s in steps], axis=1)
    return gradient / np.linalg.norm(gradient, axis=1, keepdims=True), points


def _camera(rng, turn: float, distances: tuple[float, float], flat: bool, stray: float):
    """Rotation to the camera and its middle; it looks at the ball, or squarely at the wall."""
    distance = rng.uniform(*distances)
    if flat:
        middle = np.array([*rng.uniform(-0.5, 0.5, 2), distance])
    else:
        angle, up = 2 * np.pi * turn, rng.uniform(-0.4, 0.6)
        way = np.array([np.cos(angle) * np.cos(up), np.sin(angle) * np.cos(up), np.sin(up)])
        middle = distance * way
    aim = np.array([*middle[:2], 0.0]) if flat else np.zeros(3)
    forward = aim + rng.normal(0, stray, 3) - middle
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0] if flat else [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(forward, right), forward]), middle
