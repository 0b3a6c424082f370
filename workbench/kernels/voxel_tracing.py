"""Rays through an encoded voxel graph, by a digital differential analyser of all depths.

The walk is that of Jaspe 2018, 5.5.1 (fig. 5.7): the geometry is mirrored, not the ray, by
three bits that children's numbers are combined with, and turned by tables where a graph has
more than mirrors. Rays that run against an axis are mirrored once, at the start, and that
mirror is one more turn to combine with. Where a ray meets a
cell is computed from the cell alone, never summed up along the way: the answer is the same
for every encoding of the same voxels and wherever a ray begins before the first of them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from workbench.kernels.cube_turns import COMPOSED, SLOT, TURNED_MASK
from workbench.kernels.dag_fetch import child_node, root_node

# Rays along an axis: so slow across it that they leave no cell that way.
_SLOWEST = 1e-30


@njit(cache=True, nogil=True)
def trace_rays(
    words: NDArray[np.uint32],
    halves: NDArray[np.uint16],
    bricks: NDArray[np.uint64],
    anchors: NDArray[np.uint32] | None,
    compact: bool,
    starts: NDArray[np.int64],
    root_turn: int,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    nearest: NDArray[np.float64],
    farthest: NDArray[np.float64],
    slope: float,
    distance: NDArray[np.float64],
    cells: NDArray[np.int32],
    sizes: NDArray[np.int32],
) -> None:
    """Fill where each ray first meets a full cell.

    Parameters
    ----------
    words, halves, bricks, anchors, compact, starts, root_turn : the graph, not empty, see
        `workbench.kernels.dag_fetch`; without anchors all turns are mirrors.
    origins, directions : (n, 3) in voxels from the cube's corner; directions are unit.
    nearest, farthest : (n,) the stretch of each ray that counts, in voxels.
    slope : a cell whose side is no more than ``slope`` times its distance is as good as a
        voxel; 0 goes down to voxels always.
    distance : (n,) filled with where the ray enters the cell, infinite where it meets none.
    cells : (n, 3) filled with the cell's lowest voxel.
    sizes : (n,) filled with the side of the cell in voxels, 0 where there is none.
    """
    level = len(starts) - 1
    side = 1 << level
    nodes, heads = np.empty(level, np.int64), np.empty(level, np.int64)
    masks, turns = np.empty(level, np.int64), np.empty(level, np.int64)
    for r in range(len(origins)):
        distance[r], sizes[r] = math.inf, 0
        flip = 0
        ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
        dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
        if dx < 0.0:
            ox, dx, flip = side - ox, -dx, flip | 1
        if dy < 0.0:
            oy, dy, flip = side - oy, -dy, flip | 2
        if dz < 0.0:
            oz, dz, flip = side - oz, -dz, flip | 4
        ix, iy, iz = 1.0 / max(dx, _SLOWEST), 1.0 / max(dy, _SLOWEST), 1.0 / max(dz, _SLOWEST)
        t = max(nearest[r], max(-ox * ix, max(-oy * iy, -oz * iz)))
        end = min(farthest[r], min((side - ox) * ix, min((side - oy) * iy, (side - oz) * iz)))
        if not t < end:
            continue
        node, head, brick, mask = root_node(words, halves, bricks, compact, level)
        turn, depth, h = int64(COMPOSED[flip, root_turn]), 0, side >> 1
        if anchors is not None:
            # Turned once for the node, not child by child as mirrors are.
            mask = int64(TURNED_MASK[np.uint64(turn), np.uint64(mask)])
        cx = h if (h - ox) * ix <= t else 0
        cy = h if (h - oy) * iy <= t else 0
        cz = h if (h - oz) * iz <= t else 0
        while True:
            seen = ((cx & h) != 0) | ((cy & h) != 0) << 1 | ((cz & h) != 0) << 2
            slot = seen ^ turn if anchors is None else seen
            if mask >> slot & 1:
                enters = max(0.0, max((cx - ox) * ix, max((cy - oy) * iy, (cz - oz) * iz)))
                if h == 1 or h <= slope * enters:
                    distance[r], sizes[r] = enters, h
                    cells[r, 0] = side - h - cx if flip & 1 else cx
                    cells[r, 1] = side - h - cy if flip & 2 else cy
                    cells[r, 2] = side - h - cz if flip & 4 else cz
                    break
                nodes[depth], heads[depth] = node, head
                masks[depth], turns[depth] = mask, turn
                depth += 1
                h >>= 1
                if anchors is not None:
                    slot = int64(SLOT[np.uint64(turn), np.uint64(seen)])
                node, head, brick, mask, own = child_node(
                    words, halves, bricks, anchors, compact, starts, depth, node, head, brick, slot
                )
                if anchors is None:
                    turn ^= own
                else:
                    turn = int64(COMPOSED[np.uint64(turn), np.uint64(own)])
                    mask = int64(TURNED_MASK[np.uint64(turn), np.uint64(mask)])
                cx += h if (cx + h - ox) * ix <= t else 0
                cy += h if (cy + h - oy) * iy <= t else 0
                cz += h if (cz + h - oz) * iz <= t else 0
                continue
            tx, ty, tz = (cx + h - ox) * ix, (cy + h - oy) * iy, (cz + h - oz) * iz
            if tx <= ty and tx <= tz:
                t, changed = max(t, tx), cx ^ (cx + h)
                cx += h
            elif ty <= tz:
                t, changed = max(t, ty), cy ^ (cy + h)
                cy += h
            else:
                t, changed = max(t, tz), cz ^ (cz + h)
                cz += h
            # Leaving the cube changes a bit above all cells'.
            if changed >= side or t >= end:
                break
            if changed >= 2 * h:
                while changed >= 2 * h:
                    h *= 2
                    depth -= 1
                cx, cy, cz = cx & -h, cy & -h, cz & -h
                node, head = nodes[depth], heads[depth]
                mask, turn = masks[depth], turns[depth]


@njit(cache=True, nogil=True)
def beam_starts(
    words: NDArray[np.uint32],
    halves: NDArray[np.uint16],
    bricks: NDArray[np.uint64],
    anchors: NDArray[np.uint32] | None,
    compact: bool,
    starts: NDArray[np.int64],
    root_turn: int,
    origin: NDArray[np.float64],
    axes: NDArray[np.float64],
    half_angles: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Fill how far each cone is certainly empty.

    Full cells are followed down, nearer ones first, until they are about as wide as the cone;
    a cell stands for the ball around it, so that none that a ray of the cone meets is missed.

    Parameters
    ----------
    words, halves, bricks, anchors, compact, starts, root_turn : the graph, not empty.
    origin : (3,) tip of all cones, in voxels from the cube's corner.
    axes : (n, 3) unit.
    half_angles : (n,) radians, below a right angle.
    out : (n,) filled with distances in voxels; infinite for a cone that meets nothing.
    """
    level = len(starts) - 1
    room = 8 * level + 8
    at = np.empty((room, 3), np.int64)
    state = np.empty((room, 5), np.int64)
    held = np.empty(room, np.uint64)
    bound = np.empty(room, np.float64)
    for b in range(len(axes)):
        best = math.inf
        sine, cosine = math.sin(half_angles[b]), math.cos(half_angles[b])
        narrow = 2.0 * sine / cosine
        node, head, brick, mask = root_node(words, halves, bricks, compact, level)
        at[0, :] = 0
        state[0, 0], state[0, 1], state[0, 2] = node, head, mask
        state[0, 3], state[0, 4] = root_turn, 0
        held[0], bound[0] = brick, 0.0
        top = 1
        while top > 0:
            top -= 1
            if bound[top] >= best:
                continue
            x, y, z = at[top, 0], at[top, 1], at[top, 2]
            node, head, mask = state[top, 0], state[top, 1], state[top, 2]
            turn, depth = state[top, 3], state[top, 4]
            brick = held[top]
            h = 1 << (level - 1 - depth)
            first = top
            for c in range(8):
                slot = int64(SLOT[turn, c])
                if not mask >> slot & 1:
                    continue
                cx, cy, cz = x + (c & 1) * h, y + (c >> 1 & 1) * h, z + (c >> 2) * h
                px, py, pz = (
                    cx + 0.5 * h - origin[0],
                    cy + 0.5 * h - origin[1],
                    cz + 0.5 * h - origin[2],
                )
                # A hair more than half the diagonal makes up for rounding.
                radius = 0.8661 * h
                away = math.sqrt(px * px + py * py + pz * pz)
                along = px * axes[b, 0] + py * axes[b, 1] + pz * axes[b, 2]
                across = math.sqrt(max(away * away - along * along, 0.0))
                if away > radius and (across * cosine - along * sine > radius or along < -radius):
                    continue
                near = max(away - radius, 0.0)
                if near >= best:
                    continue
                if h == 1 or h <= narrow * near:
                    best = near
                    continue
                deeper = child_node(
                    words,
                    halves,
                    bricks,
                    anchors,
                    compact,
                    starts,
                    depth + 1,
                    node,
                    head,
                    brick,
                    slot,
                )
                # Kept with the farthest lowest, so that the nearest is taken first.
                k = top
                while k > first and bound[k - 1] < near:
                    at[k], state[k] = at[k - 1], state[k - 1]
                    held[k], bound[k] = held[k - 1], bound[k - 1]
                    k -= 1
                at[k, 0], at[k, 1], at[k, 2] = cx, cy, cz
                state[k, 0], state[k, 1], state[k, 2] = deeper[0], deeper[1], deeper[3]
                state[k, 3], state[k, 4] = COMPOSED[turn, deeper[4]], depth + 1
                held[k], bound[k] = deeper[2], near
                top += 1
        out[b] = best
