"""Which surfels of the parts of an object are seen from outside the whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.point_set import PointSet
from workbench.kernels.surfel_discs import NO_DISC, draw_discs_parallel
from workbench.surfels.corner_views import corner_views

# Discs stick out of outlines, so that one sees some from behind: only those views count that look
# upon a surfel at least so steeply, as a share of the steepest.
_LEAST_SHARE = 0.5


def seen_from_corners(
    surfels: PointSet, resolution: int, *, views: int = 8, oriented: bool = True
) -> NDArray[np.int64]:
    """Rows of the surfels that show when they are drawn from the corners of their bounds.

    The surfels of children serve in place of the surface itself (Brandt 2019, 3.4).

    Parameters
    ----------
    surfels
        With normals and radii.
    resolution
        Pixels along the longer side of each picture.
    views
        As in ``corner_views``.
    oriented
        Whether normals point out of what the surfels cover. Those that point away from a
        corner are not seen from it then: where a part was open, they are its inside.
    """
    if surfels.normals is None or surfels.radius is None:
        raise ValueError("only oriented surfels with radii can hide each other")
    lower, upper = surfels.bounds
    middle = 0.5 * (lower + upper)
    places = surfels.points - middle
    normals, radii = surfels.normals.astype(np.float64), surfels.radius.astype(np.float64)
    seen = np.zeros(len(surfels), bool)
    found = corner_views(lower - middle, upper - middle, resolution, views)
    facing = -normals @ np.stack([view.axes[2] for view in found]).T
    if not oriented:
        facing = np.abs(facing)
    judged = facing > _LEAST_SHARE * facing.max(axis=1, keepdims=True)
    for view, toward, judge in zip(found, facing.T, judged.T, strict=True):
        rows = np.flatnonzero(toward > 0.0)
        depth = np.full((view.height, view.width), np.inf)
        number = np.full((view.height, view.width), NO_DISC, np.int32)
        draw_discs_parallel(
            np.ascontiguousarray((places[rows] - view.corner) @ view.axes.T),
            np.ascontiguousarray(normals[rows] @ view.axes.T),
            radii[rows],
            view.pixel,
            depth,
            number,
        )
        shown = rows[number[number != NO_DISC]]
        seen[shown[judge[shown]]] = True
    return np.flatnonzero(seen)
