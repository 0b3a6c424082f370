"""What one photograph says of the samples it sees: their colour as it is, and its weight."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_view import Block, PhotoView
from workbench.kernels.photo_buffers import between_pixels

_LEAST_WEIGHT = 1e-6
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Observations:
    """Samples that a photograph sees.

    Attributes
    ----------
    index : (m,) int64 which samples, rising.
    values : (m, 3) float32 linear, as photographed.
    normals : (m, 3) float32 in the camera's frame, as smooth as the view's.
    weights : (m,) float32 > 0, without the flash's part in it.
    """

    index: NDArray[np.int64]
    values: NDArray[np.float32]
    normals: NDArray[np.float32]
    weights: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.index)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Observations:
        """What `arrays` told."""
        return cls(**{name: arrays[name] for name in cls.__dataclass_fields__})

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.integer] | slice) -> Observations:
        """Some of them."""
        return Observations(**{name: values[which] for name, values in self.arrays().items()})


@dataclass(frozen=True)
class WeighedPhoto:
    """A photograph ready to be asked for samples.

    Attributes
    ----------
    view : its buffers, normals smoothed.
    pyramid : the picture times ``usable``, and ``usable``, (h, w, 4) float32, each half the
        size of the one before.
    weights : (h, w) float32 of its pixels.
    """

    view: PhotoView
    pyramid: tuple[NDArray[np.float32], ...]
    weights: NDArray[np.float32]


def weighed_photo(
    view: PhotoView,
    picture: NDArray[np.float32],
    usable: NDArray[np.bool_],
    weights: NDArray[np.float32],
    coarsest: float,
) -> WeighedPhoto:
    """Make a photograph ready.

    Parameters
    ----------
    picture : (h, w, 3) linear.
    usable : (h, w); other pixels never reach a sample.
    weights : (h, w).
    coarsest : the largest spacing of samples, in pixels.
    """
    told = usable & view.seen & np.isfinite(picture).all(axis=2)
    level = np.empty((*told.shape, 4), np.float32)
    level[..., :3] = np.where(told[..., None], picture, np.float32(0.0))
    level[..., 3] = told
    pyramid = [level]
    while min(level.shape[:2]) > 2 and 2.0 ** len(pyramid) < coarsest:
        level = _halved(level)
        pyramid.append(level)
    return WeighedPhoto(view, tuple(pyramid), weights)


def observed(photo: WeighedPhoto, blocks: Iterable[Block]) -> Observations:
    """What a photograph says of the samples of some blocks, in their order.

    A sample's colour is the mean of the pixels it stands for: between pixels where samples are
    denser than pixels, over several where pixels are denser. Resolution is part of the weight: a
    photograph whose pixels are coarser than the samples counts less.
    """
    found = [_observed(photo, block) for block in blocks]
    empty = Observations(
        np.zeros(0, np.int64), *(np.zeros(s, np.float32) for s in ((0, 3), (0, 3), 0))
    )
    parts = [part for part in found if len(part)] or [empty]
    return Observations(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in Observations.__dataclass_fields__
        }
    )


def _observed(photo: WeighedPhoto, block: Block) -> Observations:
    view = photo.view
    pixels, depths = view.camera.project(block.points)
    # The back of a thin wall lies as near to what is seen as its front, but faces away.
    facing = (block.normals * (view.camera.center - block.points)).sum(axis=1) > 0.0
    seen = np.flatnonzero(facing & view.which_are_seen(pixels, depths))
    pixels, depths = pixels[seen], depths[seen]
    footprint = depths / view.focal_px
    spacing_px = block.spacing[seen] / footprint
    mixed = _over_pixels(photo.pyramid, pixels, spacing_px)
    weights = between_pixels(photo.weights[..., None], pixels)[:, 0]
    cosine = between_pixels(view.cosines[..., None], pixels)[:, 0]
    # The pixel's longer side on the surface, against what a sample stands for.
    coarseness = 1.0 / np.maximum(spacing_px * np.maximum(cosine, 0.05), 1e-6)
    weights /= 1.0 + coarseness**2
    share = mixed[:, 3]
    good = (weights > _LEAST_WEIGHT) & (share > _LEAST_SHARE)
    normals = between_pixels(view.normals, pixels)[good]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Observations(
        (block.first + seen[good]).astype(np.int64),
        (mixed[good, :3] / share[good, None]).astype(np.float32),
        (normals / np.maximum(length, 1e-12)).astype(np.float32),
        weights[good].astype(np.float32),
    )


def _over_pixels(
    pyramid: tuple[NDArray[np.float32], ...],
    pixels: NDArray[np.float64],
    spacing_px: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Means (n, 4) about pixels (n, 2) over squares of sides ``spacing_px`` (n,)."""
    level = np.clip(np.log2(np.maximum(spacing_px, 1.0)), 0.0, len(pyramid) - 1.0)
    lower = np.minimum(level.astype(np.int64), max(len(pyramid) - 2, 0))
    part = (level - lower)[:, None]
    mixed = np.zeros((len(pixels), 4))
    for k, picture in enumerate(pyramid):
        for which, share in ((lower == k, 1.0 - part), (lower + 1 == k, part)):
            if which.any():
                mixed[which] += share[which] * between_pixels(picture, pixels[which] / 2.0**k)
    return mixed


def _halved(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means of 2 × 2 pixels; an odd last row or column is joined by one of nothing."""
    height, width = level.shape[:2]
    even = np.pad(level, ((0, height % 2), (0, width % 2), (0, 0)))
    return np.asarray(
        0.25 * (even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2]),
        np.float32,
    )
