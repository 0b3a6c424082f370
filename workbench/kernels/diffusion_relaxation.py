"""Gauss–Seidel sweeps and residuals of a graph's diffusion, four right-hand sides at once.

Graphs are as in `workbench.kernels.diffusion_aggregation`; values are (n, 4) float64. Four at
once, for the matrix is what takes time to read. ``upper`` (n,) says where in a row the neighbours
of higher number begin. One thread does it all: the same bits everywhere.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

CHANNELS = 4


@njit(cache=True, nogil=True)
def uppers(starts: NDArray[np.int64], neighbours: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) where in each row the neighbours of higher number begin."""
    n = len(starts) - 1
    upper = np.empty(n, np.int64)
    for i in range(n):
        k = starts[i]
        while k < starts[i + 1] and neighbours[k] < i:
            k += 1
        upper[i] = k
    return upper


@njit(cache=True, nogil=True)
def swept_down(
    starts: NDArray[np.int64],
    upper: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    diagonal: NDArray[np.float64],
    right: NDArray[np.float64],
    group: NDArray[np.int32],
    values: NDArray[np.float64],
    coarse_right: NDArray[np.float64],
) -> None:
    """One forward sweep from zero into ``values``, and its residual summed over groups.

    After such a sweep the residual is what the later neighbours still have to say: each half of
    the matrix is read once.
    """
    n = len(diagonal)
    for i in range(n):
        a, b, c, d = right[i, 0], right[i, 1], right[i, 2], right[i, 3]
        for k in range(starts[i], upper[i]):
            j, g = neighbours[k], conductances[k]
            a += g * values[j, 0]
            b += g * values[j, 1]
            c += g * values[j, 2]
            d += g * values[j, 3]
        scale = 1.0 / diagonal[i]
        values[i, 0], values[i, 1] = a * scale, b * scale
        values[i, 2], values[i, 3] = c * scale, d * scale
    coarse_right[:] = 0.0
    for i in range(n):
        into = group[i]
        if into < 0:
            continue
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for k in range(upper[i], starts[i + 1]):
            j, g = neighbours[k], conductances[k]
            a += g * values[j, 0]
            b += g * values[j, 1]
            c += g * values[j, 2]
            d += g * values[j, 3]
        coarse_right[into, 0] += a
        coarse_right[into, 1] += b
        coarse_right[into, 2] += c
        coarse_right[into, 3] += d


@njit(cache=True, nogil=True)
def swept_up(
    starts: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    diagonal: NDArray[np.float64],
    right: NDArray[np.float64],
    group: NDArray[np.int32],
    coarse_values: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    """Add the groups' corrections to ``values`` and sweep backward once."""
    n = len(diagonal)
    for i in range(n):
        g = group[i]
        if g >= 0:
            for c in range(CHANNELS):
                values[i, c] += coarse_values[g, c]
    for i in range(n - 1, -1, -1):
        a, b, c, d = right[i, 0], right[i, 1], right[i, 2], right[i, 3]
        for k in range(starts[i], starts[i + 1]):
            j, g = neighbours[k], conductances[k]
            a += g * values[j, 0]
            b += g * values[j, 1]
            c += g * values[j, 2]
            d += g * values[j, 3]
        scale = 1.0 / diagonal[i]
        values[i, 0], values[i, 1] = a * scale, b * scale
        values[i, 2], values[i, 3] = c * scale, d * scale


@njit(cache=True, nogil=True)
def applied(
    starts: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    excess: NDArray[np.float64],
    values: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """The matrix times ``values`` into ``out``, by differences, which do not cancel."""
    for i in range(len(excess)):
        v0, v1, v2, v3 = values[i, 0], values[i, 1], values[i, 2], values[i, 3]
        e = excess[i]
        a, b, c, d = e * v0, e * v1, e * v2, e * v3
        for k in range(starts[i], starts[i + 1]):
            j, g = neighbours[k], conductances[k]
            a += g * (v0 - values[j, 0])
            b += g * (v1 - values[j, 1])
            c += g * (v2 - values[j, 2])
            d += g * (v3 - values[j, 3])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = a, b, c, d


@njit(cache=True, nogil=True)
def products(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) scalar product of each column, summed in the order of the rows."""
    p, q, r, s = 0.0, 0.0, 0.0, 0.0
    for i in range(len(a)):
        p += a[i, 0] * b[i, 0]
        q += a[i, 1] * b[i, 1]
        r += a[i, 2] * b[i, 2]
        s += a[i, 3] * b[i, 3]
    return np.array([p, q, r, s])


@njit(cache=True, nogil=True)
def largest(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) largest size of a number in each column."""
    result = np.zeros(CHANNELS)
    for i in range(len(a)):
        for c in range(CHANNELS):
            result[c] = max(result[c], abs(a[i, c]))
    return result


@njit(cache=True, nogil=True)
def added(
    target: NDArray[np.float64], factor: NDArray[np.float64], what: NDArray[np.float64]
) -> None:
    """Add ``factor`` (4,) times ``what`` to ``target``."""
    for i in range(len(target)):
        for c in range(CHANNELS):
            target[i, c] += factor[c] * what[i, c]


@njit(cache=True, nogil=True)
def scaled_and_added(
    target: NDArray[np.float64], factor: NDArray[np.float64], what: NDArray[np.float64]
) -> None:
    """Make ``target`` into ``factor`` (4,) times itself plus ``what``."""
    for i in range(len(target)):
        for c in range(CHANNELS):
            target[i, c] = factor[c] * target[i, c] + what[i, c]


@njit(cache=True, nogil=True)
def eliminated(
    starts: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    excess: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A small graph, its nodes taken out one by one, each joining those it was joined to.

    Only positive numbers are added, so that every factor is right to its last digits however
    weakly a part hangs at the rest. Source: Grassmann, Taksar and Heyman 1985.

    Returns
    -------
    factors : (n, n), above the diagonal the share of each later node in an earlier one.
    diagonal : (n,) the pivots.
    """
    n = len(excess)
    joins = np.zeros((n, n))
    held = excess.copy()
    for i in range(n):
        for k in range(starts[i], starts[i + 1]):
            joins[i, neighbours[k]] = conductances[k]
    pivots = np.empty(n)
    for k in range(n):
        pivot = held[k]
        for j in range(k + 1, n):
            pivot += joins[k, j]
        pivots[k] = pivot
        for i in range(k + 1, n):
            share = joins[k, i] / pivot
            if share == 0.0:
                continue
            held[i] += share * held[k]
            for j in range(k + 1, n):
                joins[i, j] += share * joins[k, j]
            joins[i, i] = 0.0
        for j in range(k + 1, n):
            joins[k, j] /= pivot
    return joins, pivots


@njit(cache=True, nogil=True)
def back_substituted(
    factors: NDArray[np.float64],
    pivots: NDArray[np.float64],
    right: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    """Solve the small graph that was `eliminated` into ``values``."""
    n = len(pivots)
    values[:] = right
    for k in range(n):
        for j in range(k + 1, n):
            share = factors[k, j]
            for c in range(CHANNELS):
                values[j, c] += share * values[k, c]
    for k in range(n - 1, -1, -1):
        for c in range(CHANNELS):
            values[k, c] /= pivots[k]
        for j in range(k + 1, n):
            share = factors[k, j]
            for c in range(CHANNELS):
                values[k, c] += share * values[j, c]
