"""A photograph free of its flash, pixel by pixel, for texturing.

Source: Jaspe, section 3.4.5, eq. 3.2, over the buffers of the photograph's own camera.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_display import encoded_srgb
from workbench.color.flash_light import FlashLight, albedo, incidence_trust
from workbench.color.spaces import SpaceName
from workbench.geometry.photo_view import PhotoView, strips

# Where less of a pixel's light is to be trusted, a small error of the normal shows as a stain.
_LEAST_TRUST = 0.05


def flash_free_picture(
    view: PhotoView,
    picture: NDArray[np.float32],
    usable: NDArray[np.bool_],
    space: SpaceName,
    light: FlashLight | None,
    gain: float,
    border_px: int,
) -> NDArray[np.uint8]:
    """A photograph as it would be in even light.

    Parameters
    ----------
    view : of the surface from the photograph's camera, normals smoothed, of the same size.
    picture : (h, w, 3) linear in ``space``.
    usable : (h, w) pixels that may tell: in the mask, not clipped, not in the flash's shadow.
    light : of the flash; None takes the colours as photographed.
    gain : value of a white diffuser that gets light 1.
    border_px : pixels next to what is not usable or not of the surface that are not used
        either: there, background and clutter bleed in.

    Returns
    -------
    (h, w, 4) uint8 sRGB-encoded; alpha 255 where the pixel may be used, else 0. Pixels of
    alpha 0 beside used ones have the colour of the nearest used one, so that values between
    pixels stay clean.
    """
    out = np.zeros((*picture.shape[:2], 4), np.uint8)
    told = usable & view.seen & np.isfinite(picture).all(axis=2)
    for rows in strips(picture.shape[0]):
        here = told[rows]
        values = picture[rows][here].astype(np.float64)
        if light is None:
            values, kept = values / gain, np.ones(len(values), bool)
        else:
            places = view.places(rows)[here]
            normals = view.normals[rows][here].astype(np.float64)
            received = light.received(places, normals)
            kept = incidence_trust(light.incidence(places, normals)) > _LEAST_TRUST
            kept &= received > 0.0
            values = albedo(values, np.where(kept, received, 1.0), gain)
        part = out[rows]
        part[here, :3] = encoded_srgb(np.clip(values, 0.0, None), space)
        part[here, 3] = np.where(kept, 255, 0)
    if border_px > 0:
        square = np.ones((2 * border_px + 1, 2 * border_px + 1), np.uint8)
        # The border of the picture itself cuts nothing off.
        out[..., 3] = cv2.erode(out[..., 3], square, borderType=cv2.BORDER_REPLICATE)
    return _bled(out)


def _bled(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """With the colour of the nearest used pixel in every other one."""
    used = picture[..., 3] > 0
    if used.all() or not used.any():
        return picture
    _, nearest = cv2.distanceTransformWithLabels(
        np.where(used, 0, 255).astype(np.uint8),
        cv2.DIST_L2,
        cv2.DIST_MASK_5,
        labelType=cv2.DIST_LABEL_PIXEL,
    )
    # Labels number the used pixels; which number is whose stands at those pixels.
    colors = np.zeros((int(nearest.max()) + 1, 3), np.uint8)
    colors[nearest[used]] = picture[used, :3]
    picture[~used, :3] = colors[nearest[~used]]
    return picture
