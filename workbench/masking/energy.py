"""One cut that weighs what was learned against the boundaries of the image.

Unlike GrabCut, which takes the classifier's word for its start only, every pixel's learned
evidence is the data term.

Source: Boykov and Jolly 2001; Rother, Kolmogorov and Blake 2004, equation 4, for the
smoothness term; PyMaxflow solves by Boykov and Kolmogorov 2004.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

# Half of the eight neighbours: right, down, and both diagonals.
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
# Part of the smoothness that even the strongest edge keeps.
_FLOOR = 0.1


def cut_by_evidence(
    image: NDArray[np.uint8], evidence: NDArray[np.float32], smoothness: float
) -> NDArray[np.bool_]:
    """The labelling of least energy; it is the global optimum.

    Parameters
    ----------
    image : (h, w, 3) uint8 RGB.
    evidence : (h, w) log-odds of foreground.
    smoothness : cost of a boundary between two equal neighbours one pixel apart, log-odds.

    Returns
    -------
    (h, w) bool, foreground.

    Raises
    ------
    InputError : evidence or smoothness that is not finite, or smoothness below 0.
    """
    check_evidence(evidence, smoothness)
    import maxflow  # type: ignore[import-untyped]

    lab = cv2.cvtColor(image.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)
    edges = _edge_weights(np.asarray(lab, np.float32), smoothness)
    graph = maxflow.GraphFloat(evidence.size, len(edges) * evidence.size)
    nodes = graph.add_grid_nodes(evidence.shape)
    for (down, right), weight in zip(_NEIGHBOURS, edges, strict=True):
        structure = np.zeros((3, 3))
        structure[1 + down, 1 + right] = 1
        graph.add_grid_edges(nodes, weight, structure, symmetric=True)
    # The source's side takes what could be either, so it is the clutter's: masks are
    # conservative.
    graph.add_grid_tedges(nodes, np.maximum(-evidence, 0), np.maximum(evidence, 0))
    graph.maxflow()
    return np.asarray(graph.get_grid_segments(nodes))


def check_evidence(evidence: NDArray[np.floating], smoothness: float) -> None:
    """Raise for costs among which no labelling is the least: NaN spoils a cut everywhere."""
    wrong = int((~np.isfinite(evidence)).sum())
    if wrong or not 0.0 <= smoothness < np.inf:
        raise InputError(
            "evidence cannot be cut by",
            expected="finite log-odds, and a smoothness from 0 on",
            found=f"{wrong} log-odds that are not finite, a smoothness of {smoothness}",
            fix="give what is not known the evidence 0, and what is certain a large one",
        )


def _edge_weights(lab: NDArray[np.float32], smoothness: float) -> list[NDArray[np.float64]]:
    squares = [
        ((lab[_from(d)] - lab[_to(d)]) ** 2).sum(axis=2, dtype=np.float64) for d in _NEIGHBOURS
    ]
    mean = sum(s.sum() for s in squares) / max(1, sum(s.size for s in squares))
    weights = []
    for (down, right), square in zip(_NEIGHBOURS, squares, strict=True):
        weight = np.zeros(lab.shape[:2])
        contrast = np.exp(-square / (2.0 * mean + 1e-6))
        weight[_from((down, right))] = _FLOOR + (1.0 - _FLOOR) * contrast
        weights.append(weight * smoothness / np.hypot(down, right))
    return weights


def _from(offset: tuple[int, int]) -> tuple[slice, slice]:
    down, right = offset
    return slice(None, -down or None), slice(max(0, -right), -right if right > 0 else None)


def _to(offset: tuple[int, int]) -> tuple[slice, slice]:
    down, right = offset
    return slice(down, None), slice(max(0, right), right if right < 0 else None)
