"""An additive kd-tree over points: every node keeps a random few, its children the rest.

``build_subtree`` works on points in memory; ``sift`` sends a stream of points through the
upper nodes of a tree too large for it. Randomness is a hash of the position in the stream,
so the outcome does not depend on how the stream is cut into blocks.

Source: Jaspe-Villanueva 2018, section 3.3.1; Gobbetti and Marton 2004, Layered Point Clouds.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

#: Axis of a node whose points all coincide: its children halve them in stream order.
BY_ORDER = 3
#: Axis of a leaf.
LEAF = -1
_BINS = 1024
_FEW = 48


@nb.njit(cache=True, nogil=True, inline="always")
def mixed(number: np.uint64, seed: np.uint64) -> np.uint64:
    """A bijective hash of 64-bit numbers (splitmix64; Steele et al. 2014)."""
    z = number + seed * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@nb.njit(cache=True, nogil=True)
def shuffled(n: int, seed: int) -> NDArray[np.int32]:
    """A random permutation of 0 … n − 1 (Fisher–Yates on ``mixed``)."""
    order = np.arange(n).astype(np.int32)
    for i in range(n - 1, 0, -1):
        j = np.int64(mixed(np.uint64(i), np.uint64(seed)) % np.uint64(i + 1))
        order[i], order[j] = order[j], order[i]
    return order


@nb.njit(cache=True, nogil=True)
def order_statistic(values: NDArray[np.float64], rank: int, low: float, high: float) -> float:
    """The value with ``rank`` smaller or equal ones before it, exactly.

    ``low`` and ``high`` are the least and greatest of ``values`` (n,).

    Histograms narrow the range until few candidates are left: the two-pass bit histogram of
    Jaspe 2018, 3.3.1, repeated to the end and over the range in place of the bits.
    """
    candidates = values
    while len(candidates) > _FEW:
        if low == high:
            return low
        scale = (_BINS - 0.5) / (high - low)
        if not np.isfinite(scale):
            break
        counts = np.zeros(_BINS, np.int64)
        for v in candidates:
            counts[np.int64((v - low) * scale)] += 1
        bin_, before = 0, 0
        while before + counts[bin_] <= rank:
            before += counts[bin_]
            bin_ += 1
        rank -= before
        kept = np.empty(counts[bin_])
        k = 0
        least, most = np.inf, -np.inf
        for v in candidates:
            if np.int64((v - low) * scale) == bin_:
                kept[k] = v
                k += 1
                least = min(least, v)
                most = max(most, v)
        candidates, low, high = kept, least, most
    result: float = np.sort(candidates)[rank]
    return result


@nb.njit(cache=True, nogil=True)
def balanced_split(values: NDArray[np.float64], low: float, high: float) -> float:
    """The s nearest to the median for which neither v < s nor v ≥ s is empty.

    ``values`` (n,) reach from ``low`` to ``high`` > ``low``.
    """
    middle: float = order_statistic(values, len(values) // 2, low, high)
    below, equal = 0, 0
    above: float = np.inf
    for v in values:
        if v < middle:
            below += 1
        elif v == middle:
            equal += 1
        else:
            above = min(above, float(v))
    half = len(values) / 2
    if below == 0 or (above < np.inf and abs(below + equal - half) < abs(below - half)):
        return above
    return middle


@nb.njit(cache=True, nogil=True)
def extents(
    points: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> int:
    """Widen ``low`` and ``high`` (3,) by points (n, 3).

    Returns
    -------
    Row of the first point that is not finite or beyond 1e150, −1 where all are good.
    """
    for i in range(len(points)):
        for k in range(3):
            v = points[i, k]
            if not abs(v) <= 1e150:
                return i
            low[k] = min(low[k], v)
            high[k] = max(high[k], v)
    return -1


@nb.njit(cache=True, nogil=True)
def widest_axis(low: NDArray[np.float64], high: NDArray[np.float64]) -> int:
    """Axis of the largest extent; ``BY_ORDER`` where there is none."""
    axis, widest = BY_ORDER, 0.0
    for k in range(3):
        if high[k] - low[k] > widest:
            axis, widest = k, high[k] - low[k]
    return axis


@nb.njit(cache=True, nogil=True)
def _widen(
    columns: NDArray[np.float64],
    start: int,
    end: int,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    for k in range(3):
        least, most = low[k], high[k]
        for i in range(start, end):
            v = columns[k, i]
            least = min(least, v)
            most = max(most, v)
        low[k], high[k] = least, most


@nb.njit(cache=True, nogil=True)
def build_subtree(
    points: NDArray[np.float64], inner: int, capacity: int, seed: int
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.float64]]:
    """The tree of points in memory.

    A node of at most ``capacity`` points is a leaf; any other keeps ``inner`` random points
    and splits the rest at the median of its widest axis.

    Parameters
    ----------
    points : (n, 3) float64, n > 0.
    inner, capacity : 1 ≤ inner ≤ capacity.
    seed : of the random choice.

    Returns
    -------
    order : (n,) int32 permutation; the points of a node are one piece of it.
    nodes : (k, 6) int64: start and count in ``order``, parent, left, right (−1 for none),
        axis (``LEAF``, ``BY_ORDER`` or 0 to 2). Parents come before their children.
    splits : (k, 7) float64: split value, then lower and upper corner of the whole subtree.
    """
    n = len(points)
    order = shuffled(n, seed)
    spare_order = np.empty(n, np.int32)
    columns = np.empty((3, n))
    spare = np.empty((3, n))
    for i in range(n):
        for k in range(3):
            columns[k, i] = points[order[i], k]
    most = 2 * (n // inner + 2)
    nodes = np.full((most, 6), -1, np.int64)
    splits = np.zeros((most, 7))
    first, last = np.zeros(most, np.int64), np.zeros(most, np.int64)
    last[0] = n
    used, node = 1, 0
    low, high = np.empty(3), np.empty(3)
    while node < used:
        start, end = first[node], last[node]
        nodes[node, 0] = start
        leaf = end - start <= capacity
        mine = end - start if leaf else inner
        nodes[node, 1] = mine
        low[:], high[:] = np.inf, -np.inf
        _widen(columns, start + mine, end, low, high)
        # What splits is the extent of the rest: the kept points may have been the widest.
        axis = widest_axis(low, high)
        splits[node, 1:4], splits[node, 4:7] = low, high
        _widen(columns, start, start + mine, splits[node, 1:4], splits[node, 4:7])
        node += 1
        if leaf:
            continue
        start += mine
        nodes[node - 1, 5] = axis
        if axis == BY_ORDER:
            middle = (start + end) // 2
        else:
            split = balanced_split(columns[axis, start:end], low[axis], high[axis])
            splits[node - 1, 0] = split
            middle, kept = start, 0
            for i in range(start, end):
                # Written to both sides: a branch here would be mispredicted half the time.
                x, y, z, number = columns[0, i], columns[1, i], columns[2, i], order[i]
                left = 1 if columns[axis, i] < split else 0
                columns[0, middle], columns[1, middle], columns[2, middle] = x, y, z
                order[middle] = number
                spare[0, kept], spare[1, kept], spare[2, kept] = x, y, z
                spare_order[kept] = number
                middle += left
                kept += 1 - left
            for k in range(3):
                columns[k, middle:end] = spare[k, :kept]
            order[middle:end] = spare_order[:kept]
        for side in range(2):
            a, b = (start, middle) if side == 0 else (middle, end)
            if a == b:
                continue
            first[used], last[used] = a, b
            nodes[used, 2] = node - 1
            nodes[node - 1, 3 + side] = used
            used += 1
    return order, nodes[:used].copy(), splits[:used].copy()


@nb.njit(cache=True, nogil=True)
def sift(
    rows: NDArray[np.uint64],
    first_number: int,
    seed: int,
    plan: NDArray[np.int32],
    splits: NDArray[np.float64],
    limits: NDArray[np.uint64],
    kept_rows: NDArray[np.uint64],
    keys: NDArray[np.uint64],
    slots: NDArray[np.int32],
    counts: NDArray[np.int64],
) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Send rows through the upper nodes; each node keeps those of lowest hash.

    Parameters
    ----------
    rows : (n, words) uint64; the first three words are float64 coordinates.
    first_number : number of the first row in the stream.
    plan : (k, 3) int32 per upper node: axis, left, right; children ≥ 0 are upper nodes, any
        other is bucket −1 − child.
    splits : (k,) float64.
    limits : (k,) uint64: a node takes no hash above. An estimate of where it will end up that
        errs upwards spares filling it with what it must give away again.
    kept_rows : (k, m, words) what the nodes keep.
    keys, slots, counts : (k, m), (k, m), (k,): a heap per node, highest hash on top.

    Returns
    -------
    fallen : (f, words) rows that no upper node keeps, grouped by bucket, in stream order.
    starts : (buckets + 1,) where each bucket's rows begin.
    """
    n, words = rows.shape
    capacity = keys.shape[1]
    buckets = len(plan) + 1
    fallen = np.empty((n, words), np.uint64)
    bucket_of = np.empty(n, np.int32)
    lost = 0
    row = np.empty(words, np.uint64)
    where = row.view(np.float64)
    for i in range(n):
        key = mixed(np.uint64(first_number + i), np.uint64(seed))
        row[:] = rows[i]
        node = 0
        while node >= 0:
            if key <= limits[node]:
                if counts[node] < capacity:
                    k = counts[node]
                    counts[node] = k + 1
                    kept_rows[node, k] = row
                    slot = np.int32(k)
                    while k > 0 and keys[node, (k - 1) // 2] < key:
                        keys[node, k] = keys[node, (k - 1) // 2]
                        slots[node, k] = slots[node, (k - 1) // 2]
                        k = (k - 1) // 2
                    keys[node, k], slots[node, k] = key, slot
                    break
                if key < keys[node, 0]:
                    evicted, slot = keys[node, 0], slots[node, 0]
                    k = 0
                    while True:
                        child = 2 * k + 1
                        if child >= capacity:
                            break
                        if child + 1 < capacity and keys[node, child + 1] > keys[node, child]:
                            child += 1
                        if keys[node, child] <= key:
                            break
                        keys[node, k], slots[node, k] = keys[node, child], slots[node, child]
                        k = child
                    keys[node, k], slots[node, k] = key, slot
                    for w in range(words):
                        row[w], kept_rows[node, slot, w] = kept_rows[node, slot, w], row[w]
                    key = evicted
            axis = plan[node, 0]
            node = plan[node, 1] if where[axis] < splits[node] else plan[node, 2]
        if node < 0:
            fallen[lost] = row
            bucket_of[lost] = -1 - node
            lost += 1
    starts = np.zeros(buckets + 1, np.int64)
    for i in range(lost):
        starts[bucket_of[i] + 1] += 1
    for b in range(buckets):
        starts[b + 1] += starts[b]
    grouped = np.empty((lost, words), np.uint64)
    at = starts[:-1].copy()
    for i in range(lost):
        b = bucket_of[i]
        grouped[at[b]] = fallen[i]
        at[b] += 1
    return grouped, starts


@nb.njit(cache=True, nogil=True)
def sampled(
    points: NDArray[np.float64],
    first_number: int,
    threshold: int,
    kept: NDArray[np.float64],
    keys: NDArray[np.uint64],
    count: int,
) -> tuple[int, int]:
    """Keep the points of a stream whose hash lies below a threshold that falls as needed.

    Parameters
    ----------
    points : (n, 3) float64, stream numbers from ``first_number``.
    threshold : the hash's high 32 bits must lie below it; 2^32 at the start.
    kept, keys : (m, 3) float64 and (m,) uint64, filled up to ``count``.

    Returns
    -------
    The threshold and the count after these points; the threshold halves whenever m are kept.
    """
    for i in range(len(points)):
        key = mixed(np.uint64(first_number + i), np.uint64(1)) >> np.uint64(32)
        if key >= np.uint64(threshold):
            continue
        if count == len(keys):
            threshold //= 2
            left = 0
            for k in range(count):
                if keys[k] < np.uint64(threshold):
                    keys[left] = keys[k]
                    kept[left] = kept[k]
                    left += 1
            count = left
            if key >= np.uint64(threshold):
                continue
        keys[count] = key
        kept[count] = points[i]
        count += 1
    return threshold, count


@nb.njit(cache=True, nogil=True)
def neighbour_spacing(points: NDArray[np.float64], probes: int, window: int) -> float:
    """Median distance of some points to their nearest among those near them in Morton order.

    Parameters
    ----------
    points : (n, 3) float64 in Morton order.
    probes : how many points are looked at, evenly over the order.
    window : how many places of the order to either side are searched.

    Returns
    -------
    Metres; 0 for fewer than two points.
    """
    n = len(points)
    if n < 2:
        return 0.0
    probes = min(probes, n)
    nearest = np.empty(probes)
    for p in range(probes):
        i = p * n // probes
        best = np.inf
        for j in range(max(0, i - window), min(n, i + window + 1)):
            if j != i:
                x = points[j, 0] - points[i, 0]
                y = points[j, 1] - points[i, 1]
                z = points[j, 2] - points[i, 2]
                best = min(best, x * x + y * y + z * z)
        nearest[p] = np.sqrt(best)
    return np.median(nearest)
