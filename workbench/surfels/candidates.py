"""What surfels are chosen from: the points of a surface that are seen from outside it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.point_set import PointSet, joined
from workbench.kernels.surfel_places import seen_places
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
    seen_from = corner_views(lower - middle, upper - middle, resolution, views)
    parts: list[PointSet] = []
    for view in seen_from:
        for hits, shares in _met(scene, view):
            parts.append(_places(surface, chosen, corners, hits, shares, view))
    points = joined(parts)
    if not len(points):
        raise InputError(
            "No ray meets the surface.",
            found=f"{len(chosen)} triangles, {resolution} pixels a side",
            fix="Take a higher resolution; the surface may be thinner than a pixel.",
        )
    return points, GAP_PX * max(view.pixel for view in seen_from)


def _scene(corners: NDArray[np.float32]) -> Any:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    rows = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(corners.reshape(-1, 3))),
        o3d.core.Tensor.from_numpy(rows),
    )
    return scene


def _met(scene: Any, view: CornerView) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Triangle (n,) and shares of its second and third corner (n, 2) of rays that meet one."""
    import open3d as o3d

    band = max(1, _RAYS_AT_ONCE // view.width)
    forward = view.axes[2].astype(np.float32)
    for top in range(0, view.height, band):
        origins = view.origins(slice(top, top + band))
        rays = np.empty((len(origins), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origins, forward
        answer = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        at = np.flatnonzero(np.isfinite(answer["t_hit"].numpy()))
        yield (
            answer["primitive_ids"].numpy()[at].astype(np.int64),
            answer["primitive_uvs"].numpy()[at],
        )


def _places(
    surface: PaintedSurface,
    chosen: NDArray[np.int64],
    corners: NDArray[np.float64],
    hits: NDArray[np.int64],
    shares: NDArray[np.float32],
    view: CornerView,
) -> PointSet:
    """What the rays of a view meet; ``hits`` are rows of ``chosen`` and ``corners``."""
    points, weights = np.empty((2, len(hits), 3))
    normals, rows = np.empty((len(hits), 3), np.float32), np.empty(len(hits), np.int64)
    count = seen_places(
        corners,
        surface.corner_normals,
        hits,
        chosen,
        shares,
        view.axes[2],
        _GRAZING,
        _LEAK * view.extent,
        points,
        normals,
        weights,
        rows,
    )
    colors = surface.colors_at(rows[:count], weights[:count])
    return PointSet(points[:count], normals[:count], colors, None)
