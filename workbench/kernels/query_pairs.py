"""Queries of query pairs — a tile of rays and a box of a hierarchy — and their refinement.

Source: Jaspe 2018, 4.4.4 and 4.5.1; Mattausch et al. 2015, "CHC+RT: Coherent Hierarchical
Culling for Ray Tracing".
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

#: States of a pair: not asked yet, no ray meets its box, to intersect, divided.
UNKNOWN, INVISIBLE, VISIBLE, DIVIDED = 0, 1, 2, 3
#: Columns of a pair.
TILE, NODE, PARENT, STATE = 0, 1, 2, 3
#: Columns of a node and of a tile: their children; −1 for none.
LEFT, RIGHT = 0, 1
#: Most pairs that one step of the refinement adds.
CHILDREN = 4
# What rounding of the entry and of the stored hit may differ by, relative.
_SLACK = np.float32(1.0 - 1e-5)
# Rays that are held against a box before it is seen whether that suffices.
_AT_ONCE = 128


@njit(cache=True, nogil=True)
def _mark_meeting(
    origins: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    first: int | np.integer,
    last: int | np.integer,
    box: NDArray[np.float32],
    marks: NDArray[np.uint8],
) -> None:
    """Set marks of rays ``first`` to ``last``, from 0 on, that enter a box before their nearest.

    Choices instead of min and max, and rows for axes, let the compiler take several rays at once.
    """
    x, y, z = origins[0, first:last], origins[1, first:last], origins[2, first:last]
    u, v, w = inverse[0, first:last], inverse[1, first:last], inverse[2, first:last]
    limit = nearest[first:last]
    x0, y0, z0, x1, y1, z1 = box[0], box[1], box[2], box[3], box[4], box[5]
    for i in range(len(limit)):
        enter, leave = np.float32(0.0), limit[i]
        one, two = (x0 - x[i]) * u[i], (x1 - x[i]) * u[i]
        low, high = (one, two) if one < two else (two, one)
        enter = low if low > enter else enter
        leave = high if high < leave else leave
        one, two = (y0 - y[i]) * v[i], (y1 - y[i]) * v[i]
        low, high = (one, two) if one < two else (two, one)
        enter = low if low > enter else enter
        leave = high if high < leave else leave
        one, two = (z0 - z[i]) * w[i], (z1 - z[i]) * w[i]
        low, high = (one, two) if one < two else (two, one)
        enter = low if low > enter else enter
        leave = high if high < leave else leave
        marks[i] |= np.uint8(1) if enter * _SLACK <= leave else np.uint8(0)


@njit(cache=True, nogil=True)
def pair_is_visible(
    origins: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    first: int | np.integer,
    last: int | np.integer,
    node: int | np.integer,
    boxes: NDArray[np.float32],
    children: NDArray[np.int32],
    ends: NDArray[np.bool_],
    threshold: int,
) -> bool:
    """Whether more than ``threshold`` of the rays ``first`` to ``last`` meet a node.

    ``origins`` and ``inverse``, finite reciprocals of directions, are (3, r); a ray whose nearest
    hit so far is negative meets nothing. Of a node that is divided further its two children's
    boxes are asked: they are tighter together.
    """
    marks = np.empty(_AT_ONCE, np.uint8)
    count = 0
    for begin in range(first, last, _AT_ONCE):
        end = min(begin + _AT_ONCE, last)
        marks[:] = 0
        if ends[node]:
            _mark_meeting(origins, inverse, nearest, begin, end, boxes[node], marks)
        else:
            left, right = children[node, LEFT], children[node, RIGHT]
            _mark_meeting(origins, inverse, nearest, begin, end, boxes[left], marks)
            _mark_meeting(origins, inverse, nearest, begin, end, boxes[right], marks)
        for i in range(_AT_ONCE):
            count += int(marks[i])
        if count > threshold:
            return True
    return False


@njit(cache=True, nogil=True)
def push(
    keys: NDArray[np.float32], queue: NDArray[np.int32], size: int, key: float, pair: int
) -> int:
    """Add a pair to a heap of ``size`` with the least key on top; returns the new size."""
    at = size
    while at > 0:
        above = (at - 1) // 2
        if keys[above] < key or (keys[above] == key and queue[above] < pair):
            break
        keys[at], queue[at] = keys[above], queue[above]
        at = above
    keys[at], queue[at] = key, pair
    return size + 1


@njit(cache=True, nogil=True)
def _pop(keys: NDArray[np.float32], queue: NDArray[np.int32], size: int) -> int:
    """Move the last of the heap to where the top was; returns the new size."""
    size -= 1
    key, pair = keys[size], queue[size]
    at = 0
    while 2 * at + 1 < size:
        below = 2 * at + 1
        other = below + 1
        if other < size and (
            keys[other] < keys[below]
            or (keys[other] == keys[below] and queue[other] < queue[below])
        ):
            below = other
        if key < keys[below] or (key == keys[below] and pair < queue[below]):
            break
        keys[at], queue[at] = keys[below], queue[below]
        at = below
    keys[at], queue[at] = key, pair
    return size


@njit(cache=True, nogil=True)
def box_distance(point: NDArray[np.float32], box: NDArray[np.float32]) -> np.float32:
    """Squared distance of a point (3,) to a box (6,), float32; 0 inside."""
    total = np.float32(0.0)
    for axis in range(3):
        off = max(max(box[axis] - point[axis], point[axis] - box[3 + axis]), np.float32(0.0))
        total += off * off
    return total


@njit(cache=True, nogil=True)
def refine_pairs(
    pairs: NDArray[np.int32],
    count: int,
    keys: NDArray[np.float32],
    queue: NDArray[np.int32],
    size: int,
    origins: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    slices: NDArray[np.int64],
    quarters: NDArray[np.int32],
    middles: NDArray[np.float32],
    tile_shares: NDArray[np.float32],
    boxes: NDArray[np.float32],
    children: NDArray[np.int32],
    ends: NDArray[np.bool_],
    node_shares: NDArray[np.float32],
    balance: float,
    threshold: int,
    found: NDArray[np.int32],
) -> tuple[int, int, int, int]:
    """Ask pairs of the queue, nearest first, and divide the visible ones, until some are found.

    Parameters
    ----------
    pairs : (p, 4) int32: tile, node, parent pair and state; ``count`` of them are there.
    keys, queue : (p,) heap of pairs to ask, ``size`` of them.
    origins, inverse, nearest : (3, r), (3, r) and (r,) float32, as of `pair_is_visible`.
    slices : (t, 2) first ray of a tile and the one behind its last.
    quarters : (t,) first of a tile's four children, which follow one another; −1 for none.
    middles : (t, 3) about where the rays of a tile begin.
    tile_shares : (t,) of all rays.
    boxes : (n, 6) of the nodes; ``children`` (n, 2); ``ends`` (n,) whether a node is divided no
        further.
    node_shares : (n,) area of a node's box, of the root's.
    balance : t_q of the rule that decides between dividing the box or the tile.
    threshold : pairs with no more rays than that are invisible; 0 is conservative.
    found : written, visible pairs that are divided no further.

    Returns
    -------
    The new ``count`` and ``size``, how many were found, and how many queries were asked. It stops
    early where ``pairs`` is full.
    """
    hits, queries = 0, 0
    while size > 0 and hits < len(found) and count + CHILDREN <= len(pairs):
        pair = queue[0]
        size = _pop(keys, queue, size)
        tile, node = pairs[pair, TILE], pairs[pair, NODE]
        queries += 1
        if not pair_is_visible(
            origins, inverse, nearest, slices[tile, 0], slices[tile, 1], node, boxes, children,
            ends, threshold,
        ):  # fmt: skip
            pairs[pair, STATE] = INVISIBLE
            continue
        whole_tile = quarters[tile] < 0
        if ends[node] and whole_tile:
            pairs[pair, STATE] = VISIBLE
            found[hits] = pair
            hits += 1
            continue
        pairs[pair, STATE] = DIVIDED
        by_object = whole_tile or node_shares[node] > balance * tile_shares[tile]
        if by_object and not ends[node]:
            for side in range(2):
                child = children[node, side]
                pairs[count, TILE], pairs[count, NODE] = tile, child
                pairs[count, PARENT], pairs[count, STATE] = pair, UNKNOWN
                size = push(keys, queue, size, box_distance(middles[tile], boxes[child]), count)
                count += 1
        else:
            for side in range(4):
                part = quarters[tile] + side
                pairs[count, TILE], pairs[count, NODE] = part, node
                pairs[count, PARENT], pairs[count, STATE] = pair, UNKNOWN
                size = push(keys, queue, size, box_distance(middles[part], boxes[node]), count)
                count += 1
    return count, size, hits, queries


@njit(cache=True, nogil=True)
def gather_rays(
    rays: NDArray[np.float32],
    origins: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    slices: NDArray[np.int64],
    box: NDArray[np.float32],
    gathered: NDArray[np.float32],
    numbers: NDArray[np.int64],
) -> int:
    """Copy the rays (r, 6) of some tiles, ``slices`` (k, 2), that meet a box; returns how many.

    ``gathered`` (m, 6) and ``numbers`` (m,) are written; m is no less than the rays of the tiles.
    """
    count = 0
    marks = np.empty(_AT_ONCE, np.uint8)
    for k in range(len(slices)):
        for begin in range(slices[k, 0], slices[k, 1], _AT_ONCE):
            end = min(begin + _AT_ONCE, slices[k, 1])
            marks[:] = 0
            _mark_meeting(origins, inverse, nearest, begin, end, box, marks)
            for i in range(begin, end):
                if marks[i - begin]:
                    for axis in range(6):
                        gathered[count, axis] = rays[i, axis]
                    numbers[count] = i
                    count += 1
    return count


@njit(cache=True, nogil=True)
def keep_nearest(
    numbers: NDArray[np.int64],
    distances: NDArray[np.float32],
    names: NDArray[np.int64],
    normals: NDArray[np.float32],
    nearest: NDArray[np.float32],
    triangles: NDArray[np.int64],
    kept_normals: NDArray[np.float32],
) -> None:
    """Take the hits of some rays where they are nearer, or as near and of a lower number.

    Parameters
    ----------
    numbers : (m,) rays; ``distances``, ``names`` and ``normals`` (m, 3) their hits, a name of −1
        for none.
    nearest, triangles, kept_normals : (r,), (r,) and (r, 3), of all rays, changed.
    """
    for k in range(len(numbers)):
        i = numbers[k]
        if names[k] < 0 or distances[k] > nearest[i]:
            continue
        if distances[k] < nearest[i] or triangles[i] < 0 or names[k] < triangles[i]:
            nearest[i], triangles[i] = distances[k], names[k]
            for axis in range(3):
                kept_normals[i, axis] = normals[k, axis]


@njit(cache=True, nogil=True)
def visible_groups(
    origins: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    slices: NDArray[np.int64],
    starts: NDArray[np.int64],
    tiles: NDArray[np.int32],
    nodes: NDArray[np.int32],
    boxes: NDArray[np.float32],
    children: NDArray[np.int32],
    ends: NDArray[np.bool_],
    threshold: int,
) -> NDArray[np.bool_]:
    """One query for each group of nodes over one tile: whether any of them has become visible.

    Group ``g`` is of tile ``tiles[g]`` and ``nodes[starts[g]:starts[g + 1]]``.
    """
    answer = np.zeros(len(tiles), np.bool_)
    for g in range(len(tiles)):
        first, last = slices[tiles[g], 0], slices[tiles[g], 1]
        for k in range(starts[g], starts[g + 1]):
            if pair_is_visible(
                origins, inverse, nearest, first, last, nodes[k], boxes, children, ends, threshold
            ):
                answer[g] = True
                break
    return answer
