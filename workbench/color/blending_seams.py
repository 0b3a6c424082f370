"""Whether blended colours step where the set of photographs changes that tell them.

Paint steps too. But one photograph that sees both ends of an edge shows the paint's own step in
one light; what the blended colours step beyond that is a seam.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_colors import Colored
from workbench.geometry.robust import robust_sigma

_MOST_EDGES = 1_000_000
_FEWEST_EDGES = 50


@dataclass(frozen=True)
class SeamSteps:
    """Steps of the colours' logarithm along edges; NaN where too few edges tell.

    Attributes
    ----------
    seam : robust standard deviation of what blended colours step beyond the photographs, on
        edges between samples that other photographs see.
    noise : that of what one photograph steps beyond the others, the median of all edges.
    """

    seam: float
    noise: float


def seam_steps(
    photos: Iterable[Colored],
    levels: NDArray[np.float64],
    photo_sets: NDArray[np.uint64],
    triangles: NDArray[np.int32],
) -> SeamSteps:
    """Seams of blended colours on a mesh.

    Parameters
    ----------
    photos : that were blended; iterated once.
    levels : (n,) logarithms of the blended colours; NaN where photographs tell none.
    photo_sets : (n,) a number for the set of photographs that see a sample.
    triangles : (m, 3).
    """
    start, end = _edges(triangles, levels)
    total, sums, squares = (np.zeros(len(start)) for _ in range(3))
    count = np.zeros(len(start), np.int64)
    level, weight = np.full(len(levels), np.nan), np.zeros(len(levels))
    for photo in photos:
        level[photo.index], weight[photo.index] = photo.levels, photo.weights
        step = level[start] - level[end]
        both = np.isfinite(step)
        say = np.where(both, np.minimum(weight[start], weight[end]), 0.0)
        step = np.where(both, step, 0.0)
        total += say
        sums += say * step
        squares += say * step**2
        count += say > 0.0
        level[photo.index], weight[photo.index] = np.nan, 0.0
    told = total > 0.0
    means = sums[told] / total[told]
    beyond = (levels[start] - levels[end])[told] - means
    border = (photo_sets[start] != photo_sets[end])[told]
    several = count[told] > 2
    if min(border.sum(), several.sum()) < _FEWEST_EDGES:
        return SeamSteps(np.nan, np.nan)
    spread = np.sqrt(np.maximum(squares[told] / total[told] - means**2, 0.0))
    return SeamSteps(robust_sigma(beyond[border]), float(np.median(spread[several])))


def _edges(
    triangles: NDArray[np.int32], levels: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Start and end of the triangles' edges with colours at both, some of them where many."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    # Each edge inside a closed surface comes twice, once either way.
    pairs = pairs[(pairs[:, 0] < pairs[:, 1]) & np.isfinite(levels[pairs]).all(axis=1)]
    pairs = pairs[:: max(1, -(-len(pairs) // _MOST_EDGES))]
    return pairs[:, 0], pairs[:, 1]
