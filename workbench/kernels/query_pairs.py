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


@njit(cache=True, nogil=True)
def meets_box(
    ray: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: float | np.floating,
    box: NDArray[np.float32],
) -> bool:
    """Whether a ray (6,) enters a box (6,) no later than its nearest hit so far.

    ``inverse`` (3,) holds finite reciprocals of the direction. A ray whose nearest is negative
    meets nothing.
    """
    enter, leave = np.float32(0.0), np.float32(nearest)
    for axis in range(3):
        one = (box[axis] - ray[axis]) * inverse[axis]
        two = (box[3 + axis] - ray[axis]) * inverse[axis]
        enter = max(enter, min(one, two))
        leave = min(leave, max(one, two))
    return bool(enter * _SLACK <= leave)


@njit(cache=True, nogil=True)
def _meets_node(
    rays: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    i: int | np.integer,
    node: int | np.integer,
    boxes: NDArray[np.float32],
    children: NDArray[np.int32],
    ends: NDArray[np.bool_],
) -> bool:
    """Of a node that is divided further its two children's boxes are asked: tighter together."""
    if ends[node]:
        return bool(meets_box(rays[i], inverse[i], nearest[i], boxes[node]))
    left, right = boxes[children[node, LEFT]], boxes[children[node, RIGHT]]
    return bool(
        meets_box(rays[i], inverse[i], nearest[i], left)
        or meets_box(rays[i], inverse[i], nearest[i], right)
    )


@njit(cache=True, nogil=True)
def pair_is_visible(
    rays: NDArray[np.float32],
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
    """Whether more than ``threshold`` of the rays ``first`` to ``last`` meet a node."""
    count = 0
    for i in range(first, last):
        if _meets_node(rays, inverse, nearest, i, node, boxes, children, ends):
            count += 1
            if count > threshold:
                return True
    return False


@njit(cache=True, nogil=True)
def any_pair_is_visible(
    rays: NDArray[np.float32],
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    first: int,
    last: int,
    nodes: NDArray[np.int32],
    boxes: NDArray[np.float32],
    children: NDArray[np.int32],
    ends: NDArray[np.bool_],
    threshold: int,
) -> bool:
    """One query of several nodes over one tile: whether any of them has become visible."""
    counts = np.zeros(len(nodes), np.int64)
    for i in range(first, last):
        if nearest[i] < 0.0:
            continue
        for k in range(len(nodes)):
            if _meets_node(rays, inverse, nearest, i, nodes[k], boxes, children, ends):
                counts[k] += 1
                if counts[k] > threshold:
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
    rays: NDArray[np.float32],
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
    rays, inverse, nearest : (r, 6), (r, 3) and (r,) float32, as of `meets_box`.
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
            rays, inverse, nearest, slices[tile, 0], slices[tile, 1], node, boxes, children, ends,
            threshold,
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
    inverse: NDArray[np.float32],
    nearest: NDArray[np.float32],
    slices: NDArray[np.int64],
    box: NDArray[np.float32],
    gathered: NDArray[np.float32],
    numbers: NDArray[np.int64],
) -> int:
    """Copy the rays of some tiles, ``slices`` (k, 2), that meet a box; returns how many.

    ``gathered`` (m, 6) and ``numbers`` (m,) are written; m is no less than the rays of the tiles.
    """
    count = 0
    for k in range(len(slices)):
        for i in range(slices[k, 0], slices[k, 1]):
            if meets_box(rays[i], inverse[i], nearest[i], box):
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
    rays: NDArray[np.float32],
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
        answer[g] = any_pair_is_visible(
            rays, inverse, nearest, first, last, nodes[starts[g] : starts[g + 1]], boxes,
            children, ends, threshold,
        )  # fmt: skip
    return answer
