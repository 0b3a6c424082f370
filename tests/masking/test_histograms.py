from __future__ import annotations

import numpy as np
import pytest

from tests.masking.scenes import photograph, range_map
from workbench.errors import InputError
from workbench.masking.histograms import (
    Example,
    is_unimodal,
    learned,
    learned_from_clutter,
    separability,
)
from workbench.masking.quantisation import HueSaturationLevels, ReflectanceLevels, ToneLevels


def test_counts_of_a_hand_made_map_are_back_projected() -> None:
    image = np.array([[0.1, 0.1, 0.1, 0.9], [0.9, 0.9, 0.1, np.nan]], np.float32)
    mask = np.array([[0, 0, 255, 255], [255, 255, 0, 255]], np.uint8)
    histogram = learned(ReflectanceLevels(2), [Example(image, mask)], smoothing_bins=0)
    dark, bright = (1 + 0.5) / (4 + 1), (3 + 0.5) / (3 + 1)
    expected = [[dark, dark, dark, bright], [bright, bright, dark, np.nan]]
    np.testing.assert_allclose(histogram.probability(image), expected, rtol=1e-6)


def test_counts_accumulate_over_images() -> None:
    pairs = [Example(*photograph(seed)) for seed in (1, 2)]
    levels = HueSaturationLevels()
    both, first, second = (learned(levels, part, 0) for part in (pairs, pairs[:1], pairs[1:]))
    assert both.foreground is not None
    assert first.foreground is not None
    assert second.foreground is not None
    np.testing.assert_array_equal(both.foreground, first.foreground + second.foreground)
    np.testing.assert_array_equal(both.clutter, first.clutter + second.clutter)


def test_a_pixel_without_hue_is_unknown_not_clutter() -> None:
    histogram = learned(HueSaturationLevels(), [Example(*photograph(1))])
    row = np.array([[[0, 0, 0], [255, 255, 255], [150, 55, 48]]], np.uint8)
    told = histogram.probability(row)
    assert np.isnan(told[0, :2]).all()
    assert told[0, 2] > 0.9


def test_shading_does_not_move_hue_and_saturation() -> None:
    levels = HueSaturationLevels(16)
    bright, dark = np.array([[[200, 100, 50]]], np.uint8), np.array([[[100, 50, 25]]], np.uint8)
    assert levels.bins_of(bright) == levels.bins_of(dark)


def test_smoothing_goes_round_the_hue_circle_and_keeps_the_count() -> None:
    red = np.full((8, 8, 3), (200, 40, 40), np.uint8)
    mask = np.zeros((8, 8), np.uint8)
    mask[:4] = 255
    smooth = learned(HueSaturationLevels(), [Example(red, mask)], 1.0)
    assert smooth.foreground is not None
    hue = smooth.foreground.sum(axis=1)
    assert hue[31] == pytest.approx(hue[1])
    assert hue[31] > 1.0
    assert smooth.foreground.sum() == pytest.approx(32)


def test_clutter_alone_teaches_what_is_not_foreground() -> None:
    image, mask = range_map(3)
    histogram = learned_from_clutter(ReflectanceLevels(), [Example(image, mask)])
    told = histogram.probability(image)
    assert np.nanmean(told[mask > 0]) > 0.8
    assert np.nanmean(told[mask == 0]) < 0.4


def test_separability_is_falsy_for_one_material_only() -> None:
    image, mask = range_map(1)
    levels = ReflectanceLevels()
    apart = separability(learned(levels, [Example(image, mask)]))
    assert apart
    assert apart.overlap < 0.6
    same = np.random.default_rng(0).normal(0.5, 0.1, image.shape).astype(np.float32)
    alike = separability(learned(levels, [Example(same, mask)]))
    assert not alike
    assert alike.overlap > 0.98
    assert "alike" in alike.reason
    assert is_unimodal(levels, [same])


def test_two_materials_are_not_unimodal() -> None:
    rng = np.random.default_rng(0)
    halves = np.where(np.arange(100) < 50, 0.3, 0.7) + rng.normal(0, 0.05, (100, 100))
    assert not is_unimodal(ReflectanceLevels(), [halves])


def test_smooth_and_rough_black_differ_in_tone() -> None:
    rng = np.random.default_rng(0)
    image = np.zeros((64, 128, 3), np.uint8)
    image[:, 64:] = rng.integers(0, 24, (64, 64, 1))
    bins = ToneLevels(3.0).bins_of(image)
    assert not np.intersect1d(bins[:, :40], bins[:, 90:]).size


def test_errors_say_what_is_wrong() -> None:
    image, mask = range_map(1)
    with pytest.raises(InputError, match="as large as its image"):
        Example(image, mask[1:])
    with pytest.raises(InputError, match="no masked examples"):
        learned(ReflectanceLevels(), [])
    with pytest.raises(InputError, match="no foreground"):
        learned(ReflectanceLevels(), [Example(image, np.zeros_like(mask))])
    with pytest.raises(InputError, match="8-bit RGB"):
        HueSaturationLevels().bins_of(image)
