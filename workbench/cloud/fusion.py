"""All scans as one set of samples: duplicates merged, each with a radius and a confidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.samples import Samples
from workbench.geometry.transforms import Matrix4, apply, rotate


def merge_scans(
    scans: Sequence[OrientedScan],
    poses: Sequence[Matrix4],
    colors: Sequence[NDArray[np.uint8] | None],
    cell_m: float,
) -> Samples:
    """Bring scans together and merge samples that fall into one small cell.

    Within a cell, samples that face the same way become one, at the mean of their places
    weighted by confidence: neighbouring scans average their noise, exact duplicates vanish,
    and the two sides of a thin wall stay apart.

    Parameters
    ----------
    scans, poses : oriented scans and ``project_from_scan`` of each.
    colors : per scan (n, 3) uint8 sRGB of its samples, or None.
    cell_m : edge of the cells; 0 keeps every sample.

    Returns
    -------
    Samples in the order of their cells, whatever the order within the cells was.
    """
    points = np.concatenate([apply(p, s.points) for s, p in zip(scans, poses, strict=True)])
    normals = np.concatenate([rotate(p, s.normals) for s, p in zip(scans, poses, strict=True)])
    radius = np.concatenate([s.reach_m for s in scans])
    # Depth noise grows with obliqueness; a rim sample may straddle an edge.
    weight = np.concatenate([np.where(s.border, 0.5, 1.0) * s.incidence_cos for s in scans])
    owner = np.repeat(np.arange(len(scans), dtype=np.int32), [len(s) for s in scans])
    color = _joined_colors(scans, colors)
    if cell_m <= 0.0 or not len(points):
        return Samples(points, normals, radius, weight, owner, color)
    group = _groups(points, normals, cell_m)
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(group[order]) > 0])
    total = np.add.reduceat(weight[order], starts)

    def mean(values: NDArray[np.generic]) -> NDArray[np.float64]:
        weighted = values[order] * weight[order].reshape(-1, *(1,) * (values.ndim - 1))
        summed = np.add.reduceat(weighted, starts, axis=0)
        return np.asarray(summed / total.reshape(-1, *(1,) * (values.ndim - 1)))

    normal = mean(normals)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    heaviest = np.lexsort((-weight[order], group[order]))[starts]
    first = order[heaviest]
    normal = np.where(length > 0.1, normal / np.maximum(length, 0.1), normals[first])
    return Samples(
        mean(points),
        normal,
        np.maximum.reduceat(radius[order], starts),
        total,
        owner[first],
        None if color is None else color[first],
    )


def _groups(
    points: NDArray[np.float64], normals: NDArray[np.float64], cell_m: float
) -> NDArray[np.int64]:
    """(n,) group number: same cell and same dominant direction of the normal."""
    low = points.min(axis=0)
    cell = np.floor((points - low) / cell_m).astype(np.int64)
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(normals)), axis] < 0)
    key = np.stack([facing, *cell.T], axis=1)
    _, group = np.unique(key, axis=0, return_inverse=True)
    return group.ravel()


def _joined_colors(
    scans: Sequence[OrientedScan], colors: Sequence[NDArray[np.uint8] | None]
) -> NDArray[np.uint8] | None:
    """All colours, or None unless every scan with samples has them."""
    present = [c for s, c in zip(scans, colors, strict=True) if len(s)]
    if not present or any(c is None for c in present):
        return None
    return np.concatenate([c for c in present if c is not None])
