"""How well a photograph shows triangles, by distance and angle.

Source: Arikan et al., eq. 2–4, without the area.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def seen_triangles(
    triangles: NDArray[np.int32],
    seen: NDArray[np.bool_],
    middles: NDArray[np.float64],
    normals: NDArray[np.float64],
    center: NDArray[np.float64],
    least_cosine: float,
) -> NDArray[np.int32]:
    """(k,) triangles of which all vertices are ``seen`` (n,) and that face the camera.

    ``least_cosine`` is what the angle between normal and view must exceed.
    """
    out = np.empty(len(triangles), np.int32)
    count = 0
    for t in range(len(triangles)):
        if not (seen[triangles[t, 0]] and seen[triangles[t, 1]] and seen[triangles[t, 2]]):
            continue
        x, y, z = center[0] - middles[t, 0], center[1] - middles[t, 1], center[2] - middles[t, 2]
        along = x * normals[t, 0] + y * normals[t, 1] + z * normals[t, 2]
        if along > least_cosine * math.sqrt(x * x + y * y + z * z):
            out[count] = t
            count += 1
    return out[:count].copy()


@njit(cache=True, nogil=True)
def penalties(
    which: NDArray[np.int32],
    middles: NDArray[np.float64],
    normals: NDArray[np.float64],
    center: NDArray[np.float64],
    far: float,
    distance: float,
    orientation: float,
) -> NDArray[np.float64]:
    """(k,) weighted sum of distance, clamped at ``far``, and orientation of some triangles."""
    out = np.empty(len(which))
    for k in range(len(which)):
        t = which[k]
        x, y, z = middles[t, 0] - center[0], middles[t, 1] - center[1], middles[t, 2] - center[2]
        away = math.sqrt(x * x + y * y + z * z)
        along = abs(x * normals[t, 0] + y * normals[t, 1] + z * normals[t, 2])
        cosine = min(along / away, 1.0) if away > 0.0 else 0.0
        out[k] = distance * min(away, far) / far + orientation * (1.0 - cosine)
    return out
