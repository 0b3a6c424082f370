"""Which images' masks would teach most: those that look least like one another."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.masking.classifier import at_side
from workbench.masking.quantisation import (
    UNKNOWN,
    HueSaturationLevels,
    Quantiser,
    ReflectanceLevels,
    ToneLevels,
)

_SIDE_PX = 200


def signature(image: NDArray[np.generic]) -> NDArray[np.float64]:
    """What an image shows, as a point whose squared distances are 2 − 2 × Bhattacharyya.

    Roots of the normalised histograms of appearance and of tone, unknown pixels counted too.
    """
    small = at_side(image, _SIDE_PX)
    appearance: Quantiser = HueSaturationLevels(16) if small.ndim == 3 else ReflectanceLevels(32)
    parts = []
    for quantiser in (appearance, ToneLevels(3.0, 16)):
        bins = quantiser.bins_of(small).ravel() - UNKNOWN
        counts = np.bincount(bins, minlength=int(np.prod(quantiser.shape)) + 1)
        parts.append(np.sqrt(counts / counts.sum()))
    return np.asarray(np.concatenate(parts) / np.sqrt(len(parts)), np.float64)


def suggested(images: Iterable[NDArray[np.generic]], wanted: int) -> list[int]:
    """Indices of the images to mask, the most useful first (farthest-point choice).

    Begins with the image most like all others, so that one mask alone is a good start.

    Raises
    ------
    InputError : fewer than one wanted, or no images.
    """
    points = [signature(image) for image in images]
    if wanted < 1 or not points:
        raise InputError("name at least one of at least one image to mask")
    table = np.array(points)
    distance = np.maximum(2.0 - 2.0 * table @ table.T, 0.0)
    chosen = [int(np.argmin(distance.sum(axis=1)))]
    while len(chosen) < min(wanted, len(points)):
        apart = distance[:, chosen].min(axis=1)
        apart[chosen] = -1.0
        chosen.append(int(np.argmax(apart)))
    return chosen
