"""Rays against a surface that is in memory as a whole: plain Embree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.raytracing.chunk_building import triangle_colors
from workbench.raytracing.chunk_file import SurfaceChunk
from workbench.raytracing.embree_scene import NO_TRIANGLE, EmbreeScene, scene_bytes
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.ray_hits import RayCounts, RayHits
from workbench.raytracing.surface_source import SurfaceSource, surface_frame
from workbench.raytracing.visibility_front import VisibilityFront


def whole_bytes(source: SurfaceSource) -> int:
    """Memory that `WholeRays` of a surface needs while it is built, about."""
    return scene_bytes(source.triangles) + 12 * source.vertices + 12 * source.triangles


class WholeRays:
    """As `RayCaster`, with everything in one scene.

    Raises
    ------
    InputError
        Vertices that are not finite.
    """

    in_core = True

    def __init__(self, source: SurfaceSource) -> None:
        self.frame: LocalFrame = surface_frame(source)
        self.counts = RayCounts()
        positions = np.concatenate([self.frame.local(points) for points in source.points()])
        corners = np.concatenate([part.astype(np.uint32) for part in source.corners()])
        colors, parts = None, source.colors()
        if parts is not None:
            colors = triangle_colors(np.concatenate(list(parts)), corners)
        self._scene = EmbreeScene(
            SurfaceChunk(
                positions,
                np.arange(len(positions), dtype=np.uint32),
                corners,
                np.arange(len(corners), dtype=np.uint32),
                colors,
            )
        )

    def nearest(
        self,
        rays: NDArray[np.float32],
        reach: float = np.inf,
        front: VisibilityFront | None = None,
    ) -> RayHits:
        """See `RayCaster`; ``front`` is of no use here."""
        self._count(rays)
        distances, rows, normals = self._scene.first_met(rays)
        rows[distances > np.float32(reach)] = NO_TRIANGLE
        met = rows != NO_TRIANGLE
        normals[~met] = 0.0
        colors = self._scene.colors
        if colors is not None:
            colors = np.where(met[:, None], colors[rows], np.uint8(0))
        return RayHits(distances, rows, normals, colors).ended()

    def blocked(
        self,
        rays: NDArray[np.float32],
        reach: float = np.inf,
        front: VisibilityFront | None = None,
    ) -> NDArray[np.bool_]:
        """See `RayCaster`; ``front`` is of no use here."""
        self._count(rays)
        return self._scene.blocked(rays, reach)

    def _count(self, rays: NDArray[np.float32]) -> None:
        self.counts.rays += len(rays)
        self.counts.rays_cast += len(rays)
        self.counts.casts += 1
