"""Light that reaches surface points by way of other surfaces, kept at the vertices."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def bounced_light(
    seen: NDArray[np.int32],
    triangles: NDArray[np.int32],
    radiosity: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Irradiance (n, 3) at vertices: mean radiosity of the triangles that their rays meet.

    ``seen`` (n, rays) int32 names the triangle each cosine-distributed ray meets, −1 for
    none; ``radiosity`` (n, 3) is that of the vertices.
    """
    n, rays = seen.shape
    out = np.zeros((n, 3), np.float32)
    for v in range(n):
        for r in range(rays):
            t = seen[v, r]
            if t < 0:
                continue
            for k in range(3):
                out[v, k] += (
                    radiosity[triangles[t, 0], k]
                    + radiosity[triangles[t, 1], k]
                    + radiosity[triangles[t, 2], k]
                )
        for k in range(3):
            out[v, k] /= 3.0 * rays
    return out


@njit(cache=True, nogil=True)
def neighbour_means(
    triangles: NDArray[np.int32], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Each vertex's value (n, k) averaged with those of its triangles' other corners."""
    total = values.copy()
    count = np.ones(len(values), np.float32)
    for t in range(len(triangles)):
        for corner in range(3):
            v = triangles[t, corner]
            for other in range(3):
                if other != corner:
                    count[v] += 1.0
                    for k in range(values.shape[1]):
                        total[v, k] += values[triangles[t, other], k]
    for v in range(len(values)):
        for k in range(values.shape[1]):
            total[v, k] /= count[v]
    return total


@njit(cache=True, nogil=True)
def gathered_light(
    triangle: NDArray[np.int64],
    uv: NDArray[np.float32],
    triangles: NDArray[np.int32],
    vertex_light: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Light (n, 3) at hits from that at vertices, linear over each triangle."""
    out = np.empty((len(triangle), 3), np.float32)
    for i in range(len(triangle)):
        t = triangle[i]
        b, c = uv[i, 0], uv[i, 1]
        for k in range(3):
            out[i, k] = (
                (1.0 - b - c) * vertex_light[triangles[t, 0], k]
                + b * vertex_light[triangles[t, 1], k]
                + c * vertex_light[triangles[t, 2], k]
            )
    return out
