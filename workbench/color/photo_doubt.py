"""Pixels of a photograph that its fellows contradict: highlights, clutter, shadows nobody foresaw.

Source: Waechter, Moehrle and Goesele 2014, "Let there be color!", section 3.1, removes views that
do not agree with the others, face by face. Here the others are their robust blend on the surface,
and what is removed are pixels.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import reduced_camera
from workbench.geometry.robust import robust_sigma
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.stitch_passes import corner_colors

# What is compared are means over so many cells: finer differences are the paint's own, which the
# blend does not resolve, and a pixel's misplacement.
_AROUND_CELLS = 1.5
_LEAST_SHARE = 0.2
_USUAL_SIGMAS = 3.0
# The logarithm of nothing is that of a surface far darker than any is.
_DARKEST = 0.005
_GAMMA = 2.2


def doubted_pixels(
    picture: NDArray[np.uint8],
    camera: PhotoCamera,
    rays: SurfaceRays,
    colors: NDArray[np.uint8],
    known: NDArray[np.bool_],
    cell_px: float,
    limit: float,
) -> NDArray[np.bool_]:
    """Pixels (h, w) whose lightness is not what other photographs say of the place.

    Parameters
    ----------
    picture : (h, w, 4) uint8 sRGB-encoded, free of its flash; alpha 255 where it may be used.
    camera : of the picture.
    rays : the surface.
    colors : (n, 3) uint8 sRGB-encoded, what all photographs together say of its vertices.
    known : (n,) vertices of which they say something.
    cell_px : pixels compared at once, about the distance of vertices in the picture.
    limit : difference of the logarithm of lightness from which a pixel is doubted, if it is three
        times the photograph's usual one, too; a difference that the whole photograph has is its
        exposure's and does not count.
    """
    height, width = picture.shape[:2]
    if not known.any():
        return np.zeros((height, width), bool)
    cell = max(cell_px, 1.0)
    small = reduced_camera(camera, max(2, round(width / cell)), max(2, round(height / cell)))
    size = (small.width, small.height)
    met = rays.seen_by(small)
    triangles = rays.mesh.triangles
    whole = met.found.copy()
    whole[whole] = known[triangles[met.triangles[met.found]]].all(axis=1)
    blend = np.zeros((small.height * small.width, 3), np.float32)
    blend[whole] = corner_colors(
        met.points[whole],
        met.triangles[whole].astype(np.int32),
        rays.mesh.vertices,
        triangles,
        colors,
    )
    usable = (picture[..., 3] == 255).astype(np.float32)
    light = _lightness(picture[..., :3].astype(np.float32) / np.float32(255.0))
    share = cv2.resize(usable, size, interpolation=cv2.INTER_AREA)
    own = cv2.resize(light * usable, size, interpolation=cv2.INTER_AREA)
    weight = np.where(whole.reshape(small.height, small.width), share, np.float32(0.0))
    told = _around(weight)
    sure = told > _LEAST_SHARE
    if not sure.any():
        return np.zeros((height, width), bool)
    theirs = _around(weight * _lightness(blend).reshape(weight.shape))
    ours = _around(np.where(share > 0.0, weight * own / np.maximum(share, 1e-6), np.float32(0.0)))
    scale = np.where(sure, told, np.float32(1.0))
    apart = _level(ours / scale) - _level(theirs / scale)
    apart -= np.median(apart[sure])
    # A surface whose lightness is never quite explained, a glossy one say, is not all wrong.
    usual = _USUAL_SIGMAS * robust_sigma(apart[sure].astype(np.float64))
    bad = sure & (np.abs(apart) > max(limit, usual))
    grown = cv2.dilate(bad.astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.asarray(cv2.resize(grown, (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def _around(values: NDArray[np.floating]) -> NDArray[np.float32]:
    soft = cv2.GaussianBlur(values, (0, 0), _AROUND_CELLS, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(soft, np.float32)


def _lightness(encoded: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of channels in linear light, near enough for a comparison."""
    return np.asarray((encoded**_GAMMA).mean(axis=-1), np.float32)


def _level(light: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.asarray(np.log(np.maximum(light, _DARKEST)), np.float32)
