"""Rays of pictures and the light they find: from the eye, shadows, open sky, one bounce.

Directions follow one Halton sequence for all rays, each turned about its normal by an angle of its
own, at most so far that the samples together cover the circle: neighbours stay nearly parallel
(Jaspe 2018, 4.5.3).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.ray_hits import RayCaster, RayHits
from workbench.raytracing.ray_tiles import picture_order
from workbench.raytracing.visibility_front import VisibilityFront

LightKind = Literal["primary", "shadow", "ambient", "bounce"]
LIGHT_KINDS: tuple[LightKind, ...] = ("primary", "shadow", "ambient", "bounce")
_LIFT = np.float32(2e-5)
_GREY = np.float32(0.6)


@dataclass(frozen=True)
class LightOptions:
    """How light is sampled.

    Attributes
    ----------
    samples : rays a place.
    reach : how far an obstacle of ambient light may be, in local units.
    sun : (3,) direction to the light, in the surface's frame.
    sun_radius_deg : half the angle that the light is wide; 0 casts hard shadows.
    sun_light, sky_light : linear strengths.
    rays_at_once : that one cast may have; each takes about 100 B.
    seed : of the angles.
    """

    samples: int = 16
    reach: float = math.inf
    sun: tuple[float, float, float] = (0.4, -0.6, 0.7)
    sun_radius_deg: float = 0.0
    sun_light: float = 0.8
    sky_light: float = 0.4
    rays_at_once: int = 1 << 20
    seed: int = 0


@dataclass
class Fronts:
    """What casts of each kind, by name, leave to the next of it."""

    of: dict[str, VisibilityFront] = field(default_factory=lambda: defaultdict(VisibilityFront))


@dataclass(frozen=True)
class Places:
    """Points of a surface on the side that is looked at.

    Attributes
    ----------
    points : (n, 3) float32, local, lifted a little off the surface.
    normals : (n, 3) float32 unit, towards the open side.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]

    @classmethod
    def on(cls, points: NDArray[np.float32], normals: NDArray[np.float32]) -> Places:
        """Places at points of the surface itself."""
        return cls(np.asarray(points + _LIFT * normals, np.float32), normals)

    @classmethod
    def met(cls, rays: NDArray[np.float32], hits: RayHits) -> Places:
        """Where rays that all met something ended, on the side that they came from."""
        facing = (hits.normals * rays[:, 3:]).sum(axis=1, keepdims=True)
        normals = np.where(facing > 0.0, -hits.normals, hits.normals)
        return cls.on(rays[:, :3] + rays[:, 3:] * hits.distances[:, None], normals)


def primary_rays(
    frame: LocalFrame, camera: PhotoCamera
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Rays (w · h, 6) through the middles of pixels in `picture_order`, and that order."""
    order = picture_order(camera.width, camera.height)
    rows, columns = np.divmod(order, camera.width)
    directions = camera.directions(np.stack([columns + 0.5, rows + 0.5], axis=1))
    eye = np.broadcast_to(frame.local(camera.center[None]), directions.shape)
    return np.hstack([eye, directions.astype(np.float32)]), order


def picture_light(
    caster: RayCaster,
    rays: NDArray[np.float32],
    kind: LightKind,
    options: LightOptions,
    fronts: Fronts | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Linear colours (n, 3) that rays see, and whether (n,) they met anything.

    ``primary`` is lit from the eye, ``shadow`` by the sun, ``ambient`` is the open share of the sky
    alone, ``bounce`` sun and sky with light that other places send on.
    """
    fronts = fronts or Fronts()
    hits = caster.nearest(rays, front=fronts.of["primary"])
    met = np.isfinite(hits.distances)
    seen = np.zeros((len(rays), 3), np.float32)
    places = Places.met(rays[met], _some(hits, met))
    albedo = _albedo(_some(hits, met))
    if kind == "primary":
        along = rays[met, 3:] / np.linalg.norm(rays[met, 3:], axis=1, keepdims=True)
        seen[met] = albedo * np.abs((places.normals * along).sum(axis=1))[:, None]
    elif kind == "shadow":
        seen[met] = albedo * sun_light(caster, places, options, fronts)[:, None]
    elif kind == "ambient":
        seen[met] = open_share(caster, places, options, fronts)[:, None]
    else:
        light = sun_light(caster, places, options, fronts)[:, None]
        seen[met] = albedo * (light + bounced_light(caster, places, options, fronts))
    return seen, met


def sun_light(
    caster: RayCaster, places: Places, options: LightOptions, fronts: Fronts
) -> NDArray[np.float32]:
    """(n,) light of the sun at places, with hard or soft shadows."""
    sun = np.asarray(options.sun, np.float64)
    sun = sun / np.linalg.norm(sun)
    facing = np.maximum(places.normals @ sun, 0.0).astype(np.float32)
    hard = options.sun_radius_deg == 0.0
    wide = np.float32(math.tan(math.radians(options.sun_radius_deg)))
    around = np.broadcast_to(sun.astype(np.float32), places.normals.shape)
    free = np.zeros(len(places.points), np.float32)
    lit = np.flatnonzero(facing > 0.0)
    some = Places(places.points[lit], around[lit])
    for batch, directions in _direction_batches(some, options, 1 if hard else options.samples):
        local = np.concatenate(
            [wide * directions[..., :2], np.ones_like(directions[..., :1])], axis=-1
        )
        blocked = caster.blocked(_cast_rays(some, local), front=fronts.of[f"sun{batch}"])
        free[lit] += (~blocked).reshape(len(local), -1).sum(axis=0)
    return np.asarray(options.sun_light * facing * free / (1 if hard else options.samples))


def open_share(
    caster: RayCaster, places: Places, options: LightOptions, fronts: Fronts
) -> NDArray[np.float32]:
    """(n,) share in [0, 1] of the cosine-weighted hemisphere that is open within the reach."""
    free = np.zeros(len(places.points), np.float32)
    for batch, directions in _direction_batches(places, options, options.samples):
        blocked = caster.blocked(
            _cast_rays(places, directions), options.reach, fronts.of[f"ambient{batch}"]
        )
        free += (~blocked).reshape(len(directions), -1).sum(axis=0)
    return free / np.float32(options.samples)


def bounced_light(
    caster: RayCaster, places: Places, options: LightOptions, fronts: Fronts
) -> NDArray[np.float32]:
    """(n, 3) light of the sky, and of the sun by way of one other place."""
    total = np.zeros((len(places.points), 3), np.float32)
    for batch, directions in _direction_batches(places, options, options.samples):
        rays = _cast_rays(places, directions)
        hits = caster.nearest(rays, front=fronts.of[f"bounce{batch}"])
        met = np.isfinite(hits.distances)
        light = np.full((len(rays), 3), options.sky_light, np.float32)
        there = _some(hits, met)
        sent = sun_light(caster, Places.met(rays[met], there), _one_sample(options), Fronts())
        light[met] = _albedo(there) * sent[:, None]
        total += light.reshape(len(directions), -1, 3).sum(axis=0)
    return total / np.float32(options.samples)


def hemisphere_rays(
    places: Places, options: LightOptions
) -> Iterator[tuple[int, NDArray[np.float32], NDArray[np.float32]]]:
    """Cosine-distributed rays of places, some samples at a time.

    Yields
    ------
    The number of the batch, rays (s · n, 6), sample by sample, and the cosines (s · n,) of their
    directions to the normal.
    """
    for batch, directions in _direction_batches(places, options, options.samples):
        yield batch, _cast_rays(places, directions), directions[..., 2].reshape(-1)


def _direction_batches(
    places: Places, options: LightOptions, samples: int
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Directions (s, n, 3) about +z, cosine-distributed, as many samples as fit one cast.

    Their x and y are uniform on the unit disc, so that a scaled disc serves a light as well.
    """
    count = len(places.points)
    if not count:
        return
    square = qmc.Halton(2, scramble=False).random(samples + 1)[1:]
    turns = np.random.default_rng(options.seed).random(count) / samples
    each = max(1, options.rays_at_once // count)
    for batch, first in enumerate(range(0, samples, each)):
        some = square[first : first + each]
        radius = np.sqrt(some[:, 0])[:, None]
        angle = 2.0 * np.pi * (some[:, 1][:, None] + turns)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        z = np.broadcast_to(np.sqrt(1.0 - some[:, 0])[:, None], x.shape)
        yield batch, np.stack([x, y, z], axis=-1).astype(np.float32)


def _cast_rays(places: Places, directions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rays (s · n, 6) of places along directions (s, n, 3) about their normals."""
    across, beside = _frames(places.normals)
    turned = (directions[..., :1] * across + directions[..., 1:2] * beside) + directions[
        ..., 2:
    ] * places.normals
    start = np.broadcast_to(places.points, turned.shape)
    return np.concatenate([start, turned], axis=-1).reshape(-1, 6).astype(np.float32)


def _frames(normals: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two unit vectors (n, 3) square to each unit normal (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = normals.T
    sign = np.where(z < 0, np.float32(-1), np.float32(1))
    a = -1 / (sign + z)
    b = x * y * a
    across = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return across, np.stack([b, sign + y * y * a, -y], axis=1)


def _one_sample(options: LightOptions) -> LightOptions:
    """Of a bounce: its own samples are many enough without soft shadows at their ends."""
    return LightOptions(
        samples=1, sun=options.sun, sun_light=options.sun_light, rays_at_once=options.rays_at_once
    )


def _some(hits: RayHits, at: NDArray[np.bool_]) -> RayHits:
    colors = None if hits.colors is None else hits.colors[at]
    return RayHits(hits.distances[at], hits.triangles[at], hits.normals[at], colors)


def _albedo(hits: RayHits) -> NDArray[np.float32]:
    """(n, 3) linear colours of what was met."""
    if hits.colors is None:
        return np.full((len(hits.distances), 3), _GREY)
    return np.asarray(LINEAR_OF_BYTE[hits.colors], np.float32)
