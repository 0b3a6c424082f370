"""Signed distances to the solutions of several blocks as one field without seams.

Where samples are, the field is the distance to the blocks' own surfaces, blended from block to
block. Away from them, in holes, each block would close the surface its own way; there the field
turns into the distance to one coarse solution of the whole, which is closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.surface.block_plan import BlockPlan

# Between these the blocks' say fades: along the surface, in sample spacings from the closest
# sample; off the surface, in cells of the coarse solution. Whatever is thinner than the latter
# allow is lost to the coarse solution and lives on the blocks' word alone.
_ALONG = (1.5, 4.0)
_OFF = (2.0, 3.0)


class SurfaceDistance:
    """Signed distance to one surface, negative behind it.

    Parameters
    ----------
    mesh : counter-clockwise from outside; not empty.
    attribute : (n,) at its vertices, told of the closest place along with the distance.

    Notes
    -----
    The sign comes from the surface's smooth normal where it is closest. Embree computes in
    single precision; coordinates are taken about the mesh's middle.
    """

    def __init__(self, mesh: TriangleMesh, attribute: NDArray[np.float64] | None = None) -> None:
        import open3d as o3d

        self._middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        self._triangles = mesh.triangles
        self._normals = vertex_normals(mesh).astype(np.float32)
        self._attribute = np.zeros(len(mesh.vertices)) if attribute is None else attribute
        self._embree: Any = o3d.t.geometry.RaycastingScene()
        self._tensor = o3d.core.Tensor.from_numpy
        self._embree.add_triangles(
            self._tensor((mesh.vertices - self._middle).astype(np.float32)),
            self._tensor(mesh.triangles.astype(np.uint32)),
        )

    def at(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distance (n,) of points (n, 3) and the attribute (n,) at the closest place."""
        local = (points - self._middle).astype(np.float32)
        found = self._embree.compute_closest_points(self._tensor(local))
        closest = found["points"].numpy().astype(np.float64)
        corners = self._triangles[found["primitive_ids"].numpy().astype(np.int64)]
        uv = found["primitive_uvs"].numpy().astype(np.float64)
        weights = np.stack([1.0 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
        normal = np.einsum("nk,nkd->nd", weights, self._normals[corners])
        offset = local.astype(np.float64) - closest
        distance = np.linalg.norm(offset, axis=1)
        sign = np.where(np.einsum("nd,nd->n", offset, normal) < 0.0, -1.0, 1.0)
        told = np.einsum("nk,nk->n", weights, self._attribute[corners])
        return sign * distance, told


@dataclass(frozen=True)
class BlockSolution:
    """What one block brings to the field.

    Attributes
    ----------
    block : (3,) which.
    surface : its solution, cut to where it is used; the attribute is the distance of the
        surface from the closest sample, metres.
    """

    block: NDArray[np.int64]
    surface: SurfaceDistance


@dataclass(frozen=True)
class BlendedField:
    """The field of a plan's blocks.

    Attributes
    ----------
    plan : the blocks.
    spacing_m : distance between samples.
    solutions : of all blocks whose ramp reaches where the field will be asked, in order.
    coarse : the solution of the whole; closed.
    coarse_cell_m : edge of its octree cells.
    box : corners (3,), (3,) that the solid is cut at where it runs on beyond the samples.
    """

    plan: BlockPlan
    spacing_m: float
    solutions: Sequence[BlockSolution]
    coarse: SurfaceDistance
    coarse_cell_m: float
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distance (n,) at points (n, 3), metres, negative inside."""
        total, held, trust = np.zeros((3, len(points)))
        for solution in self.solutions:
            weight = self.plan.weight(solution.block, points)
            here = np.flatnonzero(weight > 0.0)
            if not len(here):
                continue
            distance, apart = solution.surface.at(points[here])
            share = _fading(apart / self.spacing_m, *_ALONG)
            share *= _fading(np.abs(distance) / self.coarse_cell_m, *_OFF)
            total[here] += weight[here] * distance
            held[here] += weight[here]
            trust[here] += weight[here] * share
        some = np.where(held > 0.0, held, 1.0)
        value, trust = total / some, trust / some
        loose = np.flatnonzero(trust < 1.0)
        if len(loose):
            coarse, _ = self.coarse.at(points[loose])
            value[loose] = trust[loose] * value[loose] + (1.0 - trust[loose]) * coarse
        if self.box is not None:
            low, high = self.box
            value = np.maximum(value, np.maximum(low - points, points - high).max(axis=1))
        return value


def _fading(values: NDArray[np.float64], start: float, end: float) -> NDArray[np.float64]:
    """1 up to ``start``, 0 from ``end`` on, smooth between."""
    share = np.clip((end - values) / (end - start), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
