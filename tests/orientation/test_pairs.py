"""Of many photographs those are compared that show the same."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tests.orientation.test_features import described
from workbench.orientation.features import PhotoFeatures
from workbench.orientation.pairs import PairSettings, pairs_to_match


def photograph(descriptors: np.ndarray) -> PhotoFeatures:
    n = len(descriptors)
    return PhotoFeatures(
        100, 100, np.zeros((n, 2)), np.zeros(n), descriptors, np.zeros((n, 3), np.uint8)
    )


def walk(count: int, shared: int = 10, step: int = 10) -> list[PhotoFeatures]:
    """Photographs that share features with the two before and after, the first with the last."""
    world = described(count * step, 5)
    return [
        photograph(world[np.arange(k * step, k * step + 3 * shared) % len(world)])
        for k in range(count)
    ]


def one_by_one(function, pairs):  # type: ignore[no-untyped-def]
    return [function(pair) for pair in pairs]


def neighbours(count: int, reach: int) -> set[tuple[int, int]]:
    return {
        (i, j) for i, j in combinations(range(count), 2) if min(j - i, count - (j - i)) <= reach
    }


def test_a_small_set_is_compared_all_with_all() -> None:
    assert pairs_to_match(walk(6), PairSettings(), one_by_one) == list(combinations(range(6), 2))


def test_a_walk_round_is_compared_with_its_neighbours_and_closed() -> None:
    settings = PairSettings(next_in_order=0)
    found = pairs_to_match(walk(30), settings, one_by_one)
    assert found == sorted(neighbours(30, 2))


def test_what_follows_in_order_is_compared_whatever_it_looks_like() -> None:
    strangers = [photograph(described(40, seed)) for seed in range(25)]
    found = pairs_to_match(strangers, PairSettings(next_in_order=3), one_by_one)
    assert found == [(i, j) for i, j in combinations(range(25), 2) if j - i <= 3]


def test_a_large_set_is_sifted_twice_and_loses_nothing() -> None:
    looked_at: list[int] = []

    def counting(function, pairs):  # type: ignore[no-untyped-def]
        looked_at.append(len(pairs))
        return one_by_one(function, pairs)

    settings = PairSettings(next_in_order=0, sketch_above=20, sketch_features=25, sketch_partners=8)
    found = pairs_to_match(walk(60), settings, counting)
    assert found == sorted(neighbours(60, 2))
    first, second = looked_at
    assert first == 60 * 59 // 2
    assert second < first // 3


def test_photographs_without_features_are_no_obstacle() -> None:
    photos = walk(24)
    photos[5] = photograph(np.zeros((0, 128), np.uint8))
    found = pairs_to_match(photos, PairSettings(next_in_order=0), one_by_one)
    assert all(5 not in pair for pair in found)
