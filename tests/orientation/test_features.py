"""Features lie where the picture has them, inside the mask, and match as they should."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.orientation.features import DESCRIPTOR_NORM, FeatureSettings, features_of
from workbench.orientation.matching import MatchSettings, matched
from workbench.orientation.photographs import PhotoToOrient

# Centres of round spots, where the centre of the upper left pixel is (0.5, 0.5).
SPOTS = np.array([[60.5, 50.5], [150.25, 120.75], [251.0, 60.4], [90.0, 171.3]])
SPREAD_PX = 6.0


def spotted(width: int = 320, height: int = 240) -> np.ndarray:
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    light = np.zeros((height, width))
    for u, v in SPOTS:
        light += np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * SPREAD_PX**2))
    return np.repeat((40 + 200 * light).astype(np.uint8)[..., None], 3, axis=2)


def nearest_gaps(points: np.ndarray, spots: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[None] - spots[:, None], axis=2).min(axis=1)


def test_spots_are_found_at_their_centres() -> None:
    found = features_of(PhotoToOrient("a", spotted()), FeatureSettings())
    # A half pixel, the difference between conventions, would be far outside.
    assert nearest_gaps(found.points, SPOTS).max() < 0.12
    assert (found.width, found.height) == (320, 240)


def test_a_reduced_picture_gives_places_on_the_full_one() -> None:
    found = features_of(PhotoToOrient("a", spotted()), FeatureSettings(max_image_px=160))
    assert nearest_gaps(found.points, SPOTS).max() < 0.25
    full = features_of(PhotoToOrient("a", spotted()), FeatureSettings())
    spot = np.argmin(np.linalg.norm(full.points - SPOTS[0], axis=1))
    twin = np.argmin(np.linalg.norm(found.points - SPOTS[0], axis=1))
    assert found.scales[twin] == pytest.approx(full.scales[spot], rel=0.1)


def test_a_mask_keeps_what_is_inside_at_its_place() -> None:
    mask = np.zeros((240, 320), np.uint8)
    mask[100:200, 60:200] = 255
    for settings in (FeatureSettings(), FeatureSettings(max_image_px=240)):
        found = features_of(PhotoToOrient("a", spotted(), mask=mask), settings)
        x, y = found.points.T
        assert nearest_gaps(found.points, SPOTS[[1, 3]]).max() < 0.25
        assert ((x > 59) & (x < 201) & (y > 99) & (y < 201)).all()


def test_clutter_outside_the_mask_takes_no_places() -> None:
    rng = np.random.default_rng(0)
    picture = spotted()
    picture[:, 200:] = rng.integers(0, 255, picture[:, 200:].shape)
    mask = np.zeros(picture.shape[:2], np.uint8)
    mask[:, :180] = 255
    found = features_of(PhotoToOrient("a", picture, mask=mask), FeatureSettings(max_features=60))
    assert nearest_gaps(found.points, SPOTS[[0, 1, 3]]).max() < 0.12


def test_the_strongest_are_kept_and_the_coarsest_come_first() -> None:
    rng = np.random.default_rng(0)
    picture = np.repeat(rng.integers(0, 255, (200, 200, 1)), 3, axis=2).astype(np.uint8)
    picture[50:150, 50:150] = spotted()[0:100, 10:110]
    all_of_them = features_of(PhotoToOrient("a", picture), FeatureSettings())
    few = features_of(PhotoToOrient("a", picture), FeatureSettings(max_features=50))
    assert len(few.points) == 50 < len(all_of_them.points)
    assert (np.diff(all_of_them.scales) <= 0).all()
    assert {tuple(p) for p in few.points.tolist()} <= {
        tuple(p) for p in all_of_them.points.tolist()
    }
    lengths = np.linalg.norm(all_of_them.descriptors.astype(float), axis=1)
    np.testing.assert_allclose(lengths, DESCRIPTOR_NORM, atol=12)


def test_nothing_to_see_gives_no_features() -> None:
    blank = PhotoToOrient("a", np.full((50, 60, 3), 9, np.uint8))
    masked = PhotoToOrient("a", spotted(), mask=np.zeros((240, 320), np.uint8))
    for photo in (blank, masked):
        found = features_of(photo, FeatureSettings())
        assert found.points.shape == (0, 2)
        assert found.descriptors.shape == (0, 128)


def described(count: int, seed: int) -> np.ndarray:
    shares = np.random.default_rng(seed).dirichlet(np.full(128, 0.3), count)
    return np.minimum(np.rint(DESCRIPTOR_NORM * np.sqrt(shares)), 255).astype(np.uint8)


def reference_matches(a: np.ndarray, b: np.ndarray, settings: MatchSettings) -> list[list[int]]:
    """One by one, in float64."""
    cosines = np.array([[(x.astype(float) * y).sum() / DESCRIPTOR_NORM**2 for y in b] for x in a])
    gaps = np.sqrt(np.maximum(2 - 2 * cosines, 0))
    found = []
    for i, row in enumerate(gaps):
        first, second = np.argsort(row)[:2]
        if (
            row[first] < settings.max_ratio * row[second]
            and row[first] < settings.max_distance
            and np.argmin(gaps[:, first]) == i
        ):
            found.append([i, int(first)])
    return found


@pytest.mark.parametrize(("count_a", "count_b"), [(90, 120), (1500, 40)])
def test_matches_are_the_mutual_and_clear_ones(count_a: int, count_b: int) -> None:
    a, b = described(count_a, 1), described(count_b, 2)
    rng = np.random.default_rng(3)
    rows = rng.permutation(min(count_a, count_b))[:30]
    noise = rng.integers(-6, 7, (30, 128))
    b[:30] = np.clip(a[rows].astype(int) + noise, 0, 255)
    b[-1] = b[0]  # a twin, so neither of the two is clear
    settings = MatchSettings()
    expected = reference_matches(a, b, settings)
    assert 20 < len(expected) < 40
    assert matched(a, b, settings).tolist() == expected


def test_few_descriptors_match_nothing() -> None:
    some = described(5, 0)
    assert matched(some[:0], some, MatchSettings()).shape == (0, 2)
    assert matched(some, some[:1], MatchSettings()).shape == (0, 2)
