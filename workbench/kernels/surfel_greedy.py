"""Farthest-first order of points: each next one is the farthest from all before it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.morton import morton_code

# Points of one leaf fill the vector registers; its box still tells where they are.
_LEAF, _FAN = 32, 8
_NO_NORMALS = np.zeros((0, 3), np.float32)


def farthest_first(
    points: NDArray[np.float64],
    count: int,
    first: int,
    normals: NDArray[np.float32] | None = None,
    opposite: float = 0.0,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int32]]:
    """The greedy permutation's first ``count`` points, exactly.

    Points lie along a Morton curve, in leaves of 32 under a tree of eight children a node; each
    node knows its box and the largest distance that is left in it. A new point goes down only
    where its distance to the box is smaller than that, which late in the order is almost
    nowhere.

    Distances are those of float32 coordinates from the middle of the points. Between points
    whose unit normals have the cosine c, the squared distance is larger by
    (``opposite`` · max(0, −c))².

    Parameters
    ----------
    points
        (n, 3), finite, at least one.
    count
        How many to take; fewer come where the rest are copies of these.
    first
        Row of the first point.
    normals
        (n, 3) unit; needed for ``opposite`` alone.
    opposite
        What opposite normals add, in the unit of the points.

    Returns
    -------
    picks : (k,) rows in order.
    reach : (k + 1,) the largest distance of any point to the first i picks at i, infinite at 0;
        it is the distance of pick i to those before it, too.
    owner : (n,) the pick that is nearest to each point, by its place in the order.
    """
    order, centered = _along_morton_curve(points)
    sided = opposite > 0.0 and normals is not None
    columns = np.ascontiguousarray(centered.T)
    across = _NO_NORMALS.T
    if normals is not None and sided:
        across = np.ascontiguousarray(normals[order].T, np.float32)
    starts = _level_starts(len(points))
    boxes = np.empty((starts[-1], 6), np.float32)
    _fill_boxes(columns, starts, boxes)
    picks = np.empty(min(count, len(points)), np.int64)
    squared = np.empty(len(picks), np.float32)
    place = int(np.flatnonzero(order == first)[0])
    square = np.float32(opposite * opposite if sided else 0.0)
    along = np.empty(len(points), np.int32)
    taken, last = _take(columns, across, square, starts, boxes, place, picks, squared, along)
    owner = np.empty_like(along)
    owner[order] = along
    reach = np.sqrt(np.append(squared[:taken], last).astype(np.float64))
    return order[picks[:taken]], reach, owner


def _along_morton_curve(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Rows (n,) along the curve and the points (n, 3) in that order, from their middle."""
    # Column by column: along rows of three NumPy takes ten times as long.
    lower = np.array([points[:, axis].min() for axis in range(3)])
    upper = np.array([points[:, axis].max() for axis in range(3)])
    extent = float((upper - lower).max())
    index_bits = max(1, (len(points) - 1).bit_length())
    # One word holds cell and row: to sort words is many times faster than to sort rows by cell.
    axis_bits = min(21, (64 - index_bits) // 3)
    keys = np.empty(len(points), np.uint64)
    scale = (2**axis_bits - 1) / extent if extent > 0.0 else 0.0
    _fill_keys(points, lower, scale, index_bits, keys)
    keys.sort()
    order = np.empty(len(points), np.int64)
    centered = np.empty((len(points), 3), np.float32)
    mask = np.uint64((1 << index_bits) - 1)
    _unpack_keys(points, 0.5 * (lower + upper), keys, mask, order, centered)
    return order, centered


def _level_starts(count: int) -> NDArray[np.int64]:
    """Where the nodes of each level begin, leaves first, and their number at the end."""
    sizes = [math.ceil(count / _LEAF)]
    while sizes[-1] > _FAN:
        sizes.append(math.ceil(sizes[-1] / _FAN))
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


@njit(cache=True, nogil=True)
def _fill_keys(
    points: NDArray[np.float64],
    lower: NDArray[np.float64],
    scale: float,
    index_bits: int,
    keys: NDArray[np.uint64],
) -> None:
    for i in range(len(points)):
        code = morton_code(
            int((points[i, 0] - lower[0]) * scale),
            int((points[i, 1] - lower[1]) * scale),
            int((points[i, 2] - lower[2]) * scale),
        )
        keys[i] = (code << np.uint64(index_bits)) | np.uint64(i)


@njit(cache=True, nogil=True)
def _unpack_keys(
    points: NDArray[np.float64],
    middle: NDArray[np.float64],
    keys: NDArray[np.uint64],
    mask: np.uint64,
    order: NDArray[np.int64],
    centered: NDArray[np.float32],
) -> None:
    for i in range(len(keys)):
        row = np.int64(keys[i] & mask)
        order[i] = row
        for axis in range(3):
            centered[i, axis] = points[row, axis] - middle[axis]


@njit(cache=True, nogil=True)
def _fill_boxes(
    columns: NDArray[np.float32], starts: NDArray[np.int64], boxes: NDArray[np.float32]
) -> None:
    """Lower and upper bound (nodes, 6), axis by axis."""
    for leaf in range(starts[1]):
        low, high = leaf * _LEAF, min(leaf * _LEAF + _LEAF, columns.shape[1])
        for axis in range(3):
            boxes[leaf, 2 * axis] = columns[axis, low:high].min()
            boxes[leaf, 2 * axis + 1] = columns[axis, low:high].max()
    for level in range(1, len(starts) - 1):
        for node in range(starts[level], starts[level + 1]):
            low = starts[level - 1] + (node - starts[level]) * _FAN
            high = min(low + _FAN, starts[level])
            for axis in range(3):
                boxes[node, 2 * axis] = boxes[low:high, 2 * axis].min()
                boxes[node, 2 * axis + 1] = boxes[low:high, 2 * axis + 1].max()


# No distance is NaN, and only so the running maximum fits the vector registers.
@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})
def _nearer(
    columns: NDArray[np.float32],
    left: NDArray[np.float32],
    owner: NDArray[np.int32],
    number: np.int32,
    low: int,
    high: int,
    pick: int,
) -> np.float32:
    """Bring a leaf's squared distances to a new pick down; the largest that is left."""
    x, y, z = columns[0], columns[1], columns[2]
    px, py, pz = x[pick], y[pick], z[pick]
    largest = np.float32(0.0)
    for i in range(low, high):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        squared = dx * dx + dy * dy + dz * dz
        owner[i] = number if squared < left[i] else owner[i]
        left[i] = min(left[i], squared)
        largest = max(largest, left[i])
    return largest


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})
def _nearer_same_side(
    columns: NDArray[np.float32],
    across: NDArray[np.float32],
    opposite: np.float32,
    left: NDArray[np.float32],
    owner: NDArray[np.int32],
    number: np.int32,
    low: int,
    high: int,
    pick: int,
) -> np.float32:
    """`_nearer`, where normals that turn away from each other count as distance."""
    x, y, z = columns[0], columns[1], columns[2]
    u, v, w = across[0], across[1], across[2]
    px, py, pz = x[pick], y[pick], z[pick]
    pu, pv, pw = u[pick], v[pick], w[pick]
    largest = np.float32(0.0)
    for i in range(low, high):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        away = max(np.float32(0.0), -(u[i] * pu + v[i] * pv + w[i] * pw))
        squared = dx * dx + dy * dy + dz * dz + opposite * away * away
        owner[i] = number if squared < left[i] else owner[i]
        left[i] = min(left[i], squared)
        largest = max(largest, left[i])
    return largest


@njit(cache=True, nogil=True)
def _box_distance(box: NDArray[np.float32], x: float, y: float, z: float) -> np.float32:
    """Squared distance of a place to a box, 0 inside."""
    none = np.float32(0.0)
    dx = max(box[0] - x, x - box[1], none)
    dy = max(box[2] - y, y - box[3], none)
    dz = max(box[4] - z, z - box[5], none)
    squared: np.float32 = dx * dx + dy * dy + dz * dz
    return squared


@njit(cache=True, nogil=True)
def _touched(
    columns: NDArray[np.float32],
    starts: NDArray[np.int64],
    boxes: NDArray[np.float32],
    top: NDArray[np.float32],
    pick: int,
    nodes: NDArray[np.int64],
    ends: NDArray[np.int64],
) -> None:
    """Nodes that a new pick may be nearer to than all before, level by level from the top.

    ``ends[level]`` is where those of a level end in ``nodes``; they begin where those of the
    level above end.
    """
    x, y, z = columns[0, pick], columns[1, pick], columns[2, pick]
    levels = len(starts) - 1
    count = 0
    for node in range(starts[levels - 1], starts[levels]):
        if _box_distance(boxes[node], x, y, z) < top[node]:
            nodes[count] = node
            count += 1
    ends[levels] = 0
    ends[levels - 1] = count
    for level in range(levels - 1, 0, -1):
        for k in range(ends[level + 1], ends[level]):
            low = starts[level - 1] + (nodes[k] - starts[level]) * _FAN
            for child in range(low, min(low + _FAN, starts[level])):
                if _box_distance(boxes[child], x, y, z) < top[child]:
                    nodes[count] = child
                    count += 1
        ends[level - 1] = count


@njit(cache=True, nogil=True)
def _take(
    columns: NDArray[np.float32],
    across: NDArray[np.float32],
    opposite: np.float32,
    starts: NDArray[np.int64],
    boxes: NDArray[np.float32],
    first: int,
    picks: NDArray[np.int64],
    squared: NDArray[np.float32],
    owner: NDArray[np.int32],
) -> tuple[int, np.float32]:
    """Fill the picks, their squared distances to those before and the pick nearest to each point.

    Returns how many picks there are and the largest squared distance that is left.
    """
    points, levels = columns.shape[1], len(starts) - 1
    left = np.full(points, np.float32(np.inf), np.float32)
    top = np.full(starts[levels], np.float32(np.inf), np.float32)
    nodes = np.empty(starts[levels], np.int64)
    ends = np.empty(levels + 1, np.int64)
    pick, distance = first, np.float32(np.inf)
    for i in range(len(picks)):
        if distance == 0.0:
            return i, distance
        picks[i], squared[i] = pick, distance
        _touched(columns, starts, boxes, top, pick, nodes, ends)
        for k in range(ends[1], ends[0]):
            low = nodes[k] * _LEAF
            high = min(low + _LEAF, points)
            if across.shape[1]:
                top[nodes[k]] = _nearer_same_side(
                    columns, across, opposite, left, owner, np.int32(i), low, high, pick
                )
            else:
                top[nodes[k]] = _nearer(columns, left, owner, np.int32(i), low, high, pick)
        for level in range(1, levels):
            for k in range(ends[level + 1], ends[level]):
                low = starts[level - 1] + (nodes[k] - starts[level]) * _FAN
                top[nodes[k]] = top[low : min(low + _FAN, starts[level])].max()
        node = starts[levels - 1] + np.argmax(top[starts[levels - 1] : starts[levels]])
        for level in range(levels - 1, 0, -1):
            low = starts[level - 1] + (node - starts[level]) * _FAN
            node = low + np.argmax(top[low : min(low + _FAN, starts[level])])
        low = node * _LEAF
        pick = low + np.argmax(left[low : min(low + _LEAF, points)])
        distance = left[pick]
    return len(picks), distance
