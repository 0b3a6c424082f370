"""A mesh's vertices as samples to be coloured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.photo_view import PlainBlock

_SAMPLES_AT_ONCE = 1 << 20


def blocks_of_mesh(mesh: TriangleMesh) -> list[PlainBlock]:
    """The vertices in order, some at a time; each stands for what lies around it.

    Normals are those of the mesh, where it has some. A vertex without triangles has no spacing,
    and no normal.
    """
    known = mesh.vertex_attributes.get("normal")
    normals = vertex_normals(mesh) if known is None else np.asarray(known, np.float64)
    spacing = vertex_spacing(mesh)
    cuts = range(0, len(mesh.vertices), _SAMPLES_AT_ONCE)
    return [
        PlainBlock(at, mesh.vertices[part], normals[part], spacing[part])
        for at in cuts
        for part in (slice(at, at + _SAMPLES_AT_ONCE),)
    ]


def vertex_spacing(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Mean length (n,) of the edges at each vertex; 0 for one without."""
    total, count = np.zeros(len(mesh.vertices)), np.zeros(len(mesh.vertices))
    for k in range(3):
        start, end = mesh.triangles[:, k], mesh.triangles[:, (k + 1) % 3]
        length = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
        for corner in (start, end):
            total += np.bincount(corner, length, len(total))
            count += np.bincount(corner, minlength=len(total))
    return total / np.maximum(count, 1.0)
