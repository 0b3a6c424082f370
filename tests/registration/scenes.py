"""Scanned scenes with known poses, small enough to adjust in a fraction of a second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.geometry.orientedscan import OrientationSettings, OrientedScan, orient
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import Matrix4, apply, from_twist, inverse, rotate
from workbench.synthetic import SimulationOptions, simulate_scans

SIGMA = 0.0005
RADIUS = 0.3


@dataclass(frozen=True)
class Case:
    """Scans, their true and their coarse poses, and the noise of the samples."""

    scans: list[OrientedScan]
    true: list[Matrix4]
    coarse: list[Matrix4]
    sigma: float

    @property
    def names(self) -> list[str]:
        return [f"scan_{k:02d}" for k in range(len(self.scans))]

    @property
    def spacing(self) -> float:
        return float(np.median(np.concatenate([s.spacing_m for s in self.scans])))


def simulated(scene: str, scans: int, grid: int, coarse: dict[str, float] | None = None) -> Case:
    """A simulated scene without strays; the noise is 0.2 mm at 1 m."""
    options = SimulationOptions(
        scene=scene,
        seed=1,
        scans=scans,
        scanner={"rows": grid, "cols": grid, "stray_probability": 0.0},
        coarse_poses=coarse or {},
    )
    made = list(simulate_scans(options))
    return Case(
        [orient(s.range_map, OrientationSettings()) for s in made],
        [s.world_from_scan for s in made],
        [s.range_map.world_from_scan for s in made],
        0.0002,
    )


def potato(direction: np.ndarray) -> np.ndarray:
    """Radius of a closed smooth body without symmetry, in a unit direction (..., 3)."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return RADIUS * (
        1 + 0.2 * x + 0.15 * np.sin(4 * y + 1) + 0.12 * np.cos(5 * z) * x + 0.1 * y * z
    )


def body_scans(
    views: int,
    sigma: float = SIGMA,
    seed: int = 0,
    n: int = 60,
    coarse_m: float = 0.006,
    radius_of: Callable[[np.ndarray], np.ndarray] = potato,
) -> Case:
    """Patches of a star-shaped body from ``views`` sides on a ring, noise along the normal."""
    rng, pose_rng = np.random.default_rng(seed), np.random.default_rng(99)
    scans, true, coarse = [], [], []
    tangent = np.linspace(-1.4, 1.4, n)
    for k in range(views):
        turn = from_twist([0, 2 * np.pi * k / views, 0, 0, 0, 0])
        jitter = rng.uniform(-0.5, 0.5, 2) * (tangent[1] - tangent[0])
        u, v = np.meshgrid(tangent + jitter[0], tangent + jitter[1])
        direction = np.stack([u, v, np.ones_like(u)], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        world = rotate(turn, direction)
        distance = radius_of(world) + rng.normal(scale=sigma, size=u.shape) if sigma else (
            radius_of(world)
        )  # fmt: skip
        pose = from_twist([*pose_rng.normal(size=3) * 0.5, *pose_rng.normal(size=3)])
        view = inverse(pose)
        points = apply(view, world * distance[..., None]).reshape(-1, 3)
        viewpoint = apply(view, rotate(turn, [0, 0, 5.0]))
        grid = np.arange(n * n, dtype=np.int32).reshape(n, n)
        scans.append(orient(RangeMap(f"scan_{k}", points, grid, viewpoint), OrientationSettings()))
        true.append(pose)
        size = coarse_m / RADIUS
        error = from_twist([*pose_rng.normal(size=3) * size, *pose_rng.normal(size=3) * coarse_m])
        coarse.append(error @ pose)
    return Case(scans, true, coarse, sigma)


def round_ball(direction: np.ndarray) -> np.ndarray:
    return np.full(direction.shape[:-1], RADIUS)


def scaled(case: Case, factor: float) -> Case:
    """The same problem in other units."""

    def pose(matrix: Matrix4) -> Matrix4:
        result = matrix.copy()
        result[:3, 3] *= factor
        return result

    lengths = ("points", "spacing_m", "reach_m", "roughness_m")
    return Case(
        [replace(s, **{name: getattr(s, name) * factor for name in lengths}) for s in case.scans],
        [pose(p) for p in case.true],
        [pose(p) for p in case.coarse],
        case.sigma * factor,
    )


def errors(case: Case, poses: tuple[Matrix4, ...], anchor: int) -> np.ndarray:
    """(n, 6) rotation vector and shift of every scan's centre, the anchor's frame being true."""
    found = []
    for k, scan in enumerate(case.scans):
        expected = poses[anchor] @ inverse(case.true[anchor]) @ case.true[k]
        centre = scan.points.mean(axis=0)
        turn = Rotation.from_matrix(poses[k][:3, :3] @ expected[:3, :3].T).as_rotvec()
        found.append([*turn, *(apply(poses[k], centre) - apply(expected, centre))])
    return np.array(found)
