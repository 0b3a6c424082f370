"""Which photographs are compared with which.

A few coarse features of two photographs tell whether they show the same (preemptive
matching: Wu 2013, "Towards Linear-time Incremental Structure from Motion", section 3):
features of large scale are seen from afar and from the side, and an eighth of all costs a
sixtieth of the time. Large sets are sifted twice, with fewer still the first time. No
vocabulary is needed, which would have to be learnt from photographs of other things.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from workbench.orientation.features import PhotoFeatures
from workbench.orientation.matching import MatchSettings, matched

Pair = tuple[int, int]
Mapper = Callable[[Callable[[Pair], int], Sequence[Pair]], list[int]]

# Among few features chance finds as clear a second best as among many; so it must be clearer.
_COARSE = MatchSettings(max_ratio=0.7)
_SKETCH = MatchSettings(max_ratio=0.8)


@dataclass(frozen=True)
class PairSettings:
    """Which pairs are compared in full.

    Attributes
    ----------
    exhaustive_below : sets of fewer photographs are compared all with all.
    coarse_features : of each photograph, that are compared first.
    coarse_matches : of them that make a pair worth a full comparison.
    next_in_order : a photograph is compared with so many that follow, whatever they look like.
    sketch_above : in sets of more photographs, ``sketch_features`` of each choose its
        ``sketch_partners`` before the coarse features are looked at.
    """

    exhaustive_below: int = 20
    coarse_features: int = 1000
    coarse_matches: int = 4
    next_in_order: int = 2
    sketch_above: int = 200
    sketch_features: int = 200
    sketch_partners: int = 60


def pairs_to_match(
    features: Sequence[PhotoFeatures], settings: PairSettings, over: Mapper
) -> list[Pair]:
    """Pairs of photographs (i, j), i < j, that probably overlap, in rising order.

    Parameters
    ----------
    features : of all photographs, in the order in which they were taken where that is known.
    settings : which pairs are compared in full.
    over : maps a function over pairs, in parallel perhaps, and keeps their order.
    """
    count = len(features)
    pairs = list(combinations(range(count), 2))
    if count < settings.exhaustive_below:
        return pairs
    if count > settings.sketch_above:
        likeness = over(_likeness(features, settings.sketch_features, _SKETCH), pairs)
        pairs = sorted(_best_partners(pairs, likeness, count, settings.sketch_partners))
    likeness = over(_likeness(features, settings.coarse_features, _COARSE), pairs)
    chosen = {
        pair
        for pair, alike in zip(pairs, likeness, strict=True)
        if alike >= settings.coarse_matches
    }
    for step in range(1, settings.next_in_order + 1):
        chosen.update((i, i + step) for i in range(count - step))
    return sorted(chosen)


def _likeness(
    features: Sequence[PhotoFeatures], count: int, matching: MatchSettings
) -> Callable[[Pair], int]:
    """How many of the coarsest features of two photographs match."""
    coarsest = [one.descriptors[:count] for one in features]
    return lambda pair: len(matched(coarsest[pair[0]], coarsest[pair[1]], matching))


def _best_partners(
    pairs: Sequence[Pair], likeness: Sequence[int], count: int, partners: int
) -> set[Pair]:
    """Pairs that are among the likest of one of their two photographs."""
    alike = np.zeros((count, count), np.int64)
    first, second = np.array(pairs).T
    alike[first, second] = alike[second, first] = likeness
    # Equals are taken in the order of the photographs.
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, :partners]
    return {
        (min(i, j), max(i, j))
        for i, others in enumerate(nearest.tolist())
        for j in others
        if alike[i, j] > 0
    }
