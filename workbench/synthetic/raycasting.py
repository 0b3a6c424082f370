"""Rays against a mesh: Embree finds the triangle, float64 finds the point."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh

NO_TRIANGLE = -1
# Below this cosine the plane of the triangle no longer fixes the point along the ray.
_GRAZING_COSINE = 1e-5


@dataclass(frozen=True)
class Hits:
    """Where n rays first meet the mesh.

    Attributes
    ----------
    distance : (n,) float64 along the ray in lengths of its direction, infinite for a miss.
    triangle : (n,) int64, `NO_TRIANGLE` for a miss.
    barycentric : (n, 3) float64 weights of the triangle's corners, 0 for a miss.
    cosine : (n,) float64 in [0, 1] between the ray and the facet's normal, 0 for a miss.
    """

    distance: NDArray[np.float64]
    triangle: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    cosine: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.distance)


class RayCaster:
    """A mesh made ready for rays; build it once, cast from it often.

    Embree works in float32, so vertices and ray origins are taken relative to the middle of
    the mesh, and the distance is refined in float64 as the meeting of the ray with the plane
    of the triangle that Embree named. A hit lies exactly on its ray and its triangle's plane.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        # Costs seconds: only who casts rays pays.
        o3d: Any = importlib.import_module("open3d")
        self._o3d = o3d
        self._middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        self._triangles = mesh.triangles
        self._vertices = mesh.vertices - self._middle
        self._embree = o3d.t.geometry.RaycastingScene()
        self._embree.add_triangles(
            o3d.core.Tensor(self._vertices.astype(np.float32)),
            o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
        )

    def cast(self, origins: NDArray[np.float64], directions: NDArray[np.float64]) -> Hits:
        """First hits of rays from ``origins`` (3,) or (n, 3) along unit ``directions`` (n, 3)."""
        start = np.broadcast_to(origins - self._middle, directions.shape)
        rays = np.concatenate([start, directions], axis=1).astype(np.float32)
        answer = self._embree.cast_rays(self._o3d.core.Tensor(rays))
        distance = answer["t_hit"].numpy().astype(np.float64)
        hit = np.isfinite(distance)
        triangle = np.full(len(rays), NO_TRIANGLE, np.int64)
        triangle[hit] = answer["primitive_ids"].numpy()[hit]
        uv = answer["primitive_uvs"].numpy()[hit].astype(np.float64)
        barycentric = np.zeros((len(rays), 3))
        barycentric[hit] = np.column_stack([1.0 - uv.sum(axis=1), uv])
        cosine = np.zeros(len(rays))
        a, b, c = (self._vertices[self._triangles[triangle[hit], k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        slope = np.einsum("ij,ij->i", normal, directions[hit])
        toward = np.einsum("ij,ij->i", normal, a - start[hit])
        steep = np.abs(slope) > _GRAZING_COSINE
        refined = np.where(steep, toward / np.where(steep, slope, 1.0), distance[hit])
        # A sliver's plane can be far off; Embree's float32 distance bounds the correction.
        close = np.abs(refined - distance[hit]) <= 1e-3 * (1.0 + distance[hit])
        distance[hit] = np.where(close, refined, distance[hit])
        cosine[hit] = np.abs(slope)
        return Hits(distance, triangle, barycentric, cosine)
