"""Triangle meshes and what can be proven about them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.crease_normals import crease_normals

_EDGES_AT_ONCE = 1 << 25
_ATTRIBUTE = "vertex_"


@dataclass(frozen=True)
class TriangleMesh:
    """An indexed triangle mesh, counter-clockwise seen from outside.

    Attributes
    ----------
    vertices : (n, 3) float64.
    triangles : (m, 3) int32.
    vertex_attributes : name → (n,) or (n, k) array, e.g. ``normal`` (n, 3) float64,
        ``color`` (n, 3) uint8 sRGB, ``provenance`` (n,) uint8.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    vertex_attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def with_attributes(self, **attributes: NDArray[Any]) -> TriangleMesh:
        """The same mesh with further (or replaced) vertex attributes."""
        return TriangleMesh(self.vertices, self.triangles, {**self.vertex_attributes, **attributes})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored: ``vertices``, ``triangles`` and ``vertex_`` + name of each attribute."""
        attributes = {f"{_ATTRIBUTE}{k}": v for k, v in self.vertex_attributes.items()}
        return {"vertices": self.vertices, "triangles": self.triangles, **attributes}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> TriangleMesh:
        """The mesh that `arrays` told; further arrays are passed over."""
        attributes = {
            name.removeprefix(_ATTRIBUTE): values
            for name, values in arrays.items()
            if name.startswith(_ATTRIBUTE)
        }
        return cls(arrays["vertices"], arrays["triangles"], attributes)

    def keep_triangles(self, keep: NDArray[np.bool_]) -> TriangleMesh:
        """The triangles where ``keep`` (m,) is true and the vertices they use, in order."""
        triangles = self.triangles[keep]
        used = np.zeros(len(self.vertices), bool)
        used[triangles] = True
        new_index = np.cumsum(used, dtype=np.int64) - 1
        return TriangleMesh(
            self.vertices[used],
            new_index[triangles].astype(np.int32),
            {name: values[used] for name, values in self.vertex_attributes.items()},
        )


@dataclass(frozen=True)
class EdgeCensus:
    """How many faces meet at the edges of a mesh.

    ``watertight`` asks that every edge has exactly two faces which run through it in
    opposite directions: closed, edge-manifold and consistently oriented. It says nothing
    of self-intersection.
    """

    edges: int
    boundary_edges: int
    nonmanifold_edges: int
    misoriented_edges: int

    @property
    def watertight(self) -> bool:
        return (
            self.edges > 0
            and not self.boundary_edges
            and not self.nonmanifold_edges
            and not self.misoriented_edges
        )


def edge_census(triangles: NDArray[np.int32]) -> EdgeCensus:
    """Count the faces at every undirected edge of (m, 3) triangles.

    Large meshes are counted in several passes, so that memory does not grow with them.
    """
    span = int(triangles.max(initial=0)) + 1
    passes = max(1, math.ceil(3 * len(triangles) / _EDGES_AT_ONCE))
    counted = np.zeros(4, np.int64)
    for part in range(passes):
        first, last = span * part // passes, span * (part + 1) // passes
        counted += _edges_from(triangles, first, last, span)
    return EdgeCensus(*(int(count) for count in counted))


def _edges_from(
    triangles: NDArray[np.int32], first: int, last: int, span: int
) -> NDArray[np.int64]:
    """The numbers of the census (4,) for edges whose lower vertex is in [first, last)."""
    names = []
    for k in range(3):
        start, end = triangles[:, k], triangles[:, (k + 1) % 3]
        low = np.minimum(start, end)
        here = np.flatnonzero((low >= first) & (low < last))
        start, low = start[here].astype(np.int64), low[here].astype(np.int64)
        high = start + end[here] - low
        # The last bit tells which way the face runs along its edge.
        names.append(2 * (low * span + high) + (start < high))
    name = np.sort(np.concatenate(names))
    edge = name >> 1
    starts = np.flatnonzero(np.diff(edge, prepend=-1) != 0)
    faces = np.diff(np.append(starts, len(edge)))
    forward = np.add.reduceat(name & 1, starts) if len(starts) else np.zeros(0, np.int64)
    return np.array(
        [
            len(faces),
            (faces == 1).sum(),
            (faces > 2).sum(),
            ((faces == 2) & (forward != 1)).sum(),
        ]
    )


def face_normals_and_areas(mesh: TriangleMesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals (m, 3) — zero for degenerate faces — and areas (m,)."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0, length, 1.0)[:, None], 0.5 * length


def vertex_normals(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Area-weighted unit vertex normals (n, 3); zero where no face with area touches."""
    unit, area = face_normals_and_areas(mesh)
    weighted = unit * area[:, None]
    corners = mesh.triangles.ravel()
    repeated = np.repeat(weighted, 3, axis=0)
    total = np.stack(
        [np.bincount(corners, repeated[:, k], len(mesh.vertices)) for k in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def corner_normals(mesh: TriangleMesh, crease_deg: float) -> NDArray[np.float32]:
    """Unit shading normals (m, 3, 3) at the corners of every triangle.

    Parameters
    ----------
    mesh : the mesh.
    crease_deg : edges whose faces differ by more stay sharp.
    """
    normals, areas = face_normals_and_areas(mesh)
    corners = mesh.triangles.ravel()
    order = np.argsort(corners, kind="stable")
    first = np.searchsorted(corners[order], np.arange(len(mesh.vertices) + 1))
    smooth: NDArray[np.float32] = crease_normals(
        mesh.triangles, first, order // 3, normals, areas, np.cos(np.radians(crease_deg))
    )
    return smooth
