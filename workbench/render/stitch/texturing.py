"""Fourth pass: the colour of every pixel, out of the photograph of its label."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
    """

    color: NDArray[np.float32]
    label: NDArray[np.int32]


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
    for photo in load:
        at = np.flatnonzero(shown.label == photo)
        if not len(at):
            continue
        pixels, _ = cameras[photo].project(shown.position.reshape(-1, 3)[at])
        colors, coverage = between_texels(pictures(photo), pixels)
        good = coverage >= _LEAST_COVERAGE
        color.reshape(-1, 3)[at[good]] = colors[good]
        label.reshape(-1)[at[good]] = photo
    rest = np.flatnonzero((label == NO_PHOTO) & shown.seen)
    color.reshape(-1, 3)[rest] = corner_colors(
        shown.position.reshape(-1, 3)[rest],
        shown.triangle.reshape(-1)[rest],
        scene.vertices,
        scene.triangles,
        scene.colors,
    )
    return Textured(color, label)
