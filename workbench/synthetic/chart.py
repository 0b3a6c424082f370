"""Calibration targets: the ColorChecker with its published colours, and an even white one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import looking_at
from workbench.synthetic.albedo import SurfacePaint
from workbench.synthetic.scene import painted
from workbench.synthetic.subject import Subject

TARGET = 3
ROWS, COLS = 4, 6
PATCH_NAMES = (
    *("dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green"),
    *("orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow"),
    *("blue", "green", "red", "yellow", "magenta", "cyan"),
    *("white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2"),
)
# X-Rite's data for charts made after November 2014 (CIE xyY, D50, as colour-science gives
# them), adapted to D65 by Bradford's transform. Cyan lies outside Rec. 709.
PATCH_ALBEDO = np.array(
    [
        (0.17368, 0.07879, 0.05286),
        (0.55978, 0.27745, 0.21089),
        (0.10420, 0.18892, 0.32893),
        (0.10574, 0.15075, 0.05084),
        (0.22744, 0.21241, 0.42645),
        (0.11529, 0.50744, 0.41113),
        (0.74590, 0.20214, 0.02987),
        (0.05874, 0.10118, 0.38775),
        (0.56013, 0.08015, 0.11459),
        (0.10917, 0.04200, 0.13814),
        (0.33275, 0.49739, 0.04260),
        (0.77104, 0.35792, 0.02045),
        (0.02096, 0.04753, 0.28413),
        (0.04606, 0.29205, 0.06148),
        (0.44617, 0.03641, 0.04055),
        (0.84168, 0.57441, 0.00466),
        (0.52234, 0.07782, 0.28931),
        (-0.04392, 0.23366, 0.37719),
        (0.87953, 0.88503, 0.83425),
        (0.58449, 0.59217, 0.58448),
        (0.35769, 0.36708, 0.36527),
        (0.19009, 0.19087, 0.18981),
        (0.08593, 0.08874, 0.08980),
        (0.03135, 0.03150, 0.03232),
    ]
)
"""(24, 3) linear Rec. 709 reflectance, row by row from the upper left."""

_PITCH_M, _PATCH_M = 0.0430, 0.0380
_BOARD_M = (0.2794, 0.2032)
_FRAME_ALBEDO = 0.030


@dataclass(frozen=True)
class ChartPaint:
    """The ColorChecker on the plane z = 0: x to the right, y up, its middle at the origin."""

    def at(self, points: NDArray[np.float64], material: NDArray[np.uint8]) -> SurfacePaint:
        """See `Paint.at`."""
        col = np.floor(points[:, 0] / _PITCH_M + 0.5 * COLS).astype(np.int64)
        row = np.floor(0.5 * ROWS - points[:, 1] / _PITCH_M).astype(np.int64)
        right = points[:, 0] - (col + 0.5 - 0.5 * COLS) * _PITCH_M
        up = points[:, 1] - (0.5 * ROWS - 0.5 - row) * _PITCH_M
        inside = (np.maximum(np.abs(right), np.abs(up)) <= 0.5 * _PATCH_M) & (
            (col >= 0) & (col < COLS) & (row >= 0) & (row < ROWS)
        )
        albedo = np.full((len(points), 3), _FRAME_ALBEDO, np.float32)
        albedo[inside] = PATCH_ALBEDO[row[inside] * COLS + col[inside]]
        return _matt(albedo)


@dataclass(frozen=True)
class EvenPaint:
    """The same reflectance everywhere and in all channels."""

    reflectance: float

    def at(self, points: NDArray[np.float64], material: NDArray[np.uint8]) -> SurfacePaint:
        """See `Paint.at`."""
        return _matt(np.full((len(points), 3), self.reflectance, np.float32))


def chart_subject() -> Subject:
    """A ColorChecker in the air."""
    return Subject(_board(*_BOARD_M), ChartPaint())


def white_subject(reflectance: float, size_m: float) -> Subject:
    """An even square target on the plane z = 0."""
    return Subject(_board(size_m, size_m), EvenPaint(reflectance))


def patch_corners() -> NDArray[np.float64]:
    """Corners (24, 4, 3) of the patches, metres, clockwise from the upper left one."""
    corners = 0.5 * _PATCH_M * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    middle = [
        [(col + 0.5 - 0.5 * COLS) * _PITCH_M, (0.5 * ROWS - 0.5 - row) * _PITCH_M, 0.0]
        for row in range(ROWS)
        for col in range(COLS)
    ]
    return np.array(middle)[:, None, :] + corners


def board_corners() -> NDArray[np.float64]:
    """Corners (4, 3) of the whole chart, metres, clockwise from the upper left one."""
    x, y = 0.5 * _BOARD_M[0], 0.5 * _BOARD_M[1]
    return np.array([[-x, y, 0.0], [x, y, 0.0], [x, -y, 0.0], [-x, -y, 0.0]])


def facing_pose(
    distance_m: float, tilt_deg: float, turn_deg: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """4×4 camera pose before a target on z = 0.

    Parameters
    ----------
    distance_m : to the target's middle.
    tilt_deg : between the view and the target's normal.
    turn_deg : direction of the tilt about the normal.
    rng : a little roll and aim, as in the hand; drawn only for a tilted target.
    """
    tilt, turn = np.radians([tilt_deg, turn_deg])
    way = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    aim, roll = np.zeros(3), 0.0
    if tilt_deg > 0.0:
        aim[:2] = rng.normal(0.0, 0.02, 2)
        roll = np.radians(rng.normal(0.0, 3.0))
    pose: NDArray[np.float64] = looking_at(
        distance_m * way, aim, (0.0, 1.0, 0.0)
    ) @ transforms.from_twist([0.0, 0.0, roll, 0.0, 0.0, 0.0])
    return pose


def _board(width: float, height: float) -> TriangleMesh:
    x, y = 0.5 * width, 0.5 * height
    vertices = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return painted(TriangleMesh(vertices, triangles), TARGET, np.array([0.5]))


def _matt(albedo: NDArray[np.float32]) -> SurfacePaint:
    n = len(albedo)
    return SurfacePaint(albedo, np.zeros(n, np.float32), np.full(n, 0.6, np.float32))
