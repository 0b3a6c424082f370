"""Pairs of photographs whose matches obey one relative motion (RANSAC, by pycolmap)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.orientation.features import PhotoFeatures


@dataclass(frozen=True)
class VerificationSettings:
    """What passes for one motion.

    Attributes
    ----------
    max_error_px : of a match from the epipolar line.
    min_inliers : matches that must agree.
    max_trials : draws at most; a thousand find a motion that 4 in 10 matches obey, and pairs
        that show nothing in common cost all of them.
    """

    max_error_px: float = 4.0
    min_inliers: int = 15
    max_trials: int = 1000


@dataclass(frozen=True)
class TwoViews:
    """A verified pair: ``geometry`` is pycolmap's ``TwoViewGeometry``."""

    first: int
    second: int
    geometry: Any
    inliers: int


def verified(
    first: int,
    second: int,
    features: tuple[PhotoFeatures, PhotoFeatures],
    cameras: tuple[Any, Any],
    matches: NDArray[np.uint32],
    settings: VerificationSettings,
    seed: int,
) -> TwoViews | None:
    """The geometry that most matches (k, 2) of a pair obey; None where too few do.

    Parameters
    ----------
    first, second : numbers of the photographs.
    features, cameras : theirs; cameras are pycolmap's.
    matches : (k, 2) uint32 rows of the first's and the second's features.
    settings : what passes for one motion.
    seed : of the draws; the same gives the same geometry.
    """
    import pycolmap

    if len(matches) < settings.min_inliers:
        return None
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = settings.min_inliers
    options.ransac.max_error = settings.max_error_px
    options.ransac.max_num_trials = settings.max_trials
    options.ransac.random_seed = seed
    geometry = pycolmap.estimate_two_view_geometry(
        cameras[0],
        features[0].points.astype(np.float64),
        cameras[1],
        features[1].points.astype(np.float64),
        matches,
        options,
    )
    inliers = len(geometry.inlier_matches)
    if inliers < settings.min_inliers:
        return None
    return TwoViews(first, second, geometry, inliers)
