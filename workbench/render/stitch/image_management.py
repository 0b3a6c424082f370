"""Second pass: which photographs a picture needs, and which of them fit in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.photo_camera import PhotoCamera

_BYTES_PER_PIXEL = 4


@dataclass(frozen=True)
class PicturePlan:
    """Photographs by relevance: how many pixels each colours.

    Attributes
    ----------
    load : photographs to have in memory, the most relevant first.
    left_out : those that do not fit; colours of vertices stand in for them.
    pixels : photograph → how many pixels show it.
    """

    load: tuple[int, ...]
    left_out: tuple[int, ...]
    pixels: dict[int, int]

    @property
    def share_left_out(self) -> float:
        """Share of the pixels with a photograph whose photograph is left out, in [0, 1]."""
        missing = sum(self.pixels[label] for label in self.left_out)
        return missing / max(sum(self.pixels.values()), 1)


def picture_plan(
    labels: NDArray[np.int32], cameras: Sequence[PhotoCamera], budget_bytes: int
) -> PicturePlan:
    """Histogram of the labels, and what to load for them.

    Parameters
    ----------
    labels : (h, w) of the visibility pass, or of the stitching pass, which needs nothing else.
    cameras : of all photographs; they tell the size of the pictures.
    budget_bytes : how much the pictures may take together. One that does not fit is passed over
        for smaller ones of less relevance.

    Raises
    ------
    InputError : a label has no photograph.
    """
    counts = np.bincount(labels[labels >= 0])
    if len(counts) > len(cameras):
        raise InputError(
            "a mesh is labelled with a photograph that is not there",
            expected=f"labels below {len(cameras)}",
            found=str(len(counts) - 1),
            fix="run texture again: photographs were taken away since",
        )
    load, left_out, free = [], [], budget_bytes
    for label in sorted(np.flatnonzero(counts).tolist(), key=lambda k: (-counts[k], k)):
        size = cameras[label].width * cameras[label].height * _BYTES_PER_PIXEL
        if size <= free:
            free -= size
            load.append(label)
        else:
            left_out.append(label)
    pixels = {label: int(counts[label]) for label in (*load, *left_out)}
    return PicturePlan(tuple(load), tuple(left_out), pixels)
