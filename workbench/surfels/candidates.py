"""What surfels are chosen from: the points of a surface that are seen from outside it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.point_set import PointSet
from workbench.surfels.corner_views import CornerView, corner_views
from workbench.surfels.painted_surface import PaintedSurface

_RAYS_AT_ONCE = 1 << 18
# Half the diagonal of a pixel, on a surface that a corner of a cube sees from 54.7° aslant.
GAP_PX = 1.23
# Of what a ray grazes it is not known which side it sees; other views know.
_GRAZING = 0.01
# In float32 a ray may slip past a silhouette's edge and meet the far side of it from within: such
# places are this near to an edge, as a share of the view's extent.
_LEAK = 4e-6


def surface_candidates(
    surface: PaintedSurface,
    resolution: int,
    triangles: NDArray[np.int64] | None = None,
    *,
    views: int = 8,
) -> tuple[PointSet, float]:
    """Points of a surface seen from the eight corners of its bounds (Brandt 2019, 3.1).

    Every pixel that meets the surface gives one, on the surface itself, with the normal turned
    to the viewer: where a surface is open, both of its sides may have points.

    Parameters
    ----------
    surface
        The whole surface.
    resolution
        Pixels along the longer side of each picture.
    triangles
        Rows of the part to look at, all without; only they hide each other.
    views
        As in ``corner_views``.

    Returns
    -------
    points : in the mesh's frame, with normals and, where the surface has them, colours.
    gap : how far about a seen place of the surface may be from the nearest point.

    Raises
    ------
    InputError
        No pixel meets the surface.
    """
    chosen = np.arange(len(surface.mesh.triangles)) if triangles is None else triangles
    corners = surface.mesh.vertices[surface.mesh.triangles[chosen]]
    lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    middle = 0.5 * (lower + upper)
    scene = _scene((corners - middle).astype(np.float32))
    sides = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max(axis=1)
    parts = []
    seen_from = corner_views(lower - middle, upper - middle, resolution, views)
    for view in seen_from:
        parts.extend(_met(scene, view, sides))
    met, weights, facet = (np.concatenate(kind) for kind in zip(*parts, strict=True))
    if not len(met):
        raise InputError(
            "No ray meets the surface.",
            found=f"{len(chosen)} triangles, {resolution} pixels a side",
            fix="Take a higher resolution; the surface may be thinner than a pixel.",
        )
    first = corners[met, 0]
    points = first + np.einsum("ij,ijk->ik", weights, corners[met] - first[:, None])
    normals = _seen_normals(surface.corner_normals[chosen[met]], weights, facet)
    colors = surface.colors_at(chosen[met], weights)
    gap = GAP_PX * max(view.pixel for view in seen_from)
    return PointSet(points, normals, colors, None), gap


def _scene(corners: NDArray[np.float32]) -> Any:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    rows = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(corners.reshape(-1, 3))),
        o3d.core.Tensor.from_numpy(rows),
    )
    return scene


def _met(
    scene: Any, view: CornerView, sides: NDArray[np.float64]
) -> list[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float32]]]:
    """Triangle (n,), weights (n, 3) and normal towards the viewer (n, 3) of rays that meet.

    ``sides`` (m,) are the longest of the triangles.
    """
    import open3d as o3d

    parts = []
    band = max(1, _RAYS_AT_ONCE // view.width)
    forward = view.axes[2].astype(np.float32)
    for top in range(0, view.height, band):
        origins = view.origins(slice(top, top + band)).astype(np.float32)
        rays = np.hstack([origins, np.broadcast_to(forward, origins.shape)])
        answer = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        facet = _unit(answer["primitive_normals"].numpy())
        facing = facet @ forward
        at = np.flatnonzero(np.isfinite(answer["t_hit"].numpy()) & (np.abs(facing) > _GRAZING))
        uv = answer["primitive_uvs"].numpy()[at].astype(np.float64)
        weights = np.column_stack([1.0 - uv.sum(axis=1), uv])
        met = answer["primitive_ids"].numpy()[at].astype(np.int64)
        leaked = (facing[at] > 0.0) & (weights.min(axis=1) * sides[met] < _LEAK * view.extent)
        towards = np.where(facing[at, None] > 0.0, -facet[at], facet[at])
        parts.append((met[~leaked], weights[~leaked], towards[~leaked]))
    return parts


def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.float32(1e-30)))


def _seen_normals(
    corner_normals: NDArray[np.float32], weights: NDArray[np.float64], facet: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Unit normals (n, 3), smooth, on the side of the facets' that the viewer is on."""
    normals = np.einsum("ij,ijk->ik", weights.astype(np.float32), corner_normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Corners may cancel each other out.
    normals = np.where(length > 1e-6, normals / np.maximum(length, np.float32(1e-6)), facet)
    behind = np.einsum("ij,ij->i", normals, facet) < 0.0
    return np.asarray(np.where(behind[:, None], -normals, normals), np.float32)
