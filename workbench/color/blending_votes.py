"""What most photographs say of a sample, whatever a few of them say."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_colors import Colored

OBSERVATIONS_AT_ONCE = 20_000_000
_VOTE = 0.25


def median_levels(
    photos: Iterable[Colored], counts: NDArray[np.integer], at_once: int = OBSERVATIONS_AT_ONCE
) -> NDArray[np.float64]:
    """Weighted median (n,) of the levels over photographs; NaN where none tells.

    A photograph's vote is the fourth root of its weight: the best view, which is a hundred times
    better than a slanting one, shall not decide alone. Between two of equal vote the darker
    wins, for what strays most is a highlight.

    Parameters
    ----------
    photos : iterated once for every ``at_once`` observations; one is held at a time.
    counts : (n,) photographs that tell each sample.
    """
    medians = np.full(len(counts), np.nan)
    through = np.cumsum(counts, dtype=np.int64)
    first = 0
    while first < len(counts):
        before = through[first - 1] if first else 0
        last = max(int(np.searchsorted(through, before + at_once, side="right")), first + 1)
        medians[first:last] = _medians(photos, first, last)
        first = last
    return medians


def _medians(photos: Iterable[Colored], first: int, last: int) -> NDArray[np.float64]:
    """Of samples in [first, last)."""
    samples, levels, votes = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros(0)]
    for photo in photos:
        part = photo.within(first, last)
        told = part.weights > 0.0
        samples.append(part.index[told])
        levels.append(part.levels[told])
        votes.append(part.weights[told] ** _VOTE)
    sample, level, vote = (np.concatenate(parts) for parts in (samples, levels, votes))
    order = np.lexsort((level, sample))
    sample, level, vote = sample[order], level[order], vote[order]
    total = np.bincount(sample, vote, last - first)
    counted = np.cumsum(vote) - np.append(0.0, np.cumsum(total))[sample]
    enough = counted >= (0.5 - 1e-9) * total[sample]
    found = np.flatnonzero(enough)
    medians = np.full(last - first, np.nan)
    # Written backwards, so that the first of each sample with half the votes is what stays.
    medians[sample[found[::-1]]] = level[found[::-1]]
    return medians
