"""Spreading what is left of the loops over all links: the pose graph in its least-squares form.

Every link says where places of its source lie in its target. Gauss–Newton on the distances
between where the two poses put those places, robustly weighted, with one scan held.

Sources: Lu and Milios 1997 (network of relative poses); Sharp et al. 2004 (loops of range
images).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.geometry.transforms import Matrix4, apply, from_twist, nearest_rigid
from workbench.registration.pairwise import Link

_ROUNDS, _REST = 15, 1e-4
# Of the largest eigenvalue: what rounding leaves of those that are 0.
_GAUGE = 1e-13


@dataclass(frozen=True)
class Averaging:
    """Poses that miss all links as little as can be, and how well the links hold them.

    Attributes
    ----------
    poses : group_from_scan per scan.
    condition : of the last equations, every unknown in its own measure and without the motions
        that no link feels; 1 without links.
    rounds, converged : whether the poses had come to rest after so many.
    """

    poses: list[Matrix4]
    condition: float
    rounds: int
    converged: bool


def averaged(
    poses: Sequence[Matrix4], links: Sequence[Link], weights: Sequence[float], scale_m: float
) -> Averaging:
    """Spread what the links miss over all of them.

    Parameters
    ----------
    poses : group_from_scan per scan, already near; scans without links stay.
    links : those to satisfy; every one within one group of scans.
    weights : of the links.
    scale_m : distance at which a link counts half (Geman and McClure).
    """
    result = list(poses)
    n = len(result)
    condition, rounds, converged = 1.0, 0, not links
    while rounds < _ROUNDS and not converged:
        rounds += 1
        centre = np.array([pose[:3, 3] for pose in result]).mean(axis=0)
        matrix, gradient = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
        for link, strength in zip(links, weights, strict=True):
            here = apply(result[link.source], link.places)
            there = apply(result[link.target] @ link.target_from_source, link.places)
            residual = here - there
            squared = float(np.mean((residual**2).sum(axis=1)))
            weight = strength / len(here) / (1.0 + squared / scale_m**2) ** 2
            block = np.zeros((len(here), 3, 12))
            for column, places, sign in ((0, here, 1.0), (6, there, -1.0)):
                block[:, :, column : column + 3] = sign * -_cross(places - centre)
                block[:, :, column + 3 : column + 6] = sign * np.eye(3)
            jacobian = block.reshape(-1, 12)
            index = np.r_[
                6 * link.source : 6 * link.source + 6, 6 * link.target : 6 * link.target + 6
            ]
            matrix[np.ix_(index, index)] += weight * jacobian.T @ jacobian
            gradient[index] += weight * jacobian.T @ residual.ravel()
        # The motions common to a whole group change nothing; the shortest step leaves them out.
        # Every unknown in its own measure, so that weak links are not taken for such motions.
        measure = np.sqrt(np.diag(matrix))
        measure = np.where(measure > 0.0, measure, 1.0)
        scaled = matrix / measure[:, None] / measure
        inner, _, rank, spectrum = np.linalg.lstsq(scaled, gradient / measure, rcond=_GAUGE)
        condition = float(spectrum[0] / spectrum[rank - 1]) if rank else 1.0
        change = -(inner / measure).reshape(n, 6)
        for k, part in enumerate(change):
            step = from_twist([*part[:3], 0, 0, 0])
            step[:3, 3] = centre + part[3:] - step[:3, :3] @ centre
            result[k] = nearest_rigid(step @ result[k])
        converged = bool(np.abs(change[:, 3:]).max() < _REST * scale_m)
    return Averaging(result, condition, rounds, converged)


def loop_error_m(poses: Sequence[Matrix4], link: Link) -> float:
    """How far apart the poses and a link put the link's places, root mean square, metres."""
    gap = apply(poses[link.source], link.places)
    gap -= apply(poses[link.target] @ link.target_from_source, link.places)
    return float(np.sqrt((gap**2).sum(axis=1).mean()))


def _cross(vectors: np.ndarray) -> np.ndarray:
    """(n, 3, 3) matrices of the cross product with each vector."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
