"""Triangles drawn into pixels: the front-most of all, and all that lie close behind it.

Corners are on a grid of 1/256 pixel and edges are compared in whole numbers, so that of two
triangles that share an edge exactly one draws a pixel whose middle lies on it: the one that has
it at its top or left. That is the rule of graphics hardware.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Corners beyond this overflow the products of edges; who calls clips before.
FARTHEST_PX = float(1 << 21)
_GRID = 256
_SHIFT = 8
_HALF = 128
_NONE = -1

Edge = tuple[int, int, int]
Plane = tuple[float, float, float, float, float]


@njit(cache=True, nogil=True)
def _edge(ax: int, ay: int, bx: int, by: int) -> Edge:
    """Of E(x, y) = right · y − down · x + rest, ≥ 0 inside: (right, down, rest)."""
    right, down = bx - ax, by - ay
    rest = down * ax - right * ay
    # A middle on the line belongs to the triangle that has the line at its left or top.
    if not (down < 0 or (down == 0 and right > 0)):
        rest -= 1
    return right, down, rest


@njit(cache=True, nogil=True, error_model="numpy")
def _narrowed(edge: Edge, y: int, first: int, last: int) -> tuple[int, int]:
    """Columns from first to last whose middles are inside an edge, in the row with middle y."""
    right, down, rest = edge
    level = right * y + rest - down * _HALF
    if down > 0:
        last = min(last, (level >> _SHIFT) // down)
    elif down < 0:
        first = max(first, -((level >> _SHIFT) // -down))
    elif level < 0:
        last = first - 1
    return first, last


@njit(cache=True, nogil=True)
def _shape(
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    triangle: NDArray[np.int32],
    width: int,
    height: int,
) -> tuple[int, int, int, int, Edge, Edge, Edge, Plane]:
    """Rows and columns a triangle may touch, its edges, and 1 / depth as a plane over pixels.

    The last row is before the first where nothing is to be drawn: the triangle turns its back,
    has no area, or is outside.
    """
    # Front faces run counter-clockwise for who looks, which is clockwise where y goes down:
    # with b and c exchanged their area is positive.
    a, b, c = triangle[0], triangle[2], triangle[1]
    ax, ay = round(pixels[a, 0] * _GRID), round(pixels[a, 1] * _GRID)
    bx, by = round(pixels[b, 0] * _GRID), round(pixels[b, 1] * _GRID)
    cx, cy = round(pixels[c, 0] * _GRID), round(pixels[c, 1] * _GRID)
    top = max((min(ay, by, cy) + _HALF - 1) >> _SHIFT, 0)
    bottom = min((max(ay, by, cy) - _HALF) >> _SHIFT, height - 1)
    left = max((min(ax, bx, cx) + _HALF - 1) >> _SHIFT, 0)
    right = min((max(ax, bx, cx) - _HALF) >> _SHIFT, width - 1)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    ab, bc, ca = _edge(ax, ay, bx, by), _edge(bx, by, cx, cy), _edge(cx, cy, ax, ay)
    if area <= 0 or left > right:
        return 0, -1, left, right, ab, bc, ca, (0.0, 0.0, 0.0, 0.0, 0.0)
    za, zb, zc = 1.0 / depths[a], 1.0 / depths[b], 1.0 / depths[c]
    x, y = pixels[a, 0], pixels[a, 1]
    ux, uy, vx, vy = pixels[b, 0] - x, pixels[b, 1] - y, pixels[c, 0] - x, pixels[c, 1] - y
    twice = ux * vy - uy * vx
    if not twice > 0.5 * area / _GRID**2:
        # So small that the rounding of its corners has made it: only rounded it has a slope.
        x, y = ax / _GRID, ay / _GRID
        ux, uy, vx, vy = bx / _GRID - x, by / _GRID - y, cx / _GRID - x, cy / _GRID - y
        twice = area / _GRID**2
    across = ((zb - za) * vy - (zc - za) * uy) / twice
    down = ((zc - za) * ux - (zb - za) * vx) / twice
    plane = (za - across * x - down * y, across, down, min(za, zb, zc), max(za, zb, zc))
    return top, bottom, left, right, ab, bc, ca, plane


@njit(cache=True, nogil=True)
def _depth(plane: Plane, row: int, column: int) -> np.float32:
    """At a pixel's middle, and never outside of what the corners have."""
    nearness = plane[0] + plane[1] * (column + 0.5) + plane[2] * (row + 0.5)
    return np.float32(1.0 / min(max(nearness, plane[3]), plane[4]))


@njit(cache=True, nogil=True)
def draw_front(
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    triangles: NDArray[np.int32],
    numbers: NDArray[np.int32],
    depth: NDArray[np.float32],
    triangle: NDArray[np.int32],
) -> None:
    """Draw triangles with a z-buffer; the nearest wins, the first among equals.

    Between corners depth runs as on a plane seen by a pinhole: 1 / depth is linear.

    Parameters
    ----------
    pixels, depths : (n, 2) and (n,) of the corners, in front of the camera and not farther than
        `FARTHEST_PX` from the picture.
    triangles : (m, 3), counter-clockwise for who looks; others are not drawn.
    numbers : (m,) what they are called.
    depth : (h, w) nearest so far, infinite for none; changed in place.
    triangle : (h, w) number of the nearest; changed in place.
    """
    height, width = depth.shape
    for t in range(len(triangles)):
        top, bottom, left, right, ab, bc, ca, plane = _shape(
            pixels, depths, triangles[t], width, height
        )
        for row in range(top, bottom + 1):
            y = row * _GRID + _HALF
            first, last = _narrowed(ab, y, left, right)
            first, last = _narrowed(bc, y, first, last)
            first, last = _narrowed(ca, y, first, last)
            for column in range(first, last + 1):
                z = _depth(plane, row, column)
                if z < depth[row, column]:
                    depth[row, column] = z
                    triangle[row, column] = numbers[t]


@njit(cache=True, nogil=True)
def draw_competing(
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    triangles: NDArray[np.int32],
    numbers: NDArray[np.int32],
    first_of_mesh: int,
    front: NDArray[np.float32],
    reach: NDArray[np.float32],
    foreground: NDArray[np.bool_],
    penalties: NDArray[np.float32],
    slot_depth: NDArray[np.float32],
    slot_triangle: NDArray[np.int32],
) -> None:
    """Collect the fragments of one mesh that lie near the front-most: those who compete.

    While a foreground fragment competes, background ones do not. A mesh competes once at a
    pixel, with its nearest. Where more compete than there are slots, the lowest penalties stay.

    Parameters
    ----------
    pixels, depths, triangles, numbers : as for `draw_front`.
    first_of_mesh : the mesh's lowest number; all meshes drawn before have lower ones.
    front : (h, w) front-most depth of all meshes.
    reach : (t,) how far behind it fragments of each triangle may lie, by number.
    foreground, penalties : (t,) of the triangles of all meshes, by number.
    slot_depth, slot_triangle : (h, w, k); triangles are −1 in empty slots, which come last;
        changed in place.
    """
    height, width, slots = slot_depth.shape
    for t in range(len(triangles)):
        top, bottom, left, right, ab, bc, ca, plane = _shape(
            pixels, depths, triangles[t], width, height
        )
        number = numbers[t]
        for row in range(top, bottom + 1):
            y = row * _GRID + _HALF
            first, last = _narrowed(ab, y, left, right)
            first, last = _narrowed(bc, y, first, last)
            first, last = _narrowed(ca, y, first, last)
            for column in range(first, last + 1):
                z = _depth(plane, row, column)
                if z > front[row, column] + reach[number]:
                    continue
                depth, held = slot_depth[row, column], slot_triangle[row, column]
                if held[0] != _NONE and foreground[held[0]] != foreground[number]:
                    if foreground[held[0]]:
                        continue
                    held[:] = _NONE
                place, worst = _NONE, penalties[number]
                for s in range(slots):
                    if held[s] == _NONE:
                        place = s
                        break
                    if held[s] >= first_of_mesh:
                        place = s if z < depth[s] else _NONE
                        break
                    if penalties[held[s]] > worst:
                        place, worst = s, penalties[held[s]]
                if place != _NONE:
                    depth[place] = z
                    held[place] = number
