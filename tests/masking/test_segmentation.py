from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.masking.scenes import photograph, range_map, range_map_channels
from workbench.errors import InputError, SettingsError
from workbench.masking.classifier import ClassifierOptions, trained
from workbench.masking.evaluation import masking_errors
from workbench.masking.histograms import Example
from workbench.masking.rectangle import segmented_in_rectangle
from workbench.masking.segmentation import (
    SegmentationOptions,
    octagon,
    segmented,
)
from workbench.masking.suggestion import suggested

BARE = SegmentationOptions(median_px=0, erosion_px=0)


def test_photograph_is_masked_after_one_example() -> None:
    classifier = trained([Example(*photograph(1))])
    image, truth = photograph(2, centre=(0.45, 0.55))
    mask = segmented(image, classifier.probability(image), BARE)
    assert masking_errors(mask, truth).iou > 0.98


def test_range_map_is_masked_better_than_by_threshold() -> None:
    classifier = trained([Example(*range_map(1))], ClassifierOptions(tone_sigmas_px=()))
    image, truth = range_map(2)
    probability = classifier.probability(image)
    rough = np.where(np.nan_to_num(probability) > 0.5, 255, 0).astype(np.uint8)
    channels = range_map_channels(image, np.where(truth > 0, 2.0, 3.0))
    mask = segmented(channels, probability, BARE)
    assert masking_errors(mask, truth).iou > max(0.96, masking_errors(rough, truth).iou)


def test_finer_levels_recover_the_boundary_of_a_large_photograph() -> None:
    image, truth = photograph(1, 1600)
    classifier = trained([Example(image, truth)], ClassifierOptions(working_side_px=100, trees=0))
    probability = classifier.probability(image)

    def iou(levels: int) -> float:
        options = SegmentationOptions(
            "grabcut", coarse_side_px=100, finer_levels=levels, median_px=0, erosion_px=0
        )
        return masking_errors(segmented(image, probability, options), truth).iou

    coarse, fine = iou(0), iou(4)
    assert 1 - fine < 0.6 * (1 - coarse)
    assert fine > 0.99


def test_same_input_gives_the_same_mask_whatever_was_drawn_before() -> None:
    image, truth = photograph(1)
    probability = trained([Example(image, truth)]).probability(image)
    first = segmented(image, probability)
    cv2.setRNGSeed(77)
    np.testing.assert_array_equal(segmented(image, probability), first)


def test_unknown_pixels_follow_their_neighbours() -> None:
    image, truth = photograph(1)
    probability = np.where(truth > 0, 0.9, 0.1).astype(np.float32)
    probability[100:130, 100:130] = np.nan
    assert segmented(image, probability, BARE)[100:130, 100:130].all()


def test_erosion_is_an_octagon_that_spares_the_frame() -> None:
    image, truth = photograph(1, centre=(0.0, 0.5))
    probability = np.where(truth > 0, 0.99, 0.01).astype(np.float32)
    whole = segmented(image, probability, BARE)
    eroded = segmented(image, probability, SegmentationOptions(median_px=0, erosion_px=4))
    middle = len(whole) // 2
    assert np.count_nonzero(whole[middle]) - np.count_nonzero(eroded[middle]) == 4
    assert eroded[middle, 0] == 255
    expected = np.ones((9, 9), np.uint8)
    for corner in (expected, expected[::-1], expected[:, ::-1], expected[::-1, ::-1]):
        corner[0, :2] = corner[1, :1] = 0
    np.testing.assert_array_equal(octagon(4), expected)


def test_nothing_to_keep_is_an_empty_mask() -> None:
    image, _ = photograph(1)
    assert not segmented(image, np.zeros(image.shape[:2], np.float32)).any()


def test_rectangle_finds_the_disc() -> None:
    image, truth = photograph(5)
    mask = segmented_in_rectangle(image, (40, 40, 200, 200), BARE)
    assert masking_errors(mask, truth).iou > 0.97
    with pytest.raises(InputError, match="lie in the image"):
        segmented_in_rectangle(image, (40, 40, 300, 200))
    with pytest.raises(InputError, match="whole image"):
        segmented_in_rectangle(image, (0, 0, 240, 240))


def test_options_out_of_bounds_are_refused() -> None:
    with pytest.raises(SettingsError, match="odd"):
        SegmentationOptions(median_px=4)
    with pytest.raises(SettingsError, match="iteration"):
        SegmentationOptions(iterations=0)
    with pytest.raises(InputError, match="three channels"):
        segmented(np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.float32))


def test_real_photographs_after_three_masks(shared_data: Callable[..., Path]) -> None:
    root = shared_data("dtu-scan37")
    images, masks = [], []
    for number in range(0, 49, 4):
        photo = cv2.imread(str(root / "photos" / f"{number:06d}.jpg"), cv2.IMREAD_REDUCED_COLOR_2)
        mask = cv2.imread(str(root / "masks" / f"{number:03d}.png"), cv2.IMREAD_GRAYSCALE)
        assert photo is not None
        assert mask is not None
        images.append(cv2.cvtColor(photo, cv2.COLOR_BGR2RGB))
        masks.append(cv2.resize(mask, photo.shape[1::-1], interpolation=cv2.INTER_NEAREST))
    shown = suggested(images, 3)
    classifier = trained([Example(images[n], masks[n]) for n in shown])
    rest = [n for n in range(len(images)) if n not in shown]
    rough, found = [], []
    for n in rest:
        probability = classifier.probability(images[n])
        mask = segmented(images[n], probability, BARE)
        found.append(masking_errors(mask, masks[n]).iou)
        large = cv2.resize(probability, images[n].shape[1::-1])
        threshold = np.where(large > 0.5, 255, 0).astype(np.uint8)
        rough.append(masking_errors(threshold, masks[n]).iou)
    assert np.mean(found) > 0.96
    assert np.mean(found) > np.mean(rough) + 0.01
