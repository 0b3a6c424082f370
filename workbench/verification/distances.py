"""Distances between points and triangle surfaces, to float64 accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas

# Below this barycentric weight a closest point counts as lying on the opposite edge.
_ON_BORDER = 1e-12
_QUERIES_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class SurfaceDistances:
    """The closest surface point of each of n query points.

    Attributes
    ----------
    distance_m : (n,) float64, not negative, in the unit of the coordinates (metres).
    triangle : (n,) int32, the triangle the closest point lies on.
    barycentric : (n, 3) float64, weights of that triangle's corners; they sum to 1.
    offset : (n, 3) float64, query point minus closest point.
    """

    distance_m: NDArray[np.float64]
    triangle: NDArray[np.int32]
    barycentric: NDArray[np.float64]
    offset: NDArray[np.float64]

    def nearest_vertex(self, mesh: TriangleMesh) -> NDArray[np.int32]:
        """(n,) the corner of the found triangle that weighs most in the closest point."""
        return nearest_corners(mesh, self.triangle, self.barycentric)


@dataclass(frozen=True)
class DistanceSummary:
    """What is commonly told of a set of distances; all in metres.

    Attributes
    ----------
    count : number of distances.
    rms, mean, median, p95, maximum : of the absolute distances.
    bias : mean of the signed distances; NaN where they have no sign.
    """

    count: int
    rms: float
    mean: float
    median: float
    p95: float
    maximum: float
    bias: float = float("nan")

    @classmethod
    def of(cls, distances_m: ArrayLike, *, signed: bool = False) -> DistanceSummary:
        """Summarise (n,) distances; all values are NaN when there are none."""
        values = np.asarray(distances_m, float)
        if not len(values):
            nan = float("nan")
            return cls(0, nan, nan, nan, nan, nan)
        absolute = np.abs(values)
        median, p95 = np.percentile(absolute, [50, 95])
        return cls(
            len(values),
            float(np.sqrt(np.mean(absolute**2))),
            float(absolute.mean()),
            float(median),
            float(p95),
            float(absolute.max()),
            float(values.mean()) if signed else float("nan"),
        )


def distance_to_surface(points: ArrayLike, mesh: TriangleMesh) -> SurfaceDistances:
    """Closest surface point of every query point.

    Embree finds the closest triangle in float32 after the middle of the mesh has been
    subtracted; the distance to that triangle is then computed in float64. The result is
    never too small, and too large by no more than the float32 rounding of the search,
    about 1e-6 of the largest distance of mesh or query from the mesh's middle: where two
    triangles are that nearly equally close, the other one may be taken.

    Parameters
    ----------
    points
        (n, 3) in the frame and unit of the mesh.
    mesh
        at least one triangle.

    Raises
    ------
    InputError
        If the mesh has no triangle.
    """
    import open3d as o3d  # Costs seconds: only who measures pays.

    if not len(mesh.triangles):
        raise InputError(
            "distances to a surface without triangles are not defined",
            expected="a mesh with at least one triangle",
        )
    queries = np.asarray(points, float).reshape(-1, 3)
    used = mesh.vertices[np.unique(mesh.triangles)]
    middle = 0.5 * (used.min(axis=0) + used.max(axis=0))
    centered = mesh.vertices - middle
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(centered.astype(np.float32)),
        o3d.core.Tensor.from_numpy(mesh.triangles.astype(np.uint32)),
    )
    n = len(queries)
    triangle = np.empty(n, np.int32)
    barycentric, offset = np.empty((n, 3)), np.empty((n, 3))
    for start in range(0, n, _QUERIES_AT_ONCE):
        part = slice(start, start + _QUERIES_AT_ONCE)
        local = queries[part] - middle
        found = scene.compute_closest_points(o3d.core.Tensor.from_numpy(local.astype(np.float32)))
        triangle[part] = found["primitive_ids"].numpy().astype(np.int32)
        corners = centered[mesh.triangles[triangle[part]]]
        barycentric[part] = closest_barycentric(local, corners)
        offset[part] = local - np.einsum("ij,ijk->ik", barycentric[part], corners)
    return SurfaceDistances(np.linalg.norm(offset, axis=1), triangle, barycentric, offset)


def closest_barycentric(
    points: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Barycentric weights (n, 3) of the point of each triangle closest to its query point.

    The closest point is the projection on the plane where that falls inside, else the best
    point of the three edges; both are computed for all, which suits arrays better than the
    case tree of Ericson 2005, 5.1.5, and leaves no case out for degenerate triangles.

    Parameters
    ----------
    points
        (n, 3) float64.
    corners
        (n, 3 corners, 3) float64, one triangle per point.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    d20, d21 = _dot(ap, ab), _dot(ap, ac)
    area = d00 * d11 - d01 * d01
    safe = np.where(area > 0, area, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    inside = (area > 0) & (v >= 0) & (w >= 0) & (v + w <= 1)
    best = np.stack([1 - v - w, v, w], axis=1)
    best_square = np.where(inside, 0.0, np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, second] - corners[:, first]
        from_first = points - corners[:, first]
        length = _dot(edge, edge)
        share = np.clip(_dot(from_first, edge) / np.where(length > 0, length, 1.0), 0, 1)
        rest = from_first - share[:, None] * edge
        square = _dot(rest, rest)
        closer = np.flatnonzero(square < best_square)
        best[closer] = 0.0
        best[closer, first] = 1 - share[closer]
        best[closer, second] = share[closer]
        best_square[closer] = square[closer]
    return best


def signed_distances_m(found: SurfaceDistances, mesh: TriangleMesh) -> NDArray[np.float64]:
    """Distances (n,) float64 with the side: positive outside, negative inside.

    The side is that of the angle-weighted pseudonormal at the closest point (Bærentzen and
    Aanæs 2005, IEEE TVCG 11(3), section 3), which is right at faces, edges and corners of a
    consistently oriented closed mesh. An open mesh has sides only near its faces, and one
    whose faces do not share vertices has wrong ones at its edges.
    """
    pseudonormal = _pseudonormals(found, mesh)
    side = _dot(found.offset, pseudonormal)
    return np.where(side < 0, -found.distance_m, found.distance_m)


def nearest_corners(
    mesh: TriangleMesh, triangle: NDArray[np.int32], barycentric: NDArray[np.float64]
) -> NDArray[np.int32]:
    """(n,) the corner each surface point belongs to: the one with the largest weight.

    Each corner owns a third of a triangle's area.
    """
    chosen = barycentric.argmax(axis=1)
    return np.asarray(mesh.triangles[triangle, chosen], np.int32)


def vertex_areas(mesh: TriangleMesh) -> NDArray[np.float64]:
    """(n,) surface area each vertex stands for: a third of that of its triangles."""
    _, area = face_normals_and_areas(mesh)
    corners = mesh.triangles.ravel()
    return np.bincount(corners, np.repeat(area / 3, 3), len(mesh.vertices)).astype(np.float64)


def _pseudonormals(found: SurfaceDistances, mesh: TriangleMesh) -> NDArray[np.float64]:
    """(n, 3) normals, not normalised, of the face, edge or vertex each closest point is on."""
    unit, _ = face_normals_and_areas(mesh)
    result = unit[found.triangle]
    weights = found.barycentric
    away = weights < _ON_BORDER
    on_edge = np.flatnonzero(away.sum(axis=1) == 1)
    if len(on_edge):
        opposite = away[on_edge].argmax(axis=1)
        triangles = mesh.triangles[found.triangle[on_edge]]
        rows = np.arange(len(on_edge))
        ends = triangles[rows, (opposite + 1) % 3], triangles[rows, (opposite + 2) % 3]
        result[on_edge] = _edge_normals(mesh, unit, ends)
    on_vertex = np.flatnonzero(away.sum(axis=1) == 2)
    if len(on_vertex):
        normals = _angle_weighted_normals(mesh, unit)
        corner = weights[on_vertex].argmax(axis=1)
        result[on_vertex] = normals[mesh.triangles[found.triangle[on_vertex], corner]]
    return result


def _edge_normals(
    mesh: TriangleMesh,
    unit: NDArray[np.float64],
    ends: Sequence[NDArray[np.int32]],
) -> NDArray[np.float64]:
    """Sum of the unit normals of the faces at each asked edge, (k, 3)."""
    n = len(mesh.vertices)

    def keys(first: NDArray[np.int32], second: NDArray[np.int32]) -> NDArray[np.int64]:
        low, high = np.minimum(first, second), np.maximum(first, second)
        return low.astype(np.int64) * n + high

    wanted, place = np.unique(keys(*ends), return_inverse=True)
    total = np.zeros((len(wanted), 3))
    for k in range(3):
        key = keys(mesh.triangles[:, k], mesh.triangles[:, (k + 1) % 3])
        slot = np.minimum(np.searchsorted(wanted, key), len(wanted) - 1)
        mine = np.flatnonzero(wanted[slot] == key)
        np.add.at(total, slot[mine], unit[mine])
    return np.asarray(total[place])


def _angle_weighted_normals(mesh: TriangleMesh, unit: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum (n, 3) of face normals times the angle each face has at the vertex."""
    corners = mesh.vertices[mesh.triangles]
    total = np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        u = corners[:, (k + 1) % 3] - corners[:, k]
        v = corners[:, (k + 2) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), _dot(u, v))
        np.add.at(total, mesh.triangles[:, k], unit * angle[:, None])
    return total


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.einsum("ij,ij->i", a, b), np.float64)
