"""Meshes and rays for these tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.raytracing.ray_tiles import picture_order


def sheet(
    cells: int, *, height: float = 0.1, at: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> TriangleMesh:
    """A wavy square of side 1 over the x-y plane."""
    x, y = np.meshgrid(*2 * [np.linspace(-0.5, 0.5, cells + 1)])
    z = height * (np.sin(9.0 * x) * np.cos(7.0 * y) + 0.1 * np.sin(90.0 * x + 50.0 * y))
    first = np.arange(cells * (cells + 1)).reshape(cells, -1)[:, :-1].ravel()
    lower = np.stack([first, first + 1, first + cells + 1], axis=1)
    upper = np.stack([first + 1, first + cells + 2, first + cells + 1], axis=1)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) + at
    return TriangleMesh(vertices, np.concatenate([lower, upper]).astype(np.int32))


def soup(count: int, seed: int) -> TriangleMesh:
    """Small triangles anywhere in a cube of side 2."""
    random = np.random.default_rng(seed)
    middles = random.uniform(-1.0, 1.0, (count, 1, 3))
    vertices = (middles + random.normal(0.0, 0.05, (count, 3, 3))).reshape(-1, 3)
    return TriangleMesh(vertices, np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


def stacked(sheets: int, cells: int) -> TriangleMesh:
    """Sheets above one another: from above only the first is seen."""
    parts = [sheet(cells, height=0.02, at=(0.0, 0.0, -0.2 * k)) for k in range(sheets)]
    count = len(parts[0].vertices)
    return TriangleMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + k * count for k, part in enumerate(parts)]),
    )


def view(
    side: int, eye: tuple[float, float, float], *, seed: int = 0, opening: float = 0.6
) -> NDArray[np.float32]:
    """Rays (side², 6) of a local picture towards the origin, a little off their raster."""
    place = np.array(eye)
    forward = -place / np.linalg.norm(place)
    across = np.cross(forward, (0.3, 0.2, 1.0))
    across /= np.linalg.norm(across)
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-opening, opening, side)]), axis=-1)
    grid = grid.reshape(-1, 2) + np.random.default_rng(seed).uniform(-1e-3, 1e-3, (side**2, 2))
    directions = forward + grid[:, :1] * across + grid[:, 1:] * np.cross(forward, across)
    rays = np.hstack([np.broadcast_to(place, directions.shape), directions]).astype(np.float32)
    return rays[picture_order(side, side)]
