"""One cut over the samples of a range map: evidence against smoothness, cut at depth steps.

Neighbours on the grid are linked the more weakly the farther apart they lie in space, so a
label spreads over a surface and not across its silhouette. Large grids are cut tile by tile.

Source: Boykov and Jolly 2001; PyMaxflow solves by Boykov and Kolmogorov 2004.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.rangemap import RangeMap
from workbench.masking.energy import check_evidence
from workbench.masking.grid_surface import (
    HALF_NEIGHBOURS,
    GridSurface,
    grid_of,
    neighbour_pairs,
    stretch,
)

_SQRT2 = 2.0**0.5
# Neighbours on one surface, seen not too obliquely, are no farther apart than this, spacings.
_SURELY_NEAR = 1.5
_TILE, _CONTEXT = 1024, 32


def surface_cut(
    scan: RangeMap,
    surface: GridSurface,
    evidence: NDArray[np.float64],
    smoothness: float,
    step_decay: float,
) -> NDArray[np.bool_]:
    """Which samples belong to the object, by the labelling of least energy.

    Parameters
    ----------
    evidence : (n,) log-odds of the object.
    smoothness : cost of a boundary between two samples one spacing apart, log-odds.
    step_decay : the links of samples that lie this many spacings farther apart than they
        would on a surface have 1/e of it.

    Returns
    -------
    (n,) bool; false for samples that the grid does not name.

    Raises
    ------
    InputError : the scan has no grid, or evidence or smoothness is no number to cut by.
    """
    check_evidence(evidence, smoothness)
    grid = grid_of(scan)
    kept = np.zeros(len(scan), bool)
    for top in range(0, grid.shape[0], _TILE):
        for left in range(0, grid.shape[1], _TILE):
            y, x = max(0, top - _CONTEXT), max(0, left - _CONTEXT)
            tile = grid[y : top + _TILE + _CONTEXT, x : left + _TILE + _CONTEXT]
            inside = tile[top - y :, left - x :][:_TILE, :_TILE]
            core = inside[inside >= 0]
            if len(core):
                found = _cut(scan, surface, tile, evidence, smoothness, step_decay)
                kept[core] = found[core]
    return kept


def _cut(
    scan: RangeMap,
    surface: GridSurface,
    tile: NDArray[np.int32],
    evidence: NDArray[np.float64],
    smoothness: float,
    step_decay: float,
) -> NDArray[np.bool_]:
    """The labels (n,) of the samples of one tile; false elsewhere."""
    import maxflow  # type: ignore[import-untyped]

    samples = tile[tile >= 0]
    node = np.full(len(scan), -1, np.int64)
    node[samples] = np.arange(len(samples))
    graph = maxflow.GraphFloat(len(samples), len(HALF_NEIGHBOURS) * len(samples))
    graph.add_nodes(len(samples))
    for offset in HALF_NEIGHBOURS:
        a, b = neighbour_pairs(tile, offset)
        beyond = np.maximum(stretch(scan, surface, a, b) - _SURELY_NEAR, 0.0)
        link = smoothness * np.exp(-beyond / step_decay) / (_SQRT2 if all(offset) else 1.0)
        graph.add_edges(node[a], node[b], link, link)
    at = evidence[samples]
    graph.add_grid_tedges(np.arange(len(samples)), np.maximum(-at, 0.0), np.maximum(at, 0.0))
    graph.maxflow()
    kept = np.zeros(len(scan), bool)
    kept[samples] = graph.get_grid_segments(np.arange(len(samples)))
    return kept
