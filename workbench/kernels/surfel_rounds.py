"""Progressive sampling in random rounds: the farthest few of each random subset.

Brandt et al. 2019, Rendering of Complex Heterogenous Scenes using Progressive Blue Surfels, 3.2.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Below this many picks a look at all of them is quicker than a grid.
_PLAIN = 64
_WIDEST_RING = 3

# Steele et al. 2014: splitmix64, one word of state, the same on every machine.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_ODD_1, _ODD_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_PRIMES = (np.int64(73856093), np.int64(19349663), np.int64(83492791))


@njit(cache=True, nogil=True)
def farthest_of_rounds(
    points: NDArray[np.float64],
    count: int,
    subset: int,
    grow_every: int,
    near: float,
    seed: int,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Rows (k,) of points (n, 3), finite, in order, and their distances (k,) to those before.

    Each round draws ``subset`` of the points that are left and takes the farthest of them from
    all taken so far: one, and one more after every ``grow_every`` rounds, each of them with
    regard to those before. Points of the subset nearer than ``near`` times the spacing that is
    to be expected at the end leave, too. The first distance is infinite; fewer than ``count``
    come when no points are left.
    """
    wanted = min(count, len(points))
    picks = np.empty(wanted, np.int64)
    reach = np.empty(wanted, np.float64)
    pool = np.arange(len(points))
    left = len(points)
    state = np.uint64(seed)
    buckets = 1
    while buckets < 2 * wanted:
        buckets *= 2
    heads = np.full(buckets, -1, np.int64)
    following = np.empty(wanted, np.int64)
    distance = np.empty(subset, np.float64)
    cell, rebuilt_at, taken, rounds = 0.0, _PLAIN, 0, 0

    state += _GOLDEN
    start = np.int64(_mixed(state) % np.uint64(left))
    picks[0], reach[0], taken = pool[start], np.inf, 1
    left -= 1
    pool[start] = pool[left]
    while taken < wanted and left > 0:
        if taken >= rebuilt_at:
            # What a typical gap is now will be twice that of when the grid is made anew.
            cell = max(reach[taken - 1], 1e-300)
            heads[:] = -1
            for i in range(taken):
                _enter(points, picks, i, cell, heads, following)
            rebuilt_at *= 2
        drawn = min(subset, left)
        for s in range(drawn):
            state += _GOLDEN
            other = s + np.int64(_mixed(state) % np.uint64(left - s))
            pool[s], pool[other] = pool[other], pool[s]
            distance[s] = _gap(points, picks, taken, pool[s], cell, heads, following)
        most = min(1 + rounds // grow_every, drawn)
        limit = near * distance[:drawn].max() * np.sqrt(taken / wanted)
        for _ in range(most):
            s = int(np.argmax(distance[:drawn]))
            if taken == wanted or not distance[s] > 0.0:
                break
            picks[taken], reach[taken] = pool[s], distance[s]
            if cell > 0.0:
                _enter(points, picks, taken, cell, heads, following)
            taken += 1
            _shorten(points, pool, drawn, pool[s], distance)
        for s in range(drawn - 1, -1, -1):
            if distance[s] <= limit:
                left -= 1
                pool[s] = pool[left]
        rounds += 1
    return picks[:taken], reach[:taken]


@njit(cache=True, nogil=True)
def _shorten(
    points: NDArray[np.float64],
    pool: NDArray[np.int64],
    drawn: int,
    pick: int,
    distance: NDArray[np.float64],
) -> None:
    """Bring the distances of the subset down to that of a new pick: 0 of its own."""
    p = points[pick]
    for s in range(drawn):
        q = points[pool[s]]
        gap = (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2
        distance[s] = min(distance[s], np.sqrt(gap))


@njit(cache=True, nogil=True)
def _mixed(state: np.uint64) -> np.uint64:
    word = (state ^ (state >> np.uint64(30))) * _ODD_1
    word = (word ^ (word >> np.uint64(27))) * _ODD_2
    return word ^ (word >> np.uint64(31))


@njit(cache=True, nogil=True)
def _bucket(x: int, y: int, z: int, buckets: int) -> int:
    mixed = (x * _PRIMES[0]) ^ (y * _PRIMES[1]) ^ (z * _PRIMES[2])
    return int(mixed & (buckets - 1))


@njit(cache=True, nogil=True)
def _enter(
    points: NDArray[np.float64],
    picks: NDArray[np.int64],
    i: int,
    cell: float,
    heads: NDArray[np.int64],
    following: NDArray[np.int64],
) -> None:
    """Put pick ``i`` first in the chain of its cell."""
    p = points[picks[i]]
    bucket = _bucket(
        np.int64(np.floor(p[0] / cell)),
        np.int64(np.floor(p[1] / cell)),
        np.int64(np.floor(p[2] / cell)),
        len(heads),
    )
    following[i] = heads[bucket]
    heads[bucket] = i


@njit(cache=True, nogil=True)
def _gap(
    points: NDArray[np.float64],
    picks: NDArray[np.int64],
    taken: int,
    row: int,
    cell: float,
    heads: NDArray[np.int64],
    following: NDArray[np.int64],
) -> float:
    """Distance of a point to the nearest pick."""
    x, y, z = points[row, 0], points[row, 1], points[row, 2]
    best = np.inf
    if cell > 0.0:
        cx, cy, cz = np.floor(x / cell), np.floor(y / cell), np.floor(z / cell)
        # All that is nearer than this lies in the ring's cells.
        inner = min(
            min(min(x - cx * cell, cell - (x - cx * cell)), y - cy * cell),
            min(min(cell - (y - cy * cell), z - cz * cell), cell - (z - cz * cell)),
        )
        for ring in range(_WIDEST_RING + 1):
            for dx in range(-ring, ring + 1):
                for dy in range(-ring, ring + 1):
                    step = 1 if max(abs(dx), abs(dy)) == ring else max(2 * ring, 1)
                    for dz in range(-ring, ring + 1, step):
                        bucket = _bucket(
                            np.int64(cx) + dx, np.int64(cy) + dy, np.int64(cz) + dz, len(heads)
                        )
                        best = _nearest_of_chain(
                            points, picks, heads[bucket], following, x, y, z, best
                        )
            sure = inner + ring * cell
            if best <= sure * sure:
                return math.sqrt(best)
    for i in range(taken):
        p = points[picks[i]]
        best = min(best, (p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2)
    return math.sqrt(best)


@njit(cache=True, nogil=True)
def _nearest_of_chain(
    points: NDArray[np.float64],
    picks: NDArray[np.int64],
    i: int,
    following: NDArray[np.int64],
    x: float,
    y: float,
    z: float,
    best: float,
) -> float:
    while i >= 0:
        p = points[picks[i]]
        best = min(best, (p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2)
        i = following[i]
    return best
