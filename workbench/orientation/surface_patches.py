"""Many exact tie points of photographs whose surface is known well enough to warp patches by.

Corners of every photograph are dropped onto the surface; the small patch around each is looked
up in all photographs that see the place, warped as the surface lies, and shifted until it
matches. Unlike descriptors, patches find wide baselines and a twentieth of a pixel.

Source: Furukawa and Ponce 2009, "Accurate camera calibration from multi-view stereo and bundle
adjustment", which alternates surface, patches and bundle adjustment in this way.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from os import cpu_count

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
# Patches of a photograph by which it is told who shows how many of them.
_COUNTED = 256
# Of all photographs; several times as many as an adjustment takes part of.
MOST_TRACKS = 400_000


@dataclass(frozen=True)
class PatchOptions:
    """How tie points are found on the surface.

    Attributes
    ----------
    per_photo : corners looked for in each photograph.
    apart_px : between two corners.
    half_px : patches are (2 half + 1)² pixels.
    most_shift_px : a patch further from where the surface says is not the same.
    most_photos : that the patches of one are looked up in; time would grow with the square of
        the photographs, and what more of them tell of a camera shrinks.
    """

    per_photo: int = 8000
    apart_px: float = 2.5
    half_px: int = 6
    most_shift_px: float = 2.5
    most_photos: int = 32


@dataclass(frozen=True)
class PatchedModel:
    """Photographs tied by patches.

    Attributes
    ----------
    model : cameras as they were, points and observations from patches.
    information : image id → (k, 3), of each observation the inverse covariance in 1/px² as its
        patch tells it, xx, xy and yy; right up to a common factor, for neighbouring pixels of
        smoothed pictures err together.
    overlap : how many patches a pixel is part of, on average over those in any; as many
        observations share its noise.
    """

    model: ColmapModel
    information: dict[int, NDArray[np.float64]]
    overlap: float


@dataclass(frozen=True)
class _Tracks:
    """Where patches of one photograph were seen, patch after patch.

    Attributes
    ----------
    places : (k, 3) their middles on the surface.
    patch, image : (n,) of each sighting its patch, in order, and the photograph; the first of a
        patch is where it is from, the others follow by their photographs' numbers.
    pixels : (n, 2) the pixel of the patch's middle.
    information : (n, 3) on it, xx, xy and yy; the first has the mean of the others, for the patch
        itself is as noisy as where it was found again.
    """

    places: NDArray[np.float64]
    patch: NDArray[np.intp]
    image: NDArray[np.intp]
    pixels: NDArray[np.float64]
    information: NDArray[np.float64]


def with_surface_patches(
    model: ColmapModel,
    pictures: Mapping[int, NDArray[np.uint8]],
    masks: Mapping[int, NDArray[np.uint8]],
    surface: SurfaceRays,
    options: PatchOptions | None = None,
) -> PatchedModel:
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
    PatchedModel, whose points are seen by three photographs or more; it may have none.
    """
    options = options or PatchOptions()
    cameras = {n: _camera_of(model, n, pictures[n].shape) for n in sorted(model.images)}
    tracks = _all_tracks(pictures, masks, cameras, surface, options)
    return _rebuilt(model, tracks, cameras, options.half_px)


def _all_tracks(
    pictures: Mapping[int, NDArray[np.uint8]],
    masks: Mapping[int, NDArray[np.uint8]],
    cameras: Mapping[int, PhotoCamera],
    surface: SurfaceRays,
    options: PatchOptions,
) -> list[_Tracks]:
    """Of every photograph, the patches that three or more see; of very many those most do."""
    most = max(1, MOST_TRACKS // max(1, len(cameras)))
    smooth = {n: _smooth(pictures[n], masks.get(n)) for n in cameras}

    def followed(number: int) -> _Tracks:
        patches = _patches(pictures[number], masks.get(number), cameras[number], surface, options)
        count = len(patches.corners)
        own = np.arange(count)
        parts = [(own, np.full(count, number), patches.corners, np.zeros((count, 3)))]
        for other in _to_look_in(number, patches, cameras, surface, options.most_photos):
            rows, seen = _matched(
                smooth[number], smooth[other], patches, cameras[number], cameras[other],
                surface, options,
            )  # fmt: skip
            parts.append((rows, np.full(len(rows), other), seen[:, :2], seen[:, 2:]))
        return _tracks_of(patches.middles, most, *map(np.concatenate, zip(*parts, strict=True)))

    # One photograph's patches take some 100 MB: no more at once than can be worked on.
    with ThreadPoolExecutor(cpu_count()) as pool:
        return list(pool.map(followed, cameras))


def _tracks_of(
    places: NDArray[np.float64],
    most: int,
    patch: NDArray[np.intp],
    image: NDArray[np.intp],
    pixels: NDArray[np.float64],
    information: NDArray[np.float64],
) -> _Tracks:
    """Sightings, a photograph's after those of another, put in order of their patches.

    Patches that too few see are left out, and of more than ``most`` those that fewer see; the
    information of first sightings is zero yet.
    """
    views = np.bincount(patch, minlength=len(places))
    often = np.zeros(len(places), bool)
    often[np.argsort(-views, kind="stable")[:most]] = True
    often &= views >= _LEAST_VIEWS
    order = np.argsort(patch, kind="stable")
    order = order[often[patch[order]]]
    views = views[often]
    informed = information[order]
    first = np.cumsum(views) - views
    if len(first):
        informed[first] = np.add.reduceat(informed, first) / (views - 1)[:, None]
    renumbered = np.repeat(np.arange(len(views)), views)
    return _Tracks(places[often], renumbered, image[order], pixels[order], informed)


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


def _to_look_in(
    number: int,
    patches: _Patches,
    cameras: Mapping[int, PhotoCamera],
    surface: SurfaceRays,
    most: int,
) -> list[int]:
    """Photographs that may show patches of one, by number.

    Of more than ``most`` evenly those that see many and those that see few of them: near ones
    tell the rays well, far ones the depth.
    """
    others = [n for n in cameras if n != number] if len(patches.middles) else []
    if len(others) <= most:
        return others
    some = np.arange(0, len(patches.middles), -(-len(patches.middles) // _COUNTED))
    camera = cameras[number]
    shared = np.array([len(_shown(patches, some, camera, cameras[n], surface)) for n in others])
    ranked = np.argsort(-shared, kind="stable")[: np.count_nonzero(shared)]
    if len(ranked) > most:
        ranked = ranked[np.linspace(0, len(ranked) - 1, most).round().astype(int)]
    return [others[k] for k in sorted(ranked)]


def _shown(
    patches: _Patches,
    rows: NDArray[np.intp],
    camera: PhotoCamera,
    other: PhotoCamera,
    surface: SurfaceRays,
) -> NDArray[np.intp]:
    """Of these rows of patches those whose middles another photograph shows, not too steeply."""
    places, normals = patches.middles[rows], patches.normals[rows]
    towards = other.center - places
    distance = np.linalg.norm(towards, axis=1)
    facing = (normals * towards).sum(axis=1) / distance
    own = (normals * (camera.center - places)).sum(axis=1)
    middles, _ = other.project(places)
    inside = np.flatnonzero(
        (middles > 0).all(axis=1)
        & (middles[:, 0] < other.width)
        & (middles[:, 1] < other.height)
        & (np.sign(own) * facing > _LEAST_COSINE)
    )
    if not len(inside):
        return rows[inside]
    met = surface.first_met(other.center, -towards[inside] / distance[inside, None])
    before = np.linalg.norm(met.points - other.center, axis=1)
    return np.asarray(rows[inside[met.found & (before > _NOT_HIDDEN * distance[inside])]])


def _matched(
    reference: NDArray[np.float32],
    target: NDArray[np.float32],
    patches: _Patches,
    camera: PhotoCamera,
    other: PhotoCamera,
    surface: SurfaceRays,
    options: PatchOptions,
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Rows of the patches found again in another photograph, and where: (k, 5).

    The pixel of each patch's middle, and the information on it, xx, xy and yy.
    """
    rows = _shown(patches, np.arange(len(patches.middles)), camera, other, surface)
    if not len(rows):
        return rows, np.zeros((0, 5))
    middles, _ = other.project(patches.middles[rows])
    expected, _ = other.project(patches.places[rows].reshape(-1, 3))
    shifts, correlation, information = patch_shifts(
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
    return rows[good], np.hstack([middles + shifts, information])[good]


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
    model: ColmapModel, parts: list[_Tracks], cameras: Mapping[int, PhotoCamera], half_px: int
) -> PatchedModel:
    before = np.cumsum([0, *(len(part.places) for part in parts)])
    track = np.concatenate(
        [part.patch + start for part, start in zip(parts, before[:-1], strict=True)]
    )
    image = np.concatenate([part.image for part in parts])
    pixels = np.concatenate([part.pixels for part in parts])
    information = np.concatenate([part.information for part in parts])
    images, sure = {}, {}
    place_in_image = np.zeros(len(image), np.int64)
    covered, parts_of_pixels = 0, 0.0
    for n, was in model.images.items():
        own = np.flatnonzero(image == n)
        place_in_image[own] = np.arange(len(own))
        camera, full = cameras[n], model.cameras[was.camera_id]
        enlarged = np.array([full.width / camera.width, full.height / camera.height])
        images[n] = replace(was, points2d=pixels[own] * enlarged, point3d_ids=track[own] + 1)
        sure[n] = information[own]
        overlaps = _overlaps(camera, pixels[own], half_px)
        covered += int((overlaps > 0.5).sum())
        parts_of_pixels += float(overlaps.sum())
    seen = np.column_stack([image, place_in_image])
    ends = np.searchsorted(track, np.arange(before[-1] + 1))
    places = np.concatenate([part.places for part in parts])
    points = {
        number + 1: ColmapPoint(
            number + 1, place, np.full(3, 128, np.uint8), 0.0, seen[ends[number] : ends[number + 1]]
        )
        for number, place in enumerate(places)
    }
    overlap = parts_of_pixels / covered if covered else 1.0
    return PatchedModel(ColmapModel(model.cameras, images, points), sure, overlap)


def _overlaps(
    camera: PhotoCamera, pixels: NDArray[np.float64], half_px: int
) -> NDArray[np.float32]:
    """(h, w) how many patches each pixel is part of, from the pixels (n, 2) of their middles."""
    middles = np.zeros((camera.height, camera.width), np.float32)
    columns, rows = pixels.astype(int).T
    np.add.at(middles, (rows, columns), np.float32(1.0))
    side = 2 * half_px + 1
    return np.asarray(cv2.boxFilter(middles, -1, (side, side), normalize=False), np.float32)
