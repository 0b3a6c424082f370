"""How much of what photographs share was scanned."""

from __future__ import annotations

import numpy as np

from workbench.stereo.choice import SeenPoints
from workbench.stereo.coverage import ScannedPlaces, held_shares

RNG = np.random.default_rng(3)


def plate(count: int, left: float, right: float, height: float = 0.0) -> np.ndarray:
    flat = RNG.uniform((left, 0.0), (right, 1.0), (count, 2))
    return np.column_stack([flat, np.full(count, height)])


def shares_of(points: np.ndarray, seen: np.ndarray) -> dict[str, float | None]:
    scanned = ScannedPlaces.of([plate(20_000, 0.0, 0.5), plate(20_000, 0.3, 1.0)])
    names = tuple("abc"[: seen.shape[1]])
    return held_shares(SeenPoints(names, points, seen), scanned)


def test_points_on_the_scans_are_held_and_those_before_them_not() -> None:
    on, before = plate(400, 0.0, 1.0), plate(100, 0.0, 1.0, 0.1)
    seen = np.zeros((500, 3), bool)
    seen[:400, 0] = True
    seen[:, 1] = True
    seen[:10, 2] = True
    shares = shares_of(np.concatenate([on, before]), seen)
    # Before the plate, in line with it as a camera sees them: a column before a wall.
    assert shares == {"a": 1.0, "b": 0.8, "c": None}


def test_points_far_off_do_not_count() -> None:
    points = np.concatenate([plate(300, 0.0, 1.0), plate(300, 0.0, 1.0, 5.0)])
    assert shares_of(points, np.ones((600, 1), bool)) == {"a": 1.0}


def test_points_scatter() -> None:
    """Ten times as far as samples are apart, as points of photographs do over dense scans."""
    points = plate(2000, 0.0, 1.0)
    points[:, 2] += RNG.normal(0.0, 0.012, len(points))
    share = shares_of(points, np.ones((2000, 1), bool))["a"]
    assert share is not None
    assert share > 0.95


def test_without_scans_nothing_is_told() -> None:
    assert ScannedPlaces.of([np.zeros((0, 3)), np.zeros((1, 3))]) is None
    seen = SeenPoints(("a",), np.zeros((40, 3)), np.ones((40, 1), bool))
    assert held_shares(seen, None) == {"a": None}
