"""Scans of bodies given by formulas, with true and coarse poses, for stiff registration cases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.orientedscan import OrientationSettings, OrientedScan, orient
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import Matrix4, apply, from_twist, inverse, rotate

# Size of the bodies and noise of the samples along the normal, metres.
RADIUS_M, SIGMA_M = 0.3, 0.0005

Radius = Callable[[NDArray[np.float64]], NDArray[np.float64]]
Height = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Scanned:
    """Scans of one body.

    Attributes
    ----------
    scans : each in a frame of its own.
    true, coarse : world_from_scan per scan.
    viewpoints : (3,) of the scanner in each scan's frame.
    """

    scans: tuple[OrientedScan, ...]
    true: tuple[Matrix4, ...]
    coarse: tuple[Matrix4, ...]
    viewpoints: tuple[NDArray[np.float64], ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"scan_{k}" for k in range(len(self.scans)))

    @property
    def spacing_m(self) -> float:
        """Median distance of neighbouring samples."""
        return float(np.median(np.concatenate([scan.spacing_m for scan in self.scans])))

    def scaled(self, factor: float) -> Scanned:
        """The same in another unit."""
        lengths = ("points", "spacing_m", "reach_m", "roughness_m")
        return Scanned(
            tuple(
                replace(scan, **{name: factor * getattr(scan, name) for name in lengths})
                for scan in self.scans
            ),
            tuple(_scaled(pose, factor) for pose in self.true),
            tuple(_scaled(pose, factor) for pose in self.coarse),
            tuple(factor * view for view in self.viewpoints),
        )

    def moved(self, shift: NDArray[np.float64]) -> Scanned:
        """The same at another place in the world."""
        there = from_twist([0.0, 0.0, 0.0, *shift])
        return replace(
            self,
            true=tuple(there @ pose for pose in self.true),
            coarse=tuple(there @ pose for pose in self.coarse),
        )

    def center_errors_m(self, poses: tuple[Matrix4, ...], anchor: int) -> NDArray[np.float64]:
        """(n, 3) shift of every scan's middle, in the frame in which the anchor is true."""
        true_from_found = self.true[anchor] @ inverse(poses[anchor])
        middles = [scan.points.mean(axis=0) for scan in self.scans]
        return np.array(
            [
                apply(true_from_found @ pose, middle) - apply(true, middle)
                for pose, true, middle in zip(poses, self.true, middles, strict=True)
            ]
        )


def lumpy(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius of a smooth body without symmetry in unit directions (..., 3)."""
    x, y, z = np.moveaxis(direction, -1, 0)
    bumps = 0.2 * x + 0.15 * np.sin(4 * y + 1) + 0.12 * np.cos(5 * z) * x + 0.1 * y * z
    return np.asarray(RADIUS_M * (1 + bumps))


def ball(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius of a sphere in unit directions (..., 3)."""
    return np.full(direction.shape[:-1], RADIUS_M)


def body_scans(
    radius_of: Radius = lumpy, views: int = 5, side: int = 40, sigma_m: float = SIGMA_M
) -> Scanned:
    """A star-shaped body seen from ``views`` sides on a ring, ``side``² samples each."""
    rng, poses = np.random.default_rng(0), np.random.default_rng(99)
    tangent = np.linspace(-1.4, 1.4, side)
    parts = []
    for k in range(views):
        turn = from_twist([0.0, 2 * np.pi * k / views, 0.0, 0.0, 0.0, 0.0])
        u, v = np.meshgrid(*(tangent + rng.uniform(-0.5, 0.5) * (tangent[1] - tangent[0]),) * 2)
        direction = np.stack([u, v, np.ones_like(u)], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        seen = rotate(turn, direction)
        distance = radius_of(seen) + sigma_m * rng.standard_normal(u.shape)
        parts.append((seen * distance[..., None], rotate(turn, [0.0, 0.0, 5.0])))
    return _scanned(parts, poses, 0.006)


def wavy(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of a relief without repetition, metres."""
    return np.asarray(
        0.02 * np.sin(11 * x + 1) * np.cos(9 * y) + 0.015 * np.sin(5 * x * y + 17 * y + 2 * x)
    )


def sheet_scans(
    height: Height,
    starts: tuple[float, ...] = (0.0, 0.0, 0.0),
    side: int = 50,
    sigma_m: float = SIGMA_M,
    from_below: tuple[bool, ...] = (),
    coarse_m: float = 0.004,
) -> Scanned:
    """A sheet over the plane seen from above, one metre square from each of ``starts`` along x.

    Scans for which ``from_below`` holds see its other side.
    """
    rng, poses = np.random.default_rng(0), np.random.default_rng(98)
    ways = np.linspace(-0.5, 0.5, side)
    below = from_below or (False,) * len(starts)
    parts = []
    for start, under in zip(starts, below, strict=True):
        x, y = np.meshgrid(start + ways + rng.uniform(0, 1 / side), ways + rng.uniform(0, 1 / side))
        z = height(x, y) + sigma_m * rng.standard_normal(x.shape)
        parts.append((np.stack([x, y, z], axis=-1), np.array([start, 0.0, -3.0 if under else 3.0])))
    return _scanned(parts, poses, coarse_m)


def cylinder_scans(views: int = 5, side: int = 40, sigma_m: float = SIGMA_M) -> Scanned:
    """A cylinder about z, one metre high, seen from a ring."""
    rng, poses = np.random.default_rng(0), np.random.default_rng(97)
    parts = []
    for k in range(views):
        middle = 2 * np.pi * k / views
        angle, z = np.meshgrid(
            middle + np.linspace(-1.1, 1.1, side) + rng.uniform(0, 2.2 / side),
            np.linspace(-0.5, 0.5, side) + rng.uniform(0, 1 / side),
        )
        radius = RADIUS_M + sigma_m * rng.standard_normal(angle.shape)
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)
        parts.append((points, np.array([4 * np.cos(middle), 4 * np.sin(middle), 0.0])))
    return _scanned(parts, poses, 0.004)


def _scanned(
    parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
    rng: np.random.Generator,
    coarse_m: float,
) -> Scanned:
    """Grids of points in the world and viewpoints, each brought into a frame of its own."""
    scans, true, coarse, viewpoints = [], [], [], []
    for k, (points, viewpoint) in enumerate(parts):
        pose = from_twist([*0.5 * rng.standard_normal(3), *rng.standard_normal(3)])
        error = from_twist([*coarse_m / RADIUS_M * rng.standard_normal(3), 0.0, 0.0, 0.0])
        error[:3, 3] = coarse_m * rng.standard_normal(3)
        view = inverse(pose)
        rows, columns = points.shape[:2]
        grid = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        own = apply(view, points.reshape(-1, 3))
        map_ = RangeMap(f"scan_{k}", own, grid, apply(view, viewpoint))
        scans.append(orient(map_, OrientationSettings()))
        true.append(pose)
        coarse.append(error @ pose)
        viewpoints.append(apply(view, viewpoint))
    return Scanned(tuple(scans), tuple(true), tuple(coarse), tuple(viewpoints))


def _scaled(pose: Matrix4, factor: float) -> Matrix4:
    scaled = pose.copy()
    scaled[:3, 3] *= factor
    return scaled
