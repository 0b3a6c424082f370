"""A chart in space: where it stands before the camera, and what it tells of the flash.

The chart's white gives the level of the flash's light (`workbench.color.flash_light.anchored`).
Where no other photograph tells where the flash is, the chart does so roughly: its published
colours fit best when the light is taken out as it truly fell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from workbench.color.chart import COLS, ROWS, Edition, patch_middles, reference_xyz_d50
from workbench.color.chart_finding import FoundChart
from workbench.color.flash_light import FlashLight
from workbench.color.patches import ChartPatches
from workbench.color.spaces import delta_e2000, lab_from_xyz_d50
from workbench.geometry.photo_camera import PhotoCamera

CELL_M = 0.0430
"""From the middle of a patch of the large chart to the next, metres."""

# The grid was laid onto the patches; where it still is off by more, the lens is not the one told.
_MOST_OFF = 0.1
_FEWEST_PATCHES = 12
# Within this of the lens, in distances of the chart, a flash is first looked for.
_START, _POSITION_SIGMA = 0.2, 0.5


@dataclass(frozen=True)
class ChartPlace:
    """Where a chart stands in the camera's frame (x right, y down, z forward).

    Attributes
    ----------
    middle : (3,) in the unit of the cell's size.
    normal : (3,) unit, towards the camera.
    patches : (24, 3) the patches' middles.
    residual : root mean square of how far patches lie from where they are seen, in cells.
    """

    middle: NDArray[np.float64]
    normal: NDArray[np.float64]
    patches: NDArray[np.float64]
    residual: float


@dataclass(frozen=True)
class NoChartPlace:
    """Why the chart's place is not known."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def chart_place(
    chart: FoundChart, camera: PhotoCamera, cell: float = CELL_M
) -> ChartPlace | NoChartPlace:
    """The chart's pose from its patches' places in the photograph.

    Parameters
    ----------
    chart : in pixels of the very photograph that the camera describes; `FoundChart.scaled`.
    camera : its lens; where it stands does not matter.
    cell : distance of neighbouring patches, which sets the unit.
    """
    own = replace(camera, camera_from_world=np.eye(4))
    rays = own.directions(chart.pixels(patch_middles()))
    if not np.isfinite(rays).all() or (rays[:, 2] <= 0.0).any():
        return NoChartPlace("the lens does not reach the chart's pixels")
    slopes = np.ascontiguousarray(rays[:, :2] / rays[:, 2:])
    right_down = cell * (patch_middles() - [0.5 * COLS, 0.5 * ROWS])
    points = np.column_stack([right_down, np.zeros(len(right_down))])
    # A plane has two poses that look nearly alike; the one that fits better is taken.
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        points, slopes, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
    )
    best: ChartPlace | None = None
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        turn, shift = cv2.solvePnPRefineLM(points, slopes, np.eye(3), np.zeros(4), turn, shift)
        rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
        patches = np.asarray(points @ rotation.T + shift.ravel(), np.float64)
        if not np.isfinite(patches).all() or (patches[:, 2] <= 0.0).any():
            continue
        off = (patches[:, :2] / patches[:, 2:] - slopes) * patches[:, 2:] / cell
        residual = float(np.sqrt((off**2).sum(axis=1).mean()))
        if best is None or residual < best.residual:
            middle = np.asarray(shift.ravel(), np.float64)
            best = ChartPlace(middle, -rotation[:, 2], patches, residual)
    if best is None:
        return NoChartPlace("no pose of the chart explains where its patches are seen")
    if best.residual > _MOST_OFF:
        return NoChartPlace(
            f"patches lie {best.residual:.2g} of their distance from where a flat chart has "
            "them: the lens is not the one that was told"
        )
    return best


@dataclass(frozen=True)
class ChartFlash:
    """The flash as a single chart tells it, and how well its colours fit.

    Attributes
    ----------
    light : with the chart's distance as its reference distance; Lambertian, for a chart is.
    delta_e_even, delta_e_at_lens, delta_e : mean CIEDE2000 of the fitted patches after the best
        linear matrix: with even light, with the flash in the lens, with the flash in its place.
    """

    light: FlashLight
    delta_e_even: float
    delta_e_at_lens: float
    delta_e: float


@dataclass(frozen=True)
class NoChartFlash:
    """Why the chart does not tell the flash."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def flash_by_chart(
    patches: ChartPatches, place: ChartPlace, edition: Edition = "after_2014"
) -> ChartFlash | NoChartFlash:
    """The place of the flash with which the chart's published colours fit best.

    Across one chart the light changes by a few parts in ten, and the matrix takes up some of
    that: the place is good to some hundredths of the distance in the picture's plane and hardly
    known along the view. Photographs of an object from several sides tell it far better.

    Parameters
    ----------
    patches : linear RGB with the lens's vignetting taken out.
    """
    used = patches.usable
    if used.sum() < _FEWEST_PATCHES:
        return NoChartFlash(f"only {used.sum()} of the chart's patches are not clipped")
    reference = reference_xyz_d50(edition)
    target = lab_from_xyz_d50(reference)
    weight = 1.0 / np.sqrt(reference[used, 1:2] + 0.01)
    distance = float(np.linalg.norm(place.middle))
    normals = np.tile(place.normal, (len(place.patches), 1))

    def light(position: NDArray[np.float64]) -> FlashLight:
        return FlashLight(distance * position, reference_distance=distance, epsilon=0.0)

    def differences(means: NDArray[np.float64]) -> NDArray[np.float64]:
        solved = np.linalg.lstsq(weight * means[used], weight * reference[used], rcond=None)[0]
        return delta_e2000(lab_from_xyz_d50(means[used] @ solved), target[used])

    def without(position: NDArray[np.float64]) -> NDArray[np.float64]:
        received = light(position).received(place.patches, normals)
        return patches.means / np.maximum(received, 1e-6)[:, None]

    def cost(position: NDArray[np.float64]) -> float:
        held = float((position**2).sum()) / _POSITION_SIGMA**2
        return float((differences(without(position)) ** 2).mean()) + held

    directions = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    starts = sorted((_START * way for way in directions), key=cost)
    solved = minimize(cost, starts[0], method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
    best = np.asarray(solved.x)
    return ChartFlash(
        light(best),
        float(differences(patches.means).mean()),
        float(differences(without(np.zeros(3))).mean()),
        float(differences(without(best)).mean()),
    )
