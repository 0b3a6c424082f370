"""How wrong the masks are, next to a truth: the simulation's, or the user's corrections.

A sample of the object that is masked away is missed for good only where no other scan or
photograph keeps the same place; the others are the price of a clean silhouette.

Source: Jaspe 2018, 3.4.7, tables 3.1 and 3.2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.masking.evaluation import MaskingErrors, joined_errors, masking_errors
from workbench.metrics import Metric


@dataclass(frozen=True)
class MaskedSamples:
    """One scan's samples with what is true of them and what the masks say.

    Attributes
    ----------
    places : (n, 3) float64 in one frame for all scans, metres.
    model : (n,) bool, on the object.
    clutter : (n,) bool, not on it; what is neither does not count.
    automatic, final : (n,) bool, kept by the mask as found, and by the one that is used.
    """

    places: NDArray[np.float64]
    model: NDArray[np.bool_]
    clutter: NDArray[np.bool_]
    automatic: NDArray[np.bool_]
    final: NDArray[np.bool_]


@dataclass(frozen=True)
class CheckedMasks:
    """Errors over all scans or photographs, of the masks as found and as used."""

    automatic: MaskingErrors
    final: MaskingErrors

    def metrics(self, plural: str) -> list[Metric]:
        """Metrics of the masks as used; ``plural`` is ``scans`` or ``photographs``."""
        found = self.final
        missing = found.true_false_negative_percent
        values = [
            ("false_positives", found.false_positive_percent, "Clutter that is kept"),
            ("false_negatives", found.false_negative_percent, "Object that is masked away"),
        ]
        if missing is not None:
            values.append(
                ("true_false_negatives", missing, "Object that is masked away wherever it shows")
            )
        return [
            Metric(f"{plural}_mask_{name}", value, "%", f"{what}, per sample of clutter.")
            for name, value, what in values
        ]


def checked_scan_masks(scans: Sequence[MaskedSamples], radius_m: float) -> CheckedMasks:
    """Errors of range maps' masks.

    Parameters
    ----------
    radius_m : a kept sample of another scan as near as this covers a missed one.
    """
    return CheckedMasks(
        *(
            joined_errors(_scan_errors(scans, [getattr(s, which) for s in scans], radius_m))
            for which in ("automatic", "final")
        )
    )


def _scan_errors(
    scans: Sequence[MaskedSamples], kept: Sequence[NDArray[np.bool_]], radius_m: float
) -> Iterable[MaskingErrors]:
    trees = [cKDTree(s.places[keep]) for s, keep in zip(scans, kept, strict=True)]
    for k, (scan, keep) in enumerate(zip(scans, kept, strict=True)):
        covered = np.zeros(len(keep), bool)
        missed = np.flatnonzero(scan.model & ~keep)
        for other, tree in enumerate(trees):
            open_ones = missed[~covered[missed]]
            if other == k or not tree.n or not len(open_ones):
                continue
            distance, _ = tree.query(scan.places[open_ones], distance_upper_bound=radius_m)
            covered[open_ones] = np.isfinite(distance)
        yield masking_errors(
            _as_mask(keep),
            _as_mask(scan.model),
            covered=covered,
            samples=scan.model | scan.clutter,
        )


def _as_mask(keep: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.where(keep, 255, 0).astype(np.uint8)
