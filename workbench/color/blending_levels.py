"""Photographs brought to one level where nothing else tells how strong their light was."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending import BlendSums
from workbench.color.blending_colors import Colored


def leveled_gains(photos: Iterable[Colored], count: int, rounds: int = 8) -> NDArray[np.float64]:
    """What to divide each photograph's colours by so that they agree where they overlap.

    Relative to their geometric mean. A photograph that overlaps no other has gain 1.

    Parameters
    ----------
    photos : iterated once per round and once more; only one is held at a time.
    count : number of samples.
    rounds : of finding means with gains held, and gains with means held.
    """
    log_gains: NDArray[np.float64] = np.zeros(0)
    for _ in range(rounds):
        sums = BlendSums(count)
        for number, photo in enumerate(photos):
            sums.add(_divided(photo, log_gains[number] if len(log_gains) else 0.0))
        log_gains = np.log(gains_against(photos, sums, least_photos=2))
        log_gains -= log_gains.mean() if len(log_gains) else 0.0
    return np.exp(log_gains)


def gains_against(
    photos: Iterable[Colored], sums: BlendSums, least_photos: int = 1
) -> NDArray[np.float64]:
    """By what each photograph is lighter than what was blended, the median of what it sees.

    1 for a photograph that sees nothing of it.

    Parameters
    ----------
    least_photos : fewer photographs than that tell too little of a sample.
    """
    gains = []
    means, enough = sums.mean_levels, sums.photos >= least_photos
    for photo in photos:
        shared = enough[photo.index] & (photo.weights > 0.0)
        apart = photo.levels[shared] - means[photo.index[shared]]
        gains.append(float(np.exp(np.median(apart))) if len(apart) else 1.0)
    return np.array(gains)


def _divided(photo: Colored, log_gain: float) -> Colored:
    return Colored(photo.index, photo.colors / np.exp(log_gain), photo.weights)
