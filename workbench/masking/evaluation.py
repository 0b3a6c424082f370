"""How wrong masks are, in the terms of the paper's tables.

Source: Jaspe, tables 3.1 and 3.2: percentages are of the number of clutter samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError


@dataclass(frozen=True)
class MaskingErrors:
    """Samples counted over any number of images; add two to join them.

    Attributes
    ----------
    model_samples, clutter_samples : in the truth.
    false_positives : clutter kept.
    false_negatives : model masked away.
    true_false_negatives : of those, the ones no other image covers; None where not known.
    """

    model_samples: int
    clutter_samples: int
    false_positives: int
    false_negatives: int
    true_false_negatives: int | None = None

    @property
    def false_positive_percent(self) -> float:
        return self._of_clutter(self.false_positives)

    @property
    def false_negative_percent(self) -> float:
        return self._of_clutter(self.false_negatives)

    @property
    def true_false_negative_percent(self) -> float | None:
        missing = self.true_false_negatives
        return None if missing is None else self._of_clutter(missing)

    @property
    def iou(self) -> float:
        """Intersection over union of the masks' foregrounds; 1 where both are empty."""
        union = self.model_samples + self.false_positives
        return (self.model_samples - self.false_negatives) / union if union else 1.0

    def __add__(self, other: MaskingErrors) -> MaskingErrors:
        missing = (self.true_false_negatives, other.true_false_negatives)
        known = [count for count in missing if count is not None]
        return MaskingErrors(
            self.model_samples + other.model_samples,
            self.clutter_samples + other.clutter_samples,
            self.false_positives + other.false_positives,
            self.false_negatives + other.false_negatives,
            sum(known) if len(known) == 2 else None,
        )

    def _of_clutter(self, count: int) -> float:
        """Per cent of the clutter; NaN where the truth has none."""
        return 100.0 * count / self.clutter_samples if self.clutter_samples else float("nan")


def masking_errors(
    mask: NDArray[np.uint8],
    truth: NDArray[np.uint8],
    *,
    covered: NDArray[np.bool_] | None = None,
    samples: NDArray[np.bool_] | None = None,
) -> MaskingErrors:
    """Errors of one mask.

    Parameters
    ----------
    mask, truth : (h, w) uint8, 255 = keep.
    covered : (h, w) bool, where another image keeps the same place of the surface.
    samples : (h, w) bool, pixels that count (a range map's returns); all by default.

    Raises
    ------
    InputError : sizes differ.
    """
    for other in (truth, covered, samples):
        if other is not None and other.shape != mask.shape:
            raise InputError(
                "masks to compare must be of the same size",
                expected=str(mask.shape),
                found=str(other.shape),
            )
    counted = np.ones(mask.shape, bool) if samples is None else samples
    kept, model = mask > 127, truth > 127
    missed = counted & model & ~kept
    return MaskingErrors(
        int((counted & model).sum()),
        int((counted & ~model).sum()),
        int((counted & kept & ~model).sum()),
        int(missed.sum()),
        None if covered is None else int((missed & ~covered).sum()),
    )


def joined_errors(errors: Iterable[MaskingErrors]) -> MaskingErrors:
    """All images' samples together, as the paper counts; coverage known if of every image."""
    each = list(errors)
    if not each:
        return MaskingErrors(0, 0, 0, 0)
    total = each[0]
    for more in each[1:]:
        total = total + more
    return total
