"""All scans as one set of samples: duplicates merged, each with a radius and a confidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.samples import Samples
from workbench.geometry.transforms import Matrix4, apply, rotate

# Floors and walls like to lie at round numbers; no face between cells does.
_GRID_SHIFT = np.array([0.382, 0.618, 0.236])
# Farther off, the number of a cell is no whole number of 64 bits.
_MOST_CELLS = 2.0**62


def placed_samples(
    scan: OrientedScan,
    pose: Matrix4,
    color: NDArray[np.uint8] | None,
    owner: int,
    sigma_m: NDArray[np.float32] | None = None,
) -> Samples:
    """One scan's samples in the project frame.

    Parameters
    ----------
    scan, pose : oriented scan and its ``project_from_scan``.
    color : (n, 3) uint8 sRGB of its samples, or None.
    owner : the scan's number.
    sigma_m : (n,) standard deviation of each sample along its ray, where it is known.
    """
    # Depth noise grows with obliqueness; a rim sample may straddle an edge.
    confidence = np.where(scan.border, 0.5, 1.0) * scan.incidence_cos
    if sigma_m is not None:
        # One that is as unsure as samples are apart counts half.
        confidence = confidence / (1.0 + (sigma_m / scan.spacing_m) ** 2)
    return Samples(
        apply(pose, scan.points),
        rotate(pose, scan.normals),
        scan.reach_m,
        confidence,
        np.full(len(scan), owner, np.int32),
        color,
    )


def merged(samples: Samples, cell_m: float) -> Samples:
    """Samples with those that fall into one small cell made one.

    Within a cell, samples that face the same way become one, at the mean of their places
    weighted by confidence: neighbouring scans average their noise, exact duplicates vanish,
    and the two sides of a thin wall stay apart.

    Parameters
    ----------
    cell_m : edge of the cells; 0 keeps every sample.

    Returns
    -------
    Samples in the order of their cells, whatever the order within the cells was.

    Raises
    ------
    InputError
        Places that are not finite or too far off to be in a cell; normals or confidences that
        are not finite, or confidences that are not above 0.
    """
    if cell_m <= 0.0 or not len(samples):
        return samples
    _check(samples, cell_m)
    group = _groups(samples.points, samples.normals, cell_m)
    weight = samples.confidence
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(group[order]) > 0])
    total = np.add.reduceat(weight[order], starts)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        weighted = values[order] * weight[order].reshape(-1, *(1,) * (values.ndim - 1))
        summed = np.add.reduceat(weighted, starts, axis=0)
        return np.asarray(summed / total.reshape(-1, *(1,) * (values.ndim - 1)))

    normal = mean(samples.normals)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    heaviest = np.lexsort((-weight[order], group[order]))[starts]
    first = order[heaviest]
    normal = np.where(length > 0.1, normal / np.maximum(length, 0.1), samples.normals[first])
    return Samples(
        mean(samples.points),
        normal,
        np.maximum.reduceat(samples.radius_m[order], starts),
        total,
        samples.scan[first],
        None if samples.color is None else samples.color[first],
    )


def joined(parts: Sequence[Samples]) -> Samples:
    """All samples of several parts; with colour only where all parts have it."""
    held = [part for part in parts if len(part)] or list(parts[:1])
    names = [n for n in held[0].arrays() if all(getattr(p, n) is not None for p in held)]
    return Samples(**{n: np.concatenate([getattr(part, n) for part in held]) for n in names})


def _check(samples: Samples, cell_m: float) -> None:
    """Raise for samples of which there is no mean."""
    # NaN is in no order with anything, so these say no to it, too.
    sound = (np.abs(samples.points) < _MOST_CELLS * cell_m).all(axis=1)
    sound &= np.isfinite(samples.normals).all(axis=1)
    sound &= (samples.confidence > 0.0) & (samples.confidence < np.inf)
    if not sound.all():
        row = int(np.argmin(sound))
        raise InputError(
            "samples cannot be merged",
            where=f"sample {row}",
            expected="finite places and normals, a confidence above 0, and cells that can be "
            "numbered",
            found=f"{int((~sound).sum())} without: at {samples.points[row]}, "
            f"confidence {samples.confidence[row]}",
            fix="leave such samples out, or merge in larger cells",
        )


def _groups(
    points: NDArray[np.float64], normals: NDArray[np.float64], cell_m: float
) -> NDArray[np.int64]:
    """(n,) group number: same cell and same dominant direction of the normal."""
    cell = np.floor(points / cell_m + _GRID_SHIFT).astype(np.int64)
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(normals)), axis] < 0)
    key = np.stack([facing, *cell.T], axis=1)
    _, group = np.unique(key, axis=0, return_inverse=True)
    return group.ravel()
