"""Rigid motions that many uncertain correspondences of oriented points agree on.

Two correspondences are compatible when a rigid motion can explain both: the distance of the
two points and the angles of their normals to each other and to the line between them are the
same on both sides. How many others a compatible pair shares (second-order compatibility)
tells right from wrong where most correspondences are wrong, without any drawing of lots.

Sources: Leordeanu and Hebert 2005 (compatibility matrix); Chen et al. 2022, SC²-PCR (second
order); Drost et al. 2010 (pair features of oriented points); Kabsch 1976.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import Matrix4, apply, best_rigid, rotate
from workbench.kernels.compatible_pairs import compatible_pairs

# Histograms' normals are means over a keypoint's cell; of the same place they differ little.
_ANGLE_RAD = float(np.radians(20.0))
# Closer together, correspondences are compatible whatever the motion.
_LEAST_APART = 3.0
_SEEDS, _GROUP, _REFINEMENTS = 25, 24, 4


@dataclass(frozen=True)
class Correspondences:
    """Places of a source that may be those of a target, row by row.

    Attributes
    ----------
    source_points, target_points, source_normals, target_normals : (m, 3) float64, each in
        its own scan's frame; metres and unit.
    """

    source_points: NDArray[np.float64]
    target_points: NDArray[np.float64]
    source_normals: NDArray[np.float64]
    target_normals: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.source_points)


@dataclass(frozen=True)
class Motion:
    """A candidate motion and which correspondences it explains, (m,) bool."""

    target_from_source: Matrix4
    inliers: NDArray[np.bool_]


def agreed_motions(
    found: Correspondences, tolerance_m: float, wanted: int, least: int = 6
) -> list[Motion]:
    """The motions most correspondences agree on, best first.

    Parameters
    ----------
    found : uncertain correspondences, a few thousand at most (memory grows with the square).
    tolerance_m : how far a correspondence explained may miss.
    wanted : motions at most; each explains mostly other correspondences than those before.
    least : correspondences a motion must explain.

    Returns
    -------
    Possibly none; the same input gives the same motions.
    """
    if len(found) < least:
        return []
    compatible = compatible_pairs(
        found.source_points,
        found.source_normals,
        found.target_points,
        found.target_normals,
        tolerance_m,
        _LEAST_APART * tolerance_m,
        _ANGLE_RAD,
    )
    # Whole numbers below 2²⁴ are exact in float32, however the product is summed.
    shared = (compatible @ compatible) * compatible
    order = np.argsort(-shared.sum(axis=1), kind="stable")
    motions: list[Motion] = []
    explained = np.zeros(len(found), bool)
    tried = 0
    for seed in order[shared[order].any(axis=1)]:
        if explained[seed] or tried >= _SEEDS:
            continue
        tried += 1
        group = np.argsort(-shared[seed], kind="stable")[:_GROUP]
        group = np.append(group[shared[seed, group] > 0], seed)
        motion = _refined(found, group, tolerance_m)
        explained[seed] = True
        if motion is None or motion.inliers.sum() < least:
            continue
        new = 2 * int((motion.inliers & ~explained).sum()) > int(motion.inliers.sum())
        explained |= motion.inliers
        if new:
            motions.append(motion)
    motions.sort(key=lambda motion: -int(motion.inliers.sum()))
    return motions[:wanted]


def _refined(found: Correspondences, group: NDArray[np.int64], tolerance_m: float) -> Motion | None:
    for _ in range(_REFINEMENTS):
        if len(group) < 3:
            return None
        motion = best_rigid(found.source_points[group], found.target_points[group])
        gap = apply(motion, found.source_points) - found.target_points
        turned = rotate(motion, found.source_normals)
        near = np.einsum("mi,mi->m", gap, gap) < tolerance_m**2
        facing = np.einsum("mi,mi->m", turned, found.target_normals) > np.cos(1.5 * _ANGLE_RAD)
        inliers = near & facing
        if np.array_equal(np.flatnonzero(inliers), group):
            break
        group = np.flatnonzero(inliers)
    return Motion(motion, inliers)
