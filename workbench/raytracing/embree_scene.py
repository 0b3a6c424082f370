"""Triangles made ready for rays by Embree, and what that takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.raytracing.chunk_file import SurfaceChunk

NO_TRIANGLE = -1
#: Measured growth of a process by scenes of Open3D 0.20 (Embree 4): 86 B a triangle from 30,000
#: triangles on, with half a vertex each, and 138 B with 3,200; 88 and a constant cover both. Of a
#: chunk stay the numbers and the colours besides.
BYTES_PER_TRIANGLE = 88 + 4 + 3
BYTES_PER_SCENE = 192 << 10


def scene_bytes(triangles: int) -> int:
    """What a scene of so many triangles takes in memory, about."""
    return BYTES_PER_SCENE + BYTES_PER_TRIANGLE * triangles


class EmbreeScene:
    """Some triangles of a surface.

    Attributes
    ----------
    numbers : (t,) of the triangles in the surface, integers.
    colors : (t, 3) uint8 sRGB, or None.
    bytes : of memory, about.
    """

    def __init__(self, chunk: SurfaceChunk) -> None:
        import open3d as o3d  # Costs seconds: only who casts pays.

        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(chunk.positions)),
            self._tensor(np.ascontiguousarray(chunk.corners, np.uint32)),
        )
        self.numbers, self.colors = chunk.numbers, chunk.colors
        self.bytes = scene_bytes(len(chunk.corners))

    def first_met(
        self, rays: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]:
        """Distances (n,), triangles of this scene (n,) and unit normals (n, 3) of rays (n, 6).

        Distances are in lengths of the direction, infinite where nothing is met.
        """
        answer: Any = self._scene.cast_rays(self._tensor(rays))
        distances = answer["t_hit"].numpy()
        rows = np.where(
            np.isfinite(distances), answer["primitive_ids"].numpy().astype(np.int64), NO_TRIANGLE
        )
        return distances, rows, answer["primitive_normals"].numpy()

    def blocked(self, rays: NDArray[np.float32], reach: float) -> NDArray[np.bool_]:
        """(n,) whether anything is met within ``reach`` lengths of the direction."""
        answer: NDArray[np.bool_] = self._scene.test_occlusions(
            self._tensor(rays), 0.0, float(reach)
        ).numpy()
        return answer
