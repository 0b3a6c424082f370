from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.masking.evaluation import joined_errors, masking_errors

TRUTH = np.array([[255, 255, 255, 0, 0]], np.uint8)
MASK = np.array([[255, 0, 0, 255, 0]], np.uint8)


def test_errors_are_counted_as_in_the_tables() -> None:
    covered = np.array([[False, True, False, True, True]])
    errors = masking_errors(MASK, TRUTH, covered=covered)
    assert (errors.model_samples, errors.clutter_samples) == (3, 2)
    assert (errors.false_positives, errors.false_negatives) == (1, 2)
    assert errors.true_false_negatives == 1
    assert errors.false_positive_percent == pytest.approx(50)
    assert errors.false_negative_percent == pytest.approx(100)
    assert errors.true_false_negative_percent == pytest.approx(50)
    assert errors.iou == pytest.approx(1 / 4)


def test_pixels_without_a_sample_do_not_count() -> None:
    errors = masking_errors(MASK, TRUTH, samples=np.array([[1, 0, 0, 0, 1]], bool))
    assert errors.iou == 1.0
    assert errors.true_false_negative_percent is None


def test_errors_of_images_add_up() -> None:
    total = joined_errors([masking_errors(MASK, TRUTH), masking_errors(TRUTH, TRUTH)])
    assert (total.model_samples, total.clutter_samples) == (6, 4)
    assert total.iou == pytest.approx(4 / 7)
    assert joined_errors([]).iou == 1.0


def test_sizes_must_agree() -> None:
    with pytest.raises(InputError, match="same size"):
        masking_errors(MASK, TRUTH[:, 1:])
