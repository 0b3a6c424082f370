"""How much each pixel of a photograph counts when photographs are blended.

Source: Pintus et al. 2011, "Fast low-memory seamless photo blending on massive point clouds":
weights are made in screen space, are smooth, and come to nothing at every border of what a
photograph can tell, so that no seam shows where its contribution ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_view import PhotoView

# Cosines of the view angle between which a pixel's weight rises from nothing: 84° to 65°.
_GRAZING, _CLEAR = 0.1, 0.42
# Of the blur of a pixel's surroundings, pixels: detail that only sharp pictures have, and the
# detail that is left in one slightly out of focus.
_FINE_PX, _COARSE_PX, _AROUND_PX = 0.8, 2.4, 12.0
# Least weight for blur: the only photograph of a place is better than none.
_LEAST_SHARPNESS = 0.05
_BARELY = 1e-6


@dataclass(frozen=True)
class WeightOptions:
    """What pixels are weighed by.

    Attributes
    ----------
    feather : width of the ramp at borders, as a share of the photograph's longer side.
    angle_power : power of the cosine between normal and view; 0 takes oblique views for as
        good as others, down to some 65°.
    sharpness_power : power of the relative sharpness; 0 leaves focus out.
    """

    feather: float = 0.01
    angle_power: float = 1.0
    sharpness_power: float = 1.0


def pixel_weights(
    view: PhotoView,
    picture: NDArray[np.float32],
    usable: NDArray[np.bool_],
    options: WeightOptions,
) -> NDArray[np.float32]:
    """Weight (h, w) in [0, 1] of every pixel; 0 at borders and where nothing is seen.

    Parameters
    ----------
    view : of the same size.
    picture : (h, w, 3) linear.
    usable : (h, w) within the mask and not clipped.
    """
    told = usable & view.seen & ~view.steps()
    weights = feathered(told, options.feather)
    cosines = view.cosines
    weights *= _step(cosines, _GRAZING, _CLEAR) * cosines**options.angle_power
    if options.sharpness_power > 0.0:
        weights *= sharpness(picture, told) ** options.sharpness_power
    return weights


def feathered(told: NDArray[np.bool_], feather: float) -> NDArray[np.float32]:
    """Weight (h, w) that rises from 0 at the border of ``told`` to 1, smoothly.

    The picture's own edge is a border too.

    Parameters
    ----------
    feather : where 1 is reached, as a share of the longer side.
    """
    distance = cv2.distanceTransform(
        np.pad(told, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )[1:-1, 1:-1]
    width = max(1.0, feather * max(told.shape))
    # The outermost pixel has a border half a pixel away.
    return _step(np.maximum(distance - np.float32(0.5), 0.0), 0.0, width)


def sharpness(picture: NDArray[np.float32], told: NDArray[np.bool_]) -> NDArray[np.float32]:
    """How much of a picture's detail is fine (h, w), in (0, 1]; the mean of its surroundings.

    The same place in two photographs has the same detail, so the ratio of fine to coarse tells
    the sharper one whatever it shows. Beyond ``told`` nothing counts.
    """
    inside = told.astype(np.float32)
    grey = np.where(told, picture.max(axis=2), np.float32(0.0)).astype(np.float32)
    share = cv2.GaussianBlur(inside, (0, 0), _COARSE_PX)
    middle = cv2.GaussianBlur(inside, (0, 0), _FINE_PX)
    fine = grey - cv2.GaussianBlur(grey, (0, 0), _FINE_PX) / np.maximum(middle, _BARELY)
    coarse = grey - cv2.GaussianBlur(grey, (0, 0), _COARSE_PX) / np.maximum(share, _BARELY)
    powers = [
        cv2.GaussianBlur(np.where(told, detail**2, np.float32(0.0)), (0, 0), _AROUND_PX)
        for detail in (fine, coarse)
    ]
    # Scaled so that white noise, which no lens can sharpen, comes to about one.
    ratio = powers[0] / np.maximum(powers[1], np.finfo(np.float32).tiny)
    return np.clip(np.nan_to_num(ratio), _LEAST_SHARPNESS, 1.0).astype(np.float32)


def _step(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.float32]:
    """0 up to ``low``, 1 from ``high``, a cubic without kinks between."""
    part = np.clip((values - np.float32(low)) / np.float32(high - low), 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part), np.float32)
