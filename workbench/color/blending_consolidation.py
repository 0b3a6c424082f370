"""Colours of coarse samples that stand for finer ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.neighbours import nearest, tree_of


def consolidated(
    points: NDArray[np.float64],
    colors: NDArray[np.float64],
    weights: NDArray[np.float64],
    finer: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean colours and total weights of samples and of the finer ones nearest to each.

    Source: Jaspe, section 3.4.5: inner levels are averaged bottom-up, so that a coarse view shows
    what a fine one would, seen from afar.

    Parameters
    ----------
    points, colors, weights : (n, 3), (n, 3) linear, (n,) ≥ 0 of the coarse samples; colours of
        samples without weight may be anything.
    finer : the same of the finer ones, (m, …).

    Returns
    -------
    (n, 3) NaN where nothing has weight, and (n,).
    """
    finer_points, finer_colors, finer_weights = finer
    total = weights.astype(np.float64)
    sums = np.where(weights[:, None] > 0.0, weights[:, None] * colors, 0.0)
    told = finer_weights > 0.0
    if len(points) and told.any():
        _, owner = nearest(tree_of(points), finer_points[told])
        say = finer_weights[told]
        total += np.bincount(owner, say, len(points))
        for k in range(3):
            sums[:, k] += np.bincount(owner, say * finer_colors[told, k], len(points))
    return sums / np.where(total > 0.0, total, np.nan)[:, None], total
