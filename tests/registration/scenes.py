"""Scanned scenes with known poses, small enough to adjust in a fraction of a second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.geometry.orientedscan import OrientationSettings, OrientedScan, orient
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import (
    Matrix4,
    apply,
    from_twist,
    inverse,
    rigid,
    rotate,
    rotation_angle_deg,
)
from workbench.synthetic import SimulationOptions, simulate_scans

SIGMA = 0.0005
RADIUS = 0.3


@dataclass(frozen=True)
class Case:
    """Scans, their true and their coarse poses, the noise of the samples, the scanner's places."""

    scans: list[OrientedScan]
    true: list[Matrix4]
    coarse: list[Matrix4]
    sigma: float
    viewpoints: list[np.ndarray | None] = field(default_factory=list)

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
        [s.range_map.viewpoint_in_scan for s in made],
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
    scans, true, coarse, viewpoints = [], [], [], []
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
        viewpoints.append(viewpoint)
        size = coarse_m / RADIUS
        error = from_twist([*pose_rng.normal(size=3) * size, *pose_rng.normal(size=3) * coarse_m])
        coarse.append(error @ pose)
    return Case(scans, true, coarse, sigma, viewpoints)


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


BAY = 1.0


def facade(bays: int, ornaments: float, seed: int = 0, n: int = 110) -> Case:
    """A wall of identical windows, one scan per bay, each three bays wide, poses lost.

    ``ornaments`` is the height in metres of the few things that are not the same in all bays.
    """
    rng = np.random.default_rng(seed)
    places = np.stack([rng.uniform(-1, bays, 3 * bays), rng.uniform(0.1, 1.9, 3 * bays)], axis=1)

    def relief(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along, up = (x / BAY) % 1.0 - 0.5, y - 1.0
        window = 1 / (1 + np.exp(((along / 0.28) ** 4 + (up / 0.55) ** 4 - 1) * 6))
        sill = np.exp(-((up + 0.62) ** 2) / 0.002) / (1 + np.exp((np.abs(along) - 0.34) * 60))
        bumps = np.zeros_like(x)
        for px, py in places:
            bumps += np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 0.07**2))
        return -0.2 * window + 0.08 * sill + ornaments * bumps

    scans, true, viewpoints = [], [], []
    for k in range(bays):
        x, y = np.meshgrid(
            k * BAY + np.linspace(-1.5, 1.5, n) + rng.uniform(0, 3 / n),
            np.linspace(0, 2, n) + rng.uniform(0, 2 / n),
        )
        z = relief(x, y) + rng.normal(scale=0.002, size=x.shape)
        pose = from_twist([*rng.normal(size=3), *rng.normal(size=3)])
        view = inverse(pose)
        points = apply(view, np.stack([x, y, z], axis=-1).reshape(-1, 3))
        viewpoint = apply(view, [k * BAY, 1.0, 6.0])
        grid = np.arange(n * n, dtype=np.int32).reshape(n, n)
        scans.append(orient(RangeMap(f"scan_{k}", points, grid, viewpoint), OrientationSettings()))
        true.append(pose)
        viewpoints.append(viewpoint)
    return Case(scans, true, true, 0.002, viewpoints)


def moved_at_random(case: Case, seed: int) -> Case:
    """Every scan in another frame of its own, and their order shuffled."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(case.scans))
    scans, true, viewpoints = [], [], []
    for k in order:
        move = rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        scan, viewpoint = case.scans[k], case.viewpoints[k]
        points, normals = apply(move, scan.points), rotate(move, scan.normals)
        scans.append(replace(scan, points=points, normals=normals))
        true.append(case.true[k] @ inverse(move))
        viewpoints.append(None if viewpoint is None else apply(move, viewpoint))
    return Case(scans, true, true, case.sigma, viewpoints)


def pair_errors(case: Case, poses: Sequence[Matrix4]) -> tuple[np.ndarray, np.ndarray]:
    """Degrees and metres of all relative poses, the latter at the middle of the scan moved."""
    turned, shifted = [], []
    for i, j in combinations(range(len(poses)), 2):
        found, expected = (inverse(p[i]) @ p[j] for p in (poses, case.true))
        centre = case.scans[j].points.mean(axis=0)
        turned.append(rotation_angle_deg(inverse(expected) @ found))
        shifted.append(np.linalg.norm(apply(found, centre) - apply(expected, centre)))
    return np.array(turned), np.array(shifted)
