"""Which photographs an edge between two triangles may show, and their colours along it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def labels_of_edges(
    edges: NDArray[np.int32], starts: NDArray[np.int64], labels: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Starts (e + 1,) and labels (d,) of what is a candidate of either triangle, rising."""
    n = len(edges)
    edge_starts = np.zeros(n + 1, np.int64)
    out = np.empty(0, np.int32)
    for filling in (False, True):
        for e in range(n):
            a, b = starts[edges[e, 0]], starts[edges[e, 1]]
            a_end, b_end = starts[edges[e, 0] + 1], starts[edges[e, 1] + 1]
            at = edge_starts[e]
            while a < a_end or b < b_end:
                if b >= b_end or (a < a_end and labels[a] < labels[b]):
                    label = labels[a]
                    a += 1
                elif a >= a_end or labels[b] < labels[a]:
                    label = labels[b]
                    b += 1
                else:
                    label = labels[a]
                    a += 1
                    b += 1
                if filling:
                    out[at] = label
                at += 1
            if not filling:
                edge_starts[e + 1] = at
        if not filling:
            out = np.empty(edge_starts[n], np.int32)
    return edge_starts, out


@njit(cache=True, nogil=True)
def read_edges(
    rows: NDArray[np.int64],
    ends: NDArray[np.int64],
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    picture: NDArray[np.uint8],
    colors: NDArray[np.uint16],
) -> None:
    """Fill rows (r,) of colours (d, s, 3) with those of a picture (h, w, 4) along edges.

    Places are regular along the edge in the world, each the middle of its share; between the ends'
    pixels they are found as a pinhole has them. Pixels of alpha 0 tell only where nothing else
    does; beyond the picture it goes on as at its edge.

    Parameters
    ----------
    ends : (r, 2) which of the pixels (n, 2) and depths (n,) the ends are.
    """
    h, w = picture.shape[:2]
    samples = colors.shape[1]
    for r in range(len(rows)):
        a, b = ends[r, 0], ends[r, 1]
        for s in range(samples):
            t = (s + 0.5) / samples
            near_a, near_b = (1.0 - t) * depths[a], t * depths[b]
            share = near_b / (near_a + near_b)
            x = (1.0 - share) * pixels[a, 0] + share * pixels[b, 0] - 0.5
            y = (1.0 - share) * pixels[a, 1] + share * pixels[b, 1] - 0.5
            x = min(max(x, 0.0), w - 1.0)
            y = min(max(y, 0.0), h - 1.0)
            left, top = math.floor(x), math.floor(y)
            right, bottom = min(left + 1, w - 1), min(top + 1, h - 1)
            u, v = x - left, y - top
            p, q, m, n = (1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v
            p_used = p if picture[top, left, 3] > 0 else 0.0
            q_used = q if picture[top, right, 3] > 0 else 0.0
            m_used = m if picture[bottom, left, 3] > 0 else 0.0
            n_used = n if picture[bottom, right, 3] > 0 else 0.0
            used = p_used + q_used + m_used + n_used
            if used > 1e-6:
                p, q, m, n = p_used / used, q_used / used, m_used / used, n_used / used
            for c in range(3):
                value = (
                    p * picture[top, left, c]
                    + q * picture[top, right, c]
                    + m * picture[bottom, left, c]
                    + n * picture[bottom, right, c]
                )
                colors[rows[r], s, c] = np.uint16(value * 257.0 + 0.5)


@njit(cache=True, nogil=True)
def read_points(pixels: NDArray[np.float64], picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(n, 3) colours in [0, 1] of the pixels (n, 2) of a picture (h, w, 4) nearest to points."""
    h, w = picture.shape[:2]
    out = np.empty((len(pixels), 3), np.float32)
    for k in range(len(pixels)):
        i = min(max(math.floor(pixels[k, 0]), 0), w - 1)
        j = min(max(math.floor(pixels[k, 1]), 0), h - 1)
        for c in range(3):
            out[k, c] = picture[j, i, c] / 255.0
    return out
