"""Distances and triangles of a carved solid, cell by cell and block by block."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.bcc_isosurface import block_triangles, mixed_signs
from workbench.kernels.implicit_solids import GROUPS, WEATHERING_M, relevant_rows, solid_distance

BLOCK_CELLS = 4


@njit(cache=True, nogil=True)
def distances_by_cell(
    points: NDArray[np.float64],
    starts: NDArray[np.int64],
    centers: NDArray[np.float64],
    radius: float,
    table: NDArray[np.float64],
    group_blend: NDArray[np.float64],
    detail: NDArray[np.float64],
    cracks: NDArray[np.float64],
    spacing: float,
    seed: int,
) -> NDArray[np.float64]:
    """Unweathered distances (n,) of points (n, 3) sorted by cell, cell c from ``starts[c]`` on.

    ``centers`` (c, 3) and ``radius`` are balls that hold the cells; the further arguments
    are those of ``solid_distance``.
    """
    out = np.empty(len(points))
    nearest = np.empty(GROUPS)
    for cell in range(len(centers)):
        rows = relevant_rows(table, centers[cell], radius)
        for n in range(starts[cell], starts[cell + 1]):
            out[n] = solid_distance(
                table, rows, group_blend, detail, cracks,
                points[n, 0], points[n, 1], points[n, 2], spacing, -1.0, seed, nearest,
            )  # fmt: skip
    return out


@njit(cache=True, nogil=True)
def carve_blocks(
    blocks: NDArray[np.int64],
    low: NDArray[np.float64],
    half_spacing: float,
    stride: int,
    table: NDArray[np.float64],
    group_blend: NDArray[np.float64],
    detail: NDArray[np.float64],
    cracks: NDArray[np.float64],
    seed: int,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Edge names and fractions (m, 3) of the triangles, and which faces (b, 6) they cross.

    Block (i, j, k) begins ``2 BLOCK_CELLS (i, j, k)`` half spacings from ``low``; faces are
    in the order −x, +x, −y, +y, −z, +z. Arguments else as in ``block_triangles`` and
    ``solid_distance``.
    """
    n = BLOCK_CELLS
    spacing = 2.0 * half_spacing
    keys = np.empty((24 * n**3 * len(blocks), 3), np.int64)
    fractions = np.empty((24 * n**3 * len(blocks), 3))
    crossed = np.zeros((len(blocks), 6), np.bool_)
    count = 0
    nearest = np.empty(GROUPS)
    even = np.empty((n + 1, n + 1, n + 1))
    odd = np.empty((n + 1, n + 1, n + 1))
    radius = 0.5 * np.sqrt(3.0) * (n + 0.5) * spacing
    for number in range(len(blocks)):
        first = blocks[number] * (2 * n)
        center = low + (first + (n + 0.5)) * half_spacing
        rows = relevant_rows(table, center, radius)
        for parity in range(2):
            values = odd if parity else even
            for i in range(n + 1):
                x = low[0] + (first[0] + 2 * i + parity) * half_spacing
                for j in range(n + 1):
                    y = low[1] + (first[1] + 2 * j + parity) * half_spacing
                    for k in range(n + 1):
                        z = low[2] + (first[2] + 2 * k + parity) * half_spacing
                        values[i, j, k] = solid_distance(
                            table, rows, group_blend, detail, cracks,
                            x, y, z, spacing, 1.5 * WEATHERING_M, seed, nearest,
                        )  # fmt: skip
        for side in range(2):
            layer = n * side
            crossed[number, side] = mixed_signs(even[layer], odd[layer])
            crossed[number, 2 + side] = mixed_signs(even[:, layer], odd[:, layer])
            crossed[number, 4 + side] = mixed_signs(even[:, :, layer], odd[:, :, layer])
        count = block_triangles(even, odd, first, stride, keys, fractions, count)
    return keys[:count].copy(), fractions[:count].copy(), crossed
