"""A classical building of about 30 × 20 × 12 m with its ground, lamp posts and a scaffold."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.geometry.mesh import TriangleMesh
from workbench.synthetic import solids
from workbench.synthetic.scene import OBJECT, SUPPORT, painted

LENGTH_M, DEPTH_M, WALL_HEIGHT_M = 30.0, 20.0, 9.0
_PLINTH_M = 1.0
_CLADDING_M = 0.45
_COURSE_M = 0.5
_STONE_M = 1.0
_WINDOW = (1.5, 2.4)
_DOOR = (2.4, 4.2)
# Stones overlap by this much so that no ray slips between them.
_LAP_M = 0.02


def building_mesh(rng: np.random.Generator) -> TriangleMesh:
    """Walls of single stones with window recesses, portico, cornice and roof; its ground.

    Parameters
    ----------
    rng : decides how far each stone stands out and how bright it is.

    Returns
    -------
    Overlapping closed bodies in local coordinates: x along the façade, the front at
    y = −10 m faces −y, the ground at z = 0. Ground, lamp posts and scaffold count as support.
    """
    stone = [*_walls(rng), *_cornice(), *_portico(), *_roof()]
    shade = rng.uniform(0.42, 0.68, len(stone))
    bodies = [painted(part, OBJECT, value) for part, value in zip(stone, shade, strict=True)]
    bodies.append(painted(_ground(rng), SUPPORT, np.array([0.22])))
    bodies.extend(painted(part, SUPPORT, np.array([0.1])) for part in _street_furniture())
    return solids.collected(bodies)


def round_the_walls(
    share: float, corner_m: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A foot (2,) on the outline, and the way (2,) out from it, of a path round the building.

    Parameters
    ----------
    share : of the way round, from the left end of the front; whole rounds do not count.
    corner_m : metres of the way that are spent at each corner, turning round it.
    """
    half = np.array([0.5 * LENGTH_M, 0.5 * DEPTH_M])
    sides = np.array([LENGTH_M, DEPTH_M, LENGTH_M, DEPTH_M])
    ends = np.cumsum(sides + corner_m)
    along = (share % 1.0) * ends[-1]
    side = int(np.searchsorted(ends, along, side="right")) % 4
    step = along - np.concatenate([[0.0], ends])[side]
    corners = np.array([[-half[0], -half[1]], [half[0], -half[1]], half, [-half[0], half[1]]])
    heading = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])[side]
    outward = np.array([heading[1], -heading[0]])
    if step <= sides[side]:
        return corners[side] + step * heading, outward
    bend = 0.5 * np.pi * (step - sides[side]) / corner_m
    return corners[side] + sides[side] * heading, np.cos(bend) * outward + np.sin(bend) * heading


def _walls(rng: np.random.Generator) -> list[TriangleMesh]:
    """The core and, on each of the four sides, its cladding of stones."""
    inset = _CLADDING_M
    half_x, half_y = 0.5 * LENGTH_M, 0.5 * DEPTH_M
    parts = [solids.box((-half_x + inset, -half_y + inset, 0.0),
                        (half_x - inset, half_y - inset, WALL_HEIGHT_M))]  # fmt: skip
    for turn, width, distance in (
        (0.0, LENGTH_M, half_y), (90.0, DEPTH_M, half_x), (180.0, LENGTH_M, half_y),
        (270.0, DEPTH_M, half_x),
    ):  # fmt: skip
        angle = np.radians(turn)
        rotation = [
            [np.cos(angle), -np.sin(angle), 0],
            [np.sin(angle), np.cos(angle), 0],
            [0, 0, 1],
        ]
        local_from_side = transforms.rigid(rotation, [0.0, 0.0, 0.0])
        openings = _openings(width, with_door=turn == 0.0)
        side = [*_stones(width, distance, openings, rng), *_windows(distance, openings)]
        parts.extend(solids.moved(part, local_from_side) for part in side)
    return parts


def _openings(width: float, *, with_door: bool) -> list[tuple[float, float, float, float]]:
    """Left, right, bottom and top of the openings in a wall, in stone courses."""
    places = np.arange(-0.5 * width + 2.5, 0.5 * width - 1.0, 3.5)
    openings = []
    for floor in (1.5, 5.5):
        for left in np.round(places / 0.5) * 0.5:
            if with_door and floor < 2.0 and abs(left + 0.5 * _WINDOW[0]) < 2.6:
                continue
            openings.append((left, left + _WINDOW[0], floor, floor + 2.5))
    if with_door:
        openings.append((-0.5 * _DOOR[0], 0.5 * _DOOR[0], 0.0, 4.0))
    return openings


def _stones(
    width: float,
    distance: float,
    openings: list[tuple[float, float, float, float]],
    rng: np.random.Generator,
) -> list[TriangleMesh]:
    """Courses of ashlar, each stone standing out a little differently; openings are spared."""
    stones = []
    for course in range(int(WALL_HEIGHT_M / _COURSE_M)):
        low, high = course * _COURSE_M, (course + 1) * _COURSE_M
        joints = np.arange(-0.5 * width, 0.5 * width + 1e-9, _STONE_M) + 0.5 * _STONE_M * (
            course % 2
        )
        spared = [(o[0], o[1]) for o in openings if o[2] < high - 1e-9 and o[3] > low + 1e-9]
        edges = np.unique(np.clip(np.append(joints, [-0.5 * width, *sum(spared, ())]),
                                  -0.5 * width, 0.5 * width))  # fmt: skip
        for left, right in pairwise(edges):
            middle = 0.5 * (left + right)
            if any(a < middle < b for a, b in spared):
                continue
            rustic = 0.03 if low < _PLINTH_M + 1e-9 else 0.008
            front = -distance - (0.12 if low < _PLINTH_M - 1e-9 else 0.0)
            front -= abs(rng.normal(0.0, rustic))
            jambs = [edge for opening in spared for edge in opening]
            lap = [0.0 if np.isclose(jambs, x).any() else _LAP_M for x in (left, right)]
            stones.append(
                solids.box(
                    (left - lap[0], front, low), (right + lap[1], 0.6 - distance, high + 1e-3)
                )
            )
    return stones


def _windows(
    distance: float, openings: list[tuple[float, float, float, float]]
) -> list[TriangleMesh]:
    """Sills, hoods and glazing bars of every opening."""
    parts = []
    for left, right, low, high in openings:
        y = -distance
        parts.append(solids.box((left - 0.15, y - 0.14, low - 0.1), (right + 0.15, y + 0.3, low)))
        parts.append(
            solids.box((left - 0.25, y - 0.22, high), (right + 0.25, y + 0.3, high + 0.18))
        )
        middle = 0.5 * (left + right)
        for x in (left + 0.04, middle, right - 0.04):
            parts.append(solids.box((x - 0.04, y + 0.22, low), (x + 0.04, y + 0.3, high)))
        for z in np.linspace(low + 0.04, high - 0.04, 4):
            parts.append(solids.box((left, y + 0.22, z - 0.035), (right, y + 0.3, z + 0.035)))
    return parts


def _cornice() -> list[TriangleMesh]:
    """Stepped cornice round the building with dentils below it."""
    parts = []
    half_x, half_y = 0.5 * LENGTH_M, 0.5 * DEPTH_M
    for step, (out, low, high) in enumerate(
        ((0.15, 8.55, 8.75), (0.40, 8.75, 8.95), (0.60, 8.95, 9.20))
    ):
        reach = out + 0.001 * step
        parts.append(solids.box((-half_x - reach, -half_y - reach, low),
                                (half_x + reach, half_y + reach, high)))  # fmt: skip
    for x in np.arange(-half_x, half_x, 0.5):
        for y in (-half_y - 0.34, half_y + 0.10):
            parts.append(solids.box((x, y, 8.50), (x + 0.24, y + 0.24, 8.76)))
    for y in np.arange(-half_y, half_y, 0.5):
        for x in (-half_x - 0.34, half_x + 0.10):
            parts.append(solids.box((x, y, 8.50), (x + 0.24, y + 0.24, 8.76)))
    return parts


def _portico() -> list[TriangleMesh]:
    """Steps, four fluted columns with bases and capitals, architrave and pediment."""
    front = -0.5 * DEPTH_M
    parts = [
        solids.box(
            (-6.0 - 0.35 * n, front - 3.6 - 0.35 * n, 0.0), (6.0 + 0.35 * n, front, 0.64 - 0.16 * n)
        )
        for n in range(4)
    ]
    height = np.linspace(0.0, 1.0, 24)
    shaft = np.column_stack([0.42 - 0.07 * height**1.6, 1.0 + 5.2 * height])
    base = np.array(
        [[0.56, 0.62], [0.58, 0.70], [0.56, 0.80], [0.48, 0.86], [0.50, 0.95], [0.44, 1.02]]
    )
    capital = np.array([[0.36, 6.15], [0.42, 6.24], [0.40, 6.30], [0.56, 6.48], [0.58, 6.52]])
    for x in (-4.8, -1.6, 1.6, 4.8):
        place = transforms.rigid(np.eye(3), [x, front - 2.9, 0.0])
        parts.append(solids.moved(solids.lathed(shaft, 160, (20, 0.09)), place))
        parts.append(solids.moved(solids.lathed(base, 64), place))
        parts.append(solids.moved(solids.lathed(capital, 64), place))
        parts.append(solids.box((x - 0.62, front - 3.52, 6.5), (x + 0.62, front - 2.28, 6.68)))
    parts.append(solids.box((-5.6, front - 3.5, 6.66), (5.6, front + 0.3, 7.4)))
    parts.append(solids.box((-5.9, front - 3.8, 7.39), (5.9, front + 0.3, 7.6)))
    gable = [(-5.9, 7.59), (5.9, 7.59), (0.0, 9.4)]
    parts.append(solids.prism(gable, front - 3.6, front + 0.3))
    for sign in (-1.0, 1.0):
        rake = [(sign * 6.1, 7.55), (0.0, 9.40), (0.0, 9.65), (sign * 6.1, 7.80)]
        parts.append(solids.prism(rake if sign < 0 else rake[::-1], front - 3.85, front + 0.3))
    return parts


def _roof() -> list[TriangleMesh]:
    """A gabled roof over the whole length and two chimneys."""
    half = 0.5 * DEPTH_M + 0.4
    slope = solids.prism([(-half, 9.19), (half, 9.19), (0.0, 12.0)], -15.3, 15.3)
    quarter = transforms.rigid([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.0, 0.0, 0.0])
    chimneys = [solids.box((x - 0.6, 2.0, 9.3), (x + 0.6, 3.2, 12.6)) for x in (-8.0, 8.0)]
    return [solids.moved(slope, quarter), *chimneys]


def _ground(rng: np.random.Generator) -> TriangleMesh:
    """A slab of gently uneven ground with its surface about z = 0."""
    x, y = np.linspace(-45.0, 45.0, 181), np.linspace(-40.0, 40.0, 161)
    phase = rng.uniform(0, 2 * np.pi, 4)
    height = 0.05 * np.sin(0.31 * x[:, None] + phase[0]) * np.sin(0.27 * y[None] + phase[1])
    height = height + 0.015 * np.sin(1.9 * x[:, None] + phase[2]) * np.sin(2.3 * y[None] + phase[3])
    return solids.height_field_slab(x, y, height - 0.25, 0.4)


def _street_furniture() -> list[TriangleMesh]:
    """Lamp posts before the front and a scaffold at one corner: they hide parts of the walls."""
    front = -0.5 * DEPTH_M
    parts = []
    for x in (-11.0, 0.8, 11.5):
        parts.append(solids.tube([(x, front - 6.0, -0.3), (x, front - 6.0, 4.5)], 0.07))
        parts.append(solids.geodesic_sphere((x, front - 6.0, 4.7), 0.25, 3))
    for x in np.arange(8.0, 15.1, 2.3):
        for y in (front - 0.9, front - 1.9):
            parts.append(solids.tube([(x, y, -0.3), (x, y, 8.2)], 0.025, 10))
    for z in (2.0, 4.0, 6.0, 8.0):
        for y in (front - 0.9, front - 1.9):
            parts.append(solids.tube([(7.7, y, z), (15.2, y, z)], 0.025, 10))
        parts.append(solids.box((8.0, front - 1.85, z - 0.09), (14.9, front - 0.95, z - 0.05)))
    return parts
