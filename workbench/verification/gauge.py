"""Bringing a simulated truth into the frame of the estimate.

Scans fix each other, not the world: a whole model may sit a little off where its anchor's
coarse pose was off. The rigid motion that brings the estimated scan poses closest to the
true ones is that freedom; it is taken out, and told, before anything is compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import Matrix4, apply, best_rigid, inverse, rotation_angle_deg
from workbench.metrics import Metric


@dataclass(frozen=True)
class PoseComparison:
    """Estimated against true scan poses.

    Attributes
    ----------
    estimate_from_truth : 4×4, the common motion that was taken out.
    rotation_deg, translation_m : (n,) what is left per scan; the translation at the scan's
        centre, where it matters.
    """

    estimate_from_truth: Matrix4
    rotation_deg: NDArray[np.float64]
    translation_m: NDArray[np.float64]

    def metrics(self) -> list[Metric]:
        """Median and worst pose error."""
        return [
            Metric("pose_rotation_error_median", float(np.median(self.rotation_deg)), "deg",
                   "Median error of a scan's orientation, common motion taken out."),
            Metric("pose_rotation_error_worst", float(self.rotation_deg.max()), "deg",
                   "Largest error of a scan's orientation."),
            Metric("pose_translation_error_median", float(np.median(self.translation_m)), "m",
                   "Median error of a scan's place at its centre."),
            Metric("pose_translation_error_worst", float(self.translation_m.max()), "m",
                   "Largest error of a scan's place."),
            Metric("gauge_rotation", rotation_angle_deg(self.estimate_from_truth), "deg",
                   "Common rotation of all scans, which scans alone cannot know."),
        ]  # fmt: skip


def compare_poses(
    estimate: Mapping[str, Matrix4],
    truth: Mapping[str, Matrix4],
    centres_in_scan: Mapping[str, NDArray[np.float64]],
    extent_m: float,
) -> PoseComparison:
    """Compare two sets of ``world_from_scan`` up to one common rigid motion.

    Parameters
    ----------
    estimate, truth : poses of the same scans, both near the origin of their frame.
    centres_in_scan : (3,) middle of every scan in its own frame.
    extent_m : size of a scan; how rotations and translations are weighed.
    """
    names = sorted(estimate)
    corners = 0.5 * extent_m * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1.0]])
    estimated = np.concatenate([apply(estimate[n], centres_in_scan[n] + corners) for n in names])
    true = np.concatenate([apply(truth[n], centres_in_scan[n] + corners) for n in names])
    common = best_rigid(true, estimated)
    rotation, translation = [], []
    for name in names:
        moved = common @ truth[name]
        rotation.append(rotation_angle_deg(inverse(moved) @ estimate[name]))
        centre = centres_in_scan[name]
        translation.append(np.linalg.norm(apply(estimate[name], centre) - apply(moved, centre)))
    return PoseComparison(common, np.array(rotation), np.array(translation))
