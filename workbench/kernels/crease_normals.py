"""Normals at the corners of triangles, smooth across gentle edges and split at creases."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def crease_normals(
    triangles: NDArray[np.int32],
    first_face: NDArray[np.int64],
    faces: NDArray[np.int64],
    face_normals: NDArray[np.float64],
    face_areas: NDArray[np.float64],
    crease_cosine: float,
) -> NDArray[np.float32]:
    """Unit normal (m, 3, 3) float32 of every corner of every triangle.

    Parameters
    ----------
    triangles : (m, 3) vertices.
    first_face : (n + 1,) where the faces of each vertex begin in ``faces``.
    faces : (3 m,) the triangles that meet at each vertex.
    face_normals : (m, 3) unit normals.
    face_areas : (m,) weights.
    crease_cosine : a face counts at a corner when the cosine between its normal and that of
        the corner's own face is at least this.
    """
    out = np.empty((len(triangles), 3, 3), np.float32)
    for t in range(len(triangles)):
        nx, ny, nz = face_normals[t, 0], face_normals[t, 1], face_normals[t, 2]
        for corner in range(3):
            vertex = triangles[t, corner]
            sx, sy, sz = 1e-12 * nx, 1e-12 * ny, 1e-12 * nz
            for place in range(first_face[vertex], first_face[vertex + 1]):
                f = faces[place]
                ox, oy, oz = face_normals[f, 0], face_normals[f, 1], face_normals[f, 2]
                if nx * ox + ny * oy + nz * oz >= crease_cosine:
                    sx += face_areas[f] * ox
                    sy += face_areas[f] * oy
                    sz += face_areas[f] * oz
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            if length > 0.0:
                out[t, corner, 0] = sx / length
                out[t, corner, 1] = sy / length
                out[t, corner, 2] = sz / length
            else:
                out[t, corner, 0], out[t, corner, 1], out[t, corner, 2] = nx, ny, nz
    return out
