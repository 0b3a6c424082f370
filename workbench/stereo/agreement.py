"""Depth maps held against each other: what several views agree on becomes a range map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import inverse
from workbench.kernels.depth_agreement import agreement
from workbench.stereo.matching import DepthEstimate, pair_geometry, stacked
from workbench.stereo.views import StereoView

# A step is told apart in so many parts, as far as 16 bits go.
_PARTS_OF_STEP, _MOST_PARTS = 16.0, 32767


@dataclass(frozen=True)
class AgreementSettings:
    """What of a depth map is believed.

    Attributes
    ----------
    least_views : other views whose depth maps agree, at least.
    most_px : how far from the pixel another depth map may lead back to.
    most_share : by how much of the depth it may differ.
    most_cost : of the matching, 1 − NCC.
    floor_px : deviation of a match that no fit goes below, pixels: edges, bends and the light
        that walks with the camera move matches by so much, and no noise tells of it.
    speckle_share : pieces of no more than this share of the picture, a pixel's worth of depth from
        all around, are dropped: clutter that a mask missed, and chance.
    """

    least_views: int = 2
    most_px: float = 1.0
    most_share: float = 0.01
    most_cost: float = 0.6
    floor_px: float = 0.35
    speckle_share: float = 2e-4


@dataclass(frozen=True)
class Agreement:
    """What views agree on.

    Attributes
    ----------
    range_map : in the camera's frame, x right, y down, z forward.
    views : (h, w) int64, how many other views agree; −1 where the pixel has no depth.
    """

    range_map: RangeMap
    views: NDArray[np.int64]


def agreed_range_map(
    name: str,
    view: StereoView,
    others: Sequence[StereoView],
    estimate: DepthEstimate,
    other_estimates: Sequence[DepthEstimate],
    settings: AgreementSettings,
) -> Agreement:
    """What of a depth map other views agree with, as a range map with its deviations."""
    sigma = _believed(view, estimate, settings)
    there, back = pair_geometry(view, others)
    nearness, deviation, views = agreement(
        estimate.planes,
        sigma,
        (*there, *back),
        stacked([other.planes for other in other_estimates]),
        stacked(
            [
                _believed(one, other, settings)
                for one, other in zip(others, other_estimates, strict=True)
            ],
            np.inf,
        ),
        np.array([other.grey.shape[::-1] for other in others], np.int64),
        settings.most_px,
        settings.most_share,
    )
    kept = views >= min(settings.least_views, len(others))
    most = int(settings.speckle_share * kept.size)
    kept &= ~speckles(np.where(kept, nearness / estimate.pixel, np.nan), most)
    grid = np.full(kept.shape, -1, np.int32)
    grid[kept] = np.arange(int(kept.sum()), dtype=np.int32)
    row, column = np.nonzero(kept)
    depth = 1.0 / nearness[kept]
    slopes = (np.column_stack([column, row]) - view.lens[2:]) / view.lens[:2]
    points = np.column_stack([slopes * depth[:, None], depth])
    found = RangeMap(
        name,
        points,
        grid=grid,
        viewpoint_in_scan=np.zeros(3),
        world_from_scan=inverse(view.camera_from_world),
        sigma_m=(deviation[kept] * depth**2).astype(np.float32),
    )
    return Agreement(found, np.where(np.isfinite(sigma), views, -1))


def speckles(steps: NDArray[np.float64], most_px: int) -> NDArray[np.bool_]:
    """Where a map (h, w) has pieces of no more than some pixels, that end all round in a step.

    Parameters
    ----------
    steps : NaN for none; neighbours of one piece differ by 1 at most.
    """
    there = np.isfinite(steps)
    if not there.any() or not most_px:
        return np.zeros(steps.shape, bool)
    low, high = float(steps[there].min()), float(steps[there].max())
    parts = min(_PARTS_OF_STEP, (_MOST_PARTS - 1) / max(high - low, 1e-12))
    whole = np.full(steps.shape, -1, np.int16)
    whole[there] = ((steps[there] - low) * parts).astype(np.int16)
    left = whole.copy()
    cv2.filterSpeckles(left, -1, most_px, max(parts, 1.0))
    return np.asarray(there & (left < 0))


def _believed(
    view: StereoView, estimate: DepthEstimate, settings: AgreementSettings
) -> NDArray[np.float32]:
    """Deviations of nearness, with the floor; infinite where the match is not believed."""
    good = view.usable & (estimate.cost <= settings.most_cost) & np.isfinite(estimate.sigma)
    floor = settings.floor_px * estimate.pixel
    return np.where(good, np.hypot(estimate.sigma, floor), np.inf).astype(np.float32)
