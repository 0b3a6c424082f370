"""Passes over whole pictures, pixel by pixel, as shaders would do them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.barycentric import corner_shares

_NONE = -1


@njit(cache=True, nogil=True)
def lowest_penalties(
    slot_triangle: NDArray[np.int32],
    slot_depth: NDArray[np.float32],
    penalties: NDArray[np.float32],
) -> NDArray[np.int8]:
    """Slot (h, w) of the lowest penalty, the nearer among equals; −1 where all are empty."""
    height, width, slots = slot_triangle.shape
    chosen = np.full((height, width), _NONE, np.int8)
    for row in range(height):
        for column in range(width):
            best, z = np.float32(np.inf), np.float32(np.inf)
            for s in range(slots):
                t = slot_triangle[row, column, s]
                if t == _NONE:
                    break
                deep = slot_depth[row, column, s]
                if penalties[t] < best or (penalties[t] == best and deep < z):
                    best, z, chosen[row, column] = penalties[t], deep, s
    return chosen


@njit(cache=True, nogil=True)
def voted(
    chosen: NDArray[np.int8],
    voters: NDArray[np.int8],
    slot_triangle: NDArray[np.int32],
    slot_depth: NDArray[np.float32],
    labels: NDArray[np.int32],
    meshes: NDArray[np.int32],
    penalties: NDArray[np.float32],
    epsilon: float,
    radius: int,
    label_weight: float,
    mesh_weight: float,
) -> NDArray[np.int8]:
    """Choose again at every pixel, knowing what its neighbours chose; all pixels at once.

    A fragment's cost is its penalty, plus `label_weight` times the share of neighbours that
    chose another label, plus `mesh_weight` times the share that chose another mesh. Neighbours
    are those in a square around that show the same surface: their depth differs by no more than
    ε for each pixel of distance.

    Parameters
    ----------
    chosen : (h, w) slots as chosen before, −1 for none.
    voters : the same, but −1 also where a pixel is to have no vote yet.
    slot_triangle, slot_depth : (h, w, k) of those who compete.
    labels, meshes, penalties : (t,) of the triangles.
    epsilon : metres.
    radius : half the square's side, pixels.
    label_weight, mesh_weight : in units of the penalty.

    Returns
    -------
    (h, w) slots.
    """
    height, width, slots = slot_triangle.shape
    out = chosen.copy()
    label, mesh, depth = _as_chosen(voters, slot_triangle, slot_depth, labels, meshes)
    own_label = np.empty(slots, np.int32)
    own_mesh = np.empty(slots, np.int32)
    same_label = np.empty(slots)
    same_mesh = np.empty(slots)
    for row in range(height):
        for column in range(width):
            mine = chosen[row, column]
            if mine == _NONE or slots < 2 or slot_triangle[row, column, 1] == _NONE:
                continue
            count = 0
            for s in range(slots):
                t = slot_triangle[row, column, s]
                if t == _NONE:
                    break
                own_label[s], own_mesh[s] = labels[t], meshes[t]
                same_label[s], same_mesh[s] = 0.0, 0.0
                count += 1
            z = slot_depth[row, column, mine]
            neighbours = 0
            for r in range(max(row - radius, 0), min(row + radius, height - 1) + 1):
                for c in range(max(column - radius, 0), min(column + radius, width - 1) + 1):
                    far = max(abs(r - row), abs(c - column))
                    # Where nothing is, depth is infinite.
                    if far == 0 or not abs(depth[r, c] - z) <= epsilon * far:
                        continue
                    neighbours += 1
                    for s in range(count):
                        same_label[s] += own_label[s] == label[r, c]
                        same_mesh[s] += own_mesh[s] == mesh[r, c]
            if neighbours == 0:
                continue
            best = np.inf
            for s in range(count):
                cost = penalties[slot_triangle[row, column, s]]
                cost += label_weight * (1.0 - same_label[s] / neighbours)
                cost += mesh_weight * (1.0 - same_mesh[s] / neighbours)
                if cost < best or (cost == best and s == mine):
                    best = cost
                    out[row, column] = s
    return out


@njit(cache=True, nogil=True)
def _as_chosen(
    chosen: NDArray[np.int8],
    slot_triangle: NDArray[np.int32],
    slot_depth: NDArray[np.float32],
    labels: NDArray[np.int32],
    meshes: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Label, mesh and depth (h, w) of the chosen slots; depth is infinite where none is."""
    label = np.full(chosen.shape, _NONE, np.int32)
    mesh = np.full(chosen.shape, _NONE, np.int32)
    depth = np.full(chosen.shape, np.inf, np.float32)
    for row in range(chosen.shape[0]):
        for column in range(chosen.shape[1]):
            s = chosen[row, column]
            if s != _NONE:
                t = slot_triangle[row, column, s]
                label[row, column], mesh[row, column] = labels[t], meshes[t]
                depth[row, column] = slot_depth[row, column, s]
    return label, mesh, depth


@njit(cache=True, nogil=True)
def corner_colors(
    places: NDArray[np.float64],
    triangle: NDArray[np.int32],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    colors: NDArray[np.uint8],
) -> NDArray[np.float32]:
    """Colours (n, 3) in [0, 1] between the corners of triangles (n,) at places (n, 3)."""
    out = np.empty((len(places), 3), np.float32)
    for i in range(len(places)):
        a, b, c = triangles[triangle[i]]
        wa, wb, wc = corner_shares(places, i, vertices, a, b, c)
        for k in range(3):
            mixed = wa * colors[a, k] + wb * colors[b, k] + wc * colors[c, k]
            out[i, k] = mixed / 255.0
    return out


@njit(cache=True, nogil=True)
def between_texels(
    picture: NDArray[np.uint8], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colours (n, 3) in [0, 1] and coverage (n,) of a picture (h, w, 4) at pixels (n, 2).

    Bilinear over the texels whose alpha is not 0: those that may not be used take no part, and
    coverage is the share of the weight that the others have. 0 outside the picture.
    """
    height, width, _ = picture.shape
    out = np.zeros((len(pixels), 3), np.float32)
    coverage = np.zeros(len(pixels), np.float32)
    for i in range(len(pixels)):
        x, y = pixels[i, 0], pixels[i, 1]
        if not (x >= 0.0 and y >= 0.0 and x <= width and y <= height):
            continue
        x = min(max(x - 0.5, 0.0), width - 1.0)
        y = min(max(y - 0.5, 0.0), height - 1.0)
        left, top = int(x), int(y)
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        u, v = x - left, y - top
        red, green, blue, total = 0.0, 0.0, 0.0, 0.0
        for corner in range(4):
            row = bottom if corner >= 2 else top
            column = right if corner % 2 else left
            if picture[row, column, 3] == 0:
                continue
            weight = (v if corner >= 2 else 1.0 - v) * (u if corner % 2 else 1.0 - u)
            red += weight * picture[row, column, 0]
            green += weight * picture[row, column, 1]
            blue += weight * picture[row, column, 2]
            total += weight
        coverage[i] = total
        if total > 0.0:
            out[i, 0] = red / (255.0 * total)
            out[i, 1] = green / (255.0 * total)
            out[i, 2] = blue / (255.0 * total)
    return out, coverage
