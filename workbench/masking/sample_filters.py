"""Filters of a range map's labels that ask samples only: a hole has no vote and bounds nothing.

Source: Jaspe, section 3.4.3, "Morphological post-pass".
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.rangemap import RangeMap
from workbench.masking.grid_surface import (
    HALF_NEIGHBOURS,
    GridSurface,
    grid_image,
    grid_of,
    neighbour_pairs,
    stretch,
)
from workbench.masking.segmentation import octagon

# Farther apart than this, in spacings, two neighbours have a depth step between them; than
# the second, even where a surface is seen very obliquely.
_STEP, _FAR = 4.0, 6.0


def neighbours_on_surface(scan: RangeMap, surface: GridSurface) -> NDArray[np.int64]:
    """How many (n,) of the eight neighbours of a sample lie on its surface."""
    count = np.zeros(len(scan), np.int64)
    for offset in HALF_NEIGHBOURS:
        a, b = neighbour_pairs(grid_of(scan), offset)
        near = stretch(scan, surface, a, b) <= _FAR
        count += np.bincount(a[near], minlength=len(scan))
        count += np.bincount(b[near], minlength=len(scan))
    return count


def median_of_samples(scan: RangeMap, kept: NDArray[np.bool_], side_px: int) -> NDArray[np.bool_]:
    """The majority (n,) of the samples in the window; holes have no vote."""
    grid = grid_of(scan)
    box = (side_px, side_px)
    votes = grid_image(scan, np.where(kept, 1.0, -1.0).astype(np.float32), 0.0)
    sum_of = cv2.boxFilter(
        np.asarray(votes), -1, box, normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    found = kept.copy()
    # Half a vote, since sums of ±1 in float32 are exact and a tie keeps what was.
    decided = np.abs(sum_of[grid >= 0]) > 0.5
    samples = grid[grid >= 0][decided]
    found[samples] = sum_of[grid >= 0][decided] > 0
    return found


def eroded(
    scan: RangeMap, surface: GridSurface, kept: NDArray[np.bool_], radius_px: int
) -> NDArray[np.bool_]:
    """Without the samples (n,) close to clutter or to a depth step.

    A hole is neither: where the beam did not come back from, nothing leaks.
    """
    grid = grid_of(scan)
    beside = np.zeros(len(scan), bool)
    for offset in HALF_NEIGHBOURS[:2]:
        a, b = neighbour_pairs(grid, offset)
        step = stretch(scan, surface, a, b) > _STEP
        beside[a[step]] = True
        beside[b[step]] = True
    clutter = grid_image(scan, (~kept).astype(np.uint8), 0)
    steps = grid_image(scan, beside.astype(np.uint8), 0)
    near = cv2.dilate(np.asarray(clutter), octagon(radius_px))
    # Samples beside a step are at its distance of one already.
    near = np.maximum(near, cv2.dilate(np.asarray(steps), octagon(radius_px - 1)))
    found = kept.copy()
    found[grid[(grid >= 0) & (near > 0)]] = False
    return found
