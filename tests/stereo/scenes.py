"""Textured bodies of known shape as pinhole cameras at known places show them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import inverse, looking_at
from workbench.stereo.views import StereoView

Points = NDArray[np.float64]
# Depth along unit-depth rays (n, 3) from a centre (3,), infinite where nothing is met.
Body = Callable[[Points, Points], Points]


def plane(center: Points, rays: Points) -> Points:
    """The tilted plane z = 0.3 x."""
    normal = np.array([-0.3, 0.0, 1.0])
    with np.errstate(divide="ignore"):
        depth = -(normal @ center) / (rays @ normal)
    return np.where(depth > 0.0, depth, np.inf)


def ball(center: Points, rays: Points) -> Points:
    """The unit ball around the origin."""
    a, b = (rays**2).sum(axis=1), rays @ center
    root = b**2 - a * (center @ center - 1.0)
    with np.errstate(invalid="ignore"):
        return np.where(root > 0.0, (-b - np.sqrt(root)) / a, np.inf)


def paint(points: Points, finest: float = 0.12) -> Points:
    """Grey levels of a solid texture of many wavelengths, none finer than ``finest``."""
    rng = np.random.default_rng(5)
    grey = np.full(len(points), 128.0)
    for _ in range(60):
        way = rng.normal(size=3)
        length = finest * 4.0 ** rng.uniform()
        way *= 2.0 * np.pi / (length * np.linalg.norm(way))
        grey += 11.0 * np.sin(points @ way + rng.uniform(0.0, 2.0 * np.pi))
    return grey


def seen(
    body: Body,
    position: tuple[float, float, float],
    size: tuple[int, int] = (140, 130),
    focal: float = 200.0,
    grey_of: Callable[[Points], Points] = paint,
    noise: float = 0.0,
) -> tuple[StereoView, Points]:
    """A view of a body from a place towards the origin, and its true depths (h, w)."""
    width, height = size
    lens = np.array([focal, focal, 0.5 * (width - 1), 0.5 * (height - 1)])
    camera_from_world = inverse(looking_at(position, (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0)))
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    slopes = np.stack([(columns - lens[2]) / lens[0], (rows - lens[3]) / lens[1]], axis=-1)
    rays = np.concatenate([slopes, np.ones((height, width, 1))], axis=2).reshape(-1, 3)
    rays = rays @ camera_from_world[:3, :3]
    depth = body(np.array(position), rays)
    met = np.isfinite(depth)
    grey = np.full(len(depth), 20.0)
    grey[met] = grey_of(np.array(position) + rays[met] * depth[met, None])
    grey += noise * np.random.default_rng(int(1000 * abs(position[0]))).normal(size=len(grey))
    shape = (height, width)
    view = StereoView(
        lens, camera_from_world, grey.reshape(shape).astype(np.float32), met.reshape(shape)
    )
    return view, depth.reshape(shape)
