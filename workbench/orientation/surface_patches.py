"""Many exact tie points of photographs whose surface is known well enough to warp patches by.

Corners of every photograph are dropped onto the surface; the small patch around each is looked
up in all photographs that see the place, warped as the surface lies, and shifted until it
matches. Unlike descriptors, patches find wide baselines and a twentieth of a pixel.

Source: Furukawa and Ponce 2009, "Accurate camera calibration from multi-view stereo and bundle
adjustment", which alternates surface, patches and bundle adjustment in this way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import ColmapModel, ColmapPoint
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.patch_shift import patch_shifts

# COLMAP counts from the corner of the first pixel, images from its middle.
_MIDDLE = 0.5
_SMOOTH_PX, _SHADING_PX = 0.8, 2.0
_DARK = 8.0
_LEAST_QUALITY = 0.01
_NOT_HIDDEN = 0.995
_LEAST_COSINE, _LEAST_COSINE_REFERENCE = 0.35, 0.6
_LEAST_CORRELATION = 0.85
_ROUNDS = 12
_LEAST_VIEWS = 3


@dataclass(frozen=True)
class PatchOptions:
    """How tie points are found on the surface.

    Attributes
    ----------
    per_photo : corners looked for in each photograph.
    apart_px : between two corners.
    half_px : patches are (2 half + 1)² pixels.
    most_shift_px : a patch further from where the surface says is not the same.
    """

    per_photo: int = 2000
    apart_px: float = 4.0
    half_px: int = 6
    most_shift_px: float = 2.5


def with_surface_patches(
    model: ColmapModel,
    pictures: Mapping[int, NDArray[np.uint8]],
    masks: Mapping[int, NDArray[np.uint8]],
    surface: SurfaceRays,
    options: PatchOptions | None = None,
) -> ColmapModel:
    """The same photographs with tie points from patches instead of the model's own.

    Parameters
    ----------
    model : cameras in the surface's frame, right within ``most_shift_px``.
    pictures : image id → (h, w) uint8 grey, of the photograph's size or evenly reduced.
    masks : image id → (h, w) uint8 of the picture's size, 255 = keep; photographs without one
        are used whole.
    surface : what they show.

    Returns
    -------
    A model whose points are seen by three photographs or more; it may have none.
    """
    options = options or PatchOptions()
    numbers = sorted(model.images)
    cameras = {number: _camera_of(model, number, pictures[number].shape) for number in numbers}
    smooth = {n: _smooth(pictures[n], masks.get(n)) for n in numbers}
    found: dict[int, list[tuple[int, float, float]]] = {}
    places: list[NDArray[np.float64]] = []
    for number in numbers:
        patches = _patches(pictures[number], masks.get(number), cameras[number], surface, options)
        first = len(places)
        for row, corner in enumerate(patches.corners):
            found[first + row] = [(number, float(corner[0]), float(corner[1]))]
        places += list(patches.middles)
        for other in numbers:
            if other == number or not len(patches.corners):
                continue
            rows, pixels = _matched(
                smooth[number], smooth[other], patches, cameras[number], cameras[other],
                surface, options,
            )  # fmt: skip
            for row, pixel in zip(rows, pixels, strict=True):
                found[first + row].append((other, float(pixel[0]), float(pixel[1])))
    tracks = [(places[k], seen) for k, seen in sorted(found.items()) if len(seen) >= _LEAST_VIEWS]
    return _rebuilt(model, tracks, cameras)


@dataclass(frozen=True)
class _Patches:
    """Patches of one photograph as they lie on the surface.

    Attributes
    ----------
    corners : (k, 2) their middles in COLMAP's pixels.
    places : (k, s, 3) of all their pixels on the surface, row by row; a plane would not do,
        for on a rounded surface it puts the patch too deep.
    middles, normals : (k, 3) of their middle pixels.
    """

    corners: NDArray[np.float64]
    places: NDArray[np.float64]
    middles: NDArray[np.float64]
    normals: NDArray[np.float64]


def _patches(
    picture: NDArray[np.uint8],
    mask: NDArray[np.uint8] | None,
    camera: PhotoCamera,
    surface: SurfaceRays,
    options: PatchOptions,
) -> _Patches:
    """Patches about the corners of a photograph that lie whole on steady surface."""
    within = np.full(picture.shape, 255, np.uint8) if mask is None else np.array(mask)
    edge = np.ones((2 * options.half_px + 1,) * 2, np.uint8)
    # Beyond the frame is no object: the border is eaten away, too.
    inner = cv2.erode(within, edge, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    found = cv2.goodFeaturesToTrack(
        picture, options.per_photo, _LEAST_QUALITY, options.apart_px, mask=inner, blockSize=5
    )
    corners = np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(float) + _MIDDLE
    steps = np.arange(-options.half_px, options.half_px + 1, dtype=float)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pixels = corners[:, None] + offsets
    met = surface.first_met(camera.center, camera.directions(pixels.reshape(-1, 2)))
    shape = (*pixels.shape[:2], 3)
    places, normals = met.points.reshape(shape), met.normals.reshape(shape)
    middle = len(offsets) // 2
    towards = camera.center - places
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    facing = np.abs((normals * towards).sum(axis=2))
    # Steep anywhere: a fold or a step, which the surface tells less well than its open parts.
    steady = (facing > _LEAST_COSINE).all(axis=1) & (facing[:, middle] > _LEAST_COSINE_REFERENCE)
    deep = np.linalg.norm(places - camera.center, axis=2)
    span = np.ptp(deep, axis=1)
    wide = np.linalg.norm(places[:, 0] - places[:, -1], axis=1)
    good = met.found.reshape(pixels.shape[:2]).all(axis=1) & steady & (span < wide)
    return _Patches(corners[good], places[good], places[good, middle], normals[good, middle])


def _matched(
    reference: NDArray[np.float32],
    target: NDArray[np.float32],
    patches: _Patches,
    camera: PhotoCamera,
    other: PhotoCamera,
    surface: SurfaceRays,
    options: PatchOptions,
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Rows of the patches found again in another photograph, and where their middles are."""
    towards = other.center - patches.middles
    distance = np.linalg.norm(towards, axis=1)
    facing = (patches.normals * towards).sum(axis=1) / distance
    own = (patches.normals * (camera.center - patches.middles)).sum(axis=1)
    middles, _ = other.project(patches.middles)
    inside = (
        (middles > 0).all(axis=1)
        & (middles[:, 0] < other.width)
        & (middles[:, 1] < other.height)
        & (np.sign(own) * facing > _LEAST_COSINE)
    )
    rows = np.flatnonzero(inside)
    if len(rows):
        met = surface.first_met(other.center, -towards[rows] / distance[rows, None])
        before = np.linalg.norm(met.points - other.center, axis=1)
        rows = rows[met.found & (before > _NOT_HIDDEN * distance[rows])]
    if not len(rows):
        return rows, np.zeros((0, 2))
    expected, _ = other.project(patches.places[rows].reshape(-1, 3))
    shifts, correlation = patch_shifts(
        reference,
        target,
        patches.corners[rows] - _MIDDLE,
        expected.reshape(len(rows), -1, 2) - _MIDDLE,
        options.half_px,
        _ROUNDS,
    )
    good = (correlation > _LEAST_CORRELATION) & (
        np.linalg.norm(np.nan_to_num(shifts, nan=np.inf), axis=1) < options.most_shift_px
    )
    return rows[good], (middles[rows] + shifts)[good]


def _camera_of(model: ColmapModel, number: int, shape: tuple[int, ...]) -> PhotoCamera:
    """A photograph's camera, for a picture of that many rows and columns."""
    import pycolmap

    image = model.images[number]
    camera = model.cameras[image.camera_id]
    lens = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=camera.params
    )
    lens.rescale(new_width=shape[1], new_height=shape[0])
    params = tuple(float(value) for value in lens.params)
    return PhotoCamera(camera.model, shape[1], shape[0], params, image.camera_from_world)


def _smooth(picture: NDArray[np.uint8], mask: NDArray[np.uint8] | None) -> NDArray[np.float32]:
    """Paint without shading, fit for slopes; NaN off the object.

    Shading changes as the flash moves with the camera: of the logarithm only what is finer
    than it stays.
    """
    light = np.log(picture.astype(np.float32) + np.float32(_DARK))
    fine = light - cv2.GaussianBlur(light, (0, 0), _SHADING_PX)
    soft = cv2.GaussianBlur(fine, (0, 0), _SMOOTH_PX)
    if mask is not None:
        soft = np.where(mask > 127, soft, np.float32(np.nan))
    return np.asarray(soft, np.float32)


def _rebuilt(
    model: ColmapModel,
    tracks: list[tuple[NDArray[np.float64], list[tuple[int, float, float]]]],
    cameras: Mapping[int, PhotoCamera],
) -> ColmapModel:
    pixels: dict[int, list[tuple[float, float]]] = {n: [] for n in model.images}
    owners: dict[int, list[int]] = {n: [] for n in model.images}
    points = {}
    for number, (place, seen) in enumerate(tracks, start=1):
        track = []
        for image, x, y in seen:
            track.append((image, len(pixels[image])))
            full = model.cameras[model.images[image].camera_id]
            seen_by = cameras[image]
            pixels[image].append((x * full.width / seen_by.width, y * full.height / seen_by.height))
            owners[image].append(number)
        points[number] = ColmapPoint(
            number, place, np.full(3, 128, np.uint8), 0.0, np.array(track, np.int64)
        )
    images = {
        n: replace(
            image,
            points2d=np.array(pixels[n], float).reshape(-1, 2),
            point3d_ids=np.array(owners[n], np.int64),
        )
        for n, image in model.images.items()
    }
    return ColmapModel(model.cameras, images, points)
