"""Which parts of a surface were measured and which were filled in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.neighbours import k_nearest, tree_of
from workbench.geometry.samples import Samples
from workbench.kernels.mesh_pieces import pieces_of

MEASURED, INFILLED = 0, 1
PHOTOGRAPHED, INPAINTED, UNCOLORED = 0, 1, 2
_NEIGHBOURS = 6
_LEAST_COSINE = 0.5
# Height over a sample's tangent plane, relative to its reach, that curvature explains.
_PLANE_TOLERANCE = 0.25
_TRIANGLES_AT_ONCE = 1 << 22


@dataclass(frozen=True)
class Support:
    """What the samples say about the vertices of a surface.

    Attributes
    ----------
    provenance : (n,) uint8, 0 measured, 1 infilled.
    distance_m : (n,) float64, to the closest sample.
    nearest : (n,) int64, that sample.
    """

    provenance: NDArray[np.uint8]
    distance_m: NDArray[np.float64]
    nearest: NDArray[np.int64]


def support_of(
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    samples: Samples,
    reach_factor: float,
) -> Support:
    """Tell measured from infilled vertices.

    A vertex is measured where one of its closest samples lies within that sample's own
    reach (``radius_m`` times ``reach_factor``), faces within 60° of the same way, and has
    the vertex near its tangent plane. The back of a thin wall, the wall of a crevice and the
    web that closes a gap are close to samples and yet not measured by them.
    """
    tree = tree_of(samples.points)
    k = min(_NEIGHBOURS, len(samples))
    distance, index = k_nearest(tree, vertices, k)
    within = distance <= reach_factor * samples.radius_m[index]
    facing = np.einsum("vi,vki->vk", normals, samples.normals[index]) > _LEAST_COSINE
    offset = np.einsum(
        "vki,vki->vk", vertices[:, None] - samples.points[index], samples.normals[index]
    )
    beside = np.abs(offset) <= _PLANE_TOLERANCE * samples.radius_m[index]
    measured = (within & facing & beside).any(axis=1)
    return Support(
        np.where(measured, MEASURED, INFILLED).astype(np.uint8), distance[:, 0], index[:, 0]
    )


def told_by_samples(mesh: TriangleMesh, samples: Samples, reach_factor: float) -> TriangleMesh:
    """The mesh with ``provenance``, ``distance_to_samples_m`` and, where known, ``color``.

    Parameters
    ----------
    mesh : with ``normal`` at its vertices.
    samples : possibly none; all is infilled then, and the distance infinite.
    reach_factor : as for `support_of`.
    """
    n = len(mesh.vertices)
    if not len(samples):
        return mesh.with_attributes(
            provenance=np.full(n, INFILLED, np.uint8), distance_to_samples_m=np.full(n, np.inf)
        )
    normals = mesh.vertex_attributes["normal"]
    support = support_of(mesh.vertices, normals, samples, reach_factor)
    mesh = mesh.with_attributes(
        provenance=support.provenance, distance_to_samples_m=support.distance_m
    )
    if samples.color is None:
        return mesh
    return mesh.with_attributes(color=samples.color[support.nearest])


def without_unmeasured_pieces(
    mesh: TriangleMesh, provenance: NDArray[np.uint8]
) -> tuple[NDArray[np.bool_], int]:
    """Triangles of pieces with a measured vertex, and how many pieces have none.

    A closed piece taken away leaves a closed surface.
    """
    piece = pieces_of(mesh.triangles, len(mesh.vertices))
    has_measured = np.zeros(len(piece), bool)
    has_measured[piece[provenance == MEASURED]] = True
    used = np.zeros(len(piece), bool)
    used[piece[mesh.triangles[:, 0]]] = True
    return has_measured[piece[mesh.triangles[:, 0]]], int((used & ~has_measured).sum())


def near_samples(
    mesh: TriangleMesh, distance_m: NDArray[np.float64], limit_m: float
) -> NDArray[np.bool_]:
    """(m,) triangles with all vertices within ``limit_m`` of a sample.

    One vertex near by is not enough: far from samples triangles are as large as coarse cells, and
    those at the border would reach out as spikes.
    """
    return np.asarray((distance_m[mesh.triangles] <= limit_m).all(axis=1))


def measured_area_share(mesh: TriangleMesh) -> float:
    """Measured share of the area, in [0, 1]; a triangle counts by its measured corners."""
    measured = mesh.vertex_attributes["provenance"] == MEASURED
    total, seen = 0.0, 0.0
    for at in range(0, len(mesh.triangles), _TRIANGLES_AT_ONCE):
        triangles = mesh.triangles[at : at + _TRIANGLES_AT_ONCE]
        _, areas = face_normals_and_areas(TriangleMesh(mesh.vertices, triangles))
        total += float(areas.sum())
        seen += float((areas * measured[triangles].mean(axis=1)).sum())
    return seen / total if total > 0 else 0.0
