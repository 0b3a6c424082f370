"""Fourth pass: the colour of every pixel, out of the photograph of its label."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.stitch_passes import between_texels, corner_colors
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.stitching import Fragments

# Less than half of a texel's surroundings may be used: its colour would be a guess.
_LEAST_COVERAGE = 0.5

Pictures = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class Textured:
    """A picture before levelling.

    Attributes
    ----------
    color : (h, w, 3) float32 sRGB-encoded in [0, 1]; 0 where nothing is.
    label : (h, w) int32 the photograph a colour really comes from, `NO_PHOTO` where it comes
        from the vertices or nothing is.
    seam : (h, w, 3) float32 at borders of labels: what to add for the mean of this place's
        colours, in its own photograph and in those of the neighbours across; NaN elsewhere and
        where the others do not show it.
    """

    color: NDArray[np.float32]
    label: NDArray[np.int32]
    seam: NDArray[np.float32]


def textured(
    shown: Fragments,
    scene: StitchScene,
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
    load: Sequence[int],
) -> Textured:
    """Colour fragments by projecting their positions into the pictures of their labels.

    Parameters
    ----------
    shown : of the stitching pass.
    scene : whose vertices have colours where a picture is left out, or hides the place.
    cameras : of all photographs.
    pictures : photograph → (h, w, 4) uint8 texture picture of its camera's size.
    load : the photographs that may be asked for, in this order.
    """
    color = np.zeros((*shown.label.shape, 3), np.float32)
    label = np.full(shown.label.shape, NO_PHOTO, np.int32)
    flat, place, number = color.reshape(-1, 3), shown.position.reshape(-1, 3), label.reshape(-1)
    beside = _beside_borders(shown)
    others = np.zeros((len(number), 3), np.float32)
    count = np.zeros(len(number), np.float32)
    for photo in load:
        own = np.flatnonzero(shown.label == photo)
        at = np.concatenate([own, beside.get(photo, own[:0])])
        if not len(at):
            continue
        pixels, _ = cameras[photo].project(place[at])
        colors, coverage = between_texels(pictures(photo), pixels)
        good = coverage >= _LEAST_COVERAGE
        mine = good[: len(own)]
        flat[own[mine]] = colors[: len(own)][mine]
        number[own[mine]] = photo
        # A pixel may have several neighbours of one label: each counts.
        theirs = np.flatnonzero(good[len(own) :]) + len(own)
        np.add.at(others, at[theirs], colors[theirs])
        np.add.at(count, at[theirs], np.float32(1.0))
    rest = np.flatnonzero((number == NO_PHOTO) & shown.seen.reshape(-1))
    flat[rest] = corner_colors(
        place[rest],
        shown.triangle.reshape(-1)[rest],
        scene.vertices,
        scene.triangles,
        scene.colors,
    )
    known = (count > 0.0) & (number != NO_PHOTO)
    seam = np.full(others.shape, np.nan, np.float32)
    several = count[known, None]
    seam[known] = (others[known] - several * flat[known]) / (several + np.float32(1.0))
    return Textured(color, label, seam.reshape(color.shape))


def _beside_borders(shown: Fragments) -> dict[int, NDArray[np.intp]]:
    """Photograph → pixels of other labels with a direct neighbour of its, once for each."""
    index = np.arange(shown.label.size).reshape(shown.label.shape)
    pixels, labels = [], []
    deep = np.where(shown.seen, shown.depth, np.float32(0.0))
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        border = (shown.label[one] != shown.label[other]) & shown.seen[one] & shown.seen[other]
        border &= np.abs(deep[one] - deep[other]) <= shown.epsilon
        pixels += [index[one][border], index[other][border]]
        labels += [shown.label[other][border], shown.label[one][border]]
    every, label = np.concatenate(pixels), np.concatenate(labels)
    order = np.argsort(label, kind="stable")
    photos, starts = np.unique(label[order], return_index=True)
    runs = pairwise([*starts.tolist(), len(order)])
    return {
        int(photo): every[order[first:last]]
        for photo, (first, last) in zip(photos, runs, strict=True)
    }
