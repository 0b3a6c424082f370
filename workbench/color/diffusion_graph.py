"""Which samples of a surface are neighbours, and how readily colour spreads between them.

Colour spreads along an edge by

    conductance = s_i s_j / l²  ·  exp(−(t / t₀)²)

with l its length, s the mean length of the edges at each end and t the turn of the normals. The
first factor is that of a surface's own diffusion where samples lie evenly, whatever their
spacing: what a patch conducts does not depend on how finely it is sampled. The second is Perona
and Malik's first edge-stopping function, which keeps strong edges rather than wide regions. It
looks at the normals, for colour itself is what is missing in a hole: painters, weather and
repairs change at creases. Its floor lets colour through where there is no other way.

Sources: Jaspe 2018, 3.4.6 (edges of a mesh, or the 8 nearest in a cloud); Perona and Malik 1990.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.geometry.neighbours import k_nearest, tree_of

CREASE_RAD = float(np.radians(20.0))
LEAST_CONDUCTANCE = 1e-8
# How far an edge's length may lie from those around it, squared, before it counts no further:
# samples at one place would conduct without bound.
_LENGTH_RANGE = 1e4


@dataclass(frozen=True)
class SampleGraph:
    """Neighbours among samples.

    Attributes
    ----------
    count : number of samples.
    edges : (e, 2) int32 pairs of samples, each pair once.
    conductances : (e,) float64 > 0, relative to one another.
    """

    count: int
    edges: NDArray[np.int32]
    conductances: NDArray[np.float64]


def edges_of_mesh(
    triangles: NDArray[np.int32], count: int, around: NDArray[np.bool_] | None = None
) -> NDArray[np.int32]:
    """Edges (e, 2) of triangles (m, 3), each once, lower vertex first.

    Parameters
    ----------
    count : number of vertices.
    around : (n,) bool: only edges at such vertices and at their neighbours, whose spacing is
        then known too. Those of a hole are enough to fill it, and the time goes with the hole,
        not the model. None: all.
    """
    if around is not None:
        grown = around.copy()
        grown[triangles[_touching(triangles, around)]] = True
        around, triangles = grown, triangles[_touching(triangles, grown)]
    pairs = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    return _once(pairs, count, around)


def edges_of_cloud(
    points: NDArray[np.float64], k: int = 8, around: NDArray[np.bool_] | None = None
) -> NDArray[np.int32]:
    """Edges (e, 2) from points (n, 3) to their k nearest others, each once, lower first.

    Parameters
    ----------
    around : (n,) bool: only from such points and their neighbours, see `edges_of_mesh`. None:
        from all.
    """
    count = len(points)
    k = min(k, count - 1)
    if k < 1:
        return np.zeros((0, 2), np.int32)
    tree = tree_of(points)
    if around is None:
        return _once(_to_nearest(tree, points, np.arange(count), k), count)
    first = _to_nearest(tree, points, np.flatnonzero(around), k)
    ring = np.setdiff1d(first[:, 1], first[:, 0])
    return _once(np.concatenate([first, _to_nearest(tree, points, ring, k)]), count)


def sample_graph(
    edges: NDArray[np.int32],
    points: NDArray[np.float64],
    normals: NDArray[np.float64] | None = None,
    crease_rad: float = CREASE_RAD,
) -> SampleGraph:
    """The graph with conductances from the samples' places and normals.

    Parameters
    ----------
    edges : (e, 2) samples.
    points : (n, 3) float64, any unit.
    normals : (n, 3) unit normals; those that are zero or NaN have no say. None: no creases.
    crease_rad : turn of the normals along an edge at which its conductance falls to 1 / e;
        smaller keeps creases more strictly, inf passes over them.
    """
    start, end = edges.T
    # In three steps: differences of large arrays are what takes memory.
    squared = np.zeros(len(edges))
    for axis in range(3):
        squared += (points[start, axis] - points[end, axis]) ** 2
    length = np.sqrt(squared)
    ends = edges.ravel()
    degree = np.bincount(ends, minlength=len(points))
    total = np.bincount(ends, np.repeat(length, 2), len(points))
    spacing = total / np.maximum(degree, 1)
    # Where all neighbours lie at one place there is nothing to tell edges apart by.
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = spacing[start] * spacing[end] / squared
    relative[np.isnan(relative)] = 1.0
    conductances = np.clip(relative, 1.0 / _LENGTH_RANGE, _LENGTH_RANGE)
    if normals is not None and np.isfinite(crease_rad):
        cosine = np.einsum("ei,ei->e", normals[start], normals[end])
        unit = np.einsum("ni,ni->n", normals, normals) > 0.25
        turn = np.arccos(np.clip(cosine, -1.0, 1.0))
        turn[~(unit[start] & unit[end])] = 0.0
        conductances *= np.maximum(np.exp(-((turn / crease_rad) ** 2)), LEAST_CONDUCTANCE)
    return SampleGraph(len(points), edges, conductances)


def _touching(triangles: NDArray[np.int32], vertices: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(m,) triangles with a corner among the vertices (n,)."""
    a, b, c = triangles.T
    return np.asarray(vertices[a] | vertices[b] | vertices[c])


def _to_nearest(
    tree: cKDTree, points: NDArray[np.float64], start: NDArray[np.int64], k: int
) -> NDArray[np.int64]:
    """Pairs (k s, 2) of the samples ``start`` (s,) and their k nearest others."""
    _, near = k_nearest(tree, points[start], k + 1)
    # Among samples at one place a sample need not be its own nearest.
    other = near != start[:, None]
    other[other.all(axis=1), -1] = False
    return np.stack([np.repeat(start, k), near[other]], axis=1)


def _once(
    pairs: NDArray[Any], count: int, around: NDArray[np.bool_] | None = None
) -> NDArray[np.int32]:
    """Each pair of two different samples once, in ascending order."""
    low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1)
    wanted = low != high
    if around is not None:
        wanted &= around[low] | around[high]
    names = np.sort(low[wanted] * count + high[wanted])
    names = names[np.diff(names, prepend=-1) != 0]
    return np.stack([names // count, names % count], axis=1).astype(np.int32)
