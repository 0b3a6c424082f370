"""Which photographs may texture each triangle, and how well each shows it.

Source: Arikan et al., section 5.2.2 and eq. 2–4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.kernels.data_costs import penalties, seen_triangles
from workbench.kernels.grouping import grouped
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.depth_map import DepthMap


@dataclass(frozen=True)
class Candidates:
    """Photographs of each triangle.

    Attributes
    ----------
    starts : (m + 1,) int64, where each triangle's begin.
    labels : (c,) int32 photographs, rising within each triangle.
    penalties : (c,) float64 data cost per area, eq. 2 without σ.
    """

    starts: NDArray[np.int64]
    labels: NDArray[np.int32]
    penalties: NDArray[np.float64]

    def best(self, most: int) -> Candidates:
        """Of each triangle the so many of least penalty, the first among equals; 0 keeps all."""
        count = np.diff(self.starts)
        if most <= 0 or not (count > most).any():
            return self
        owner = np.repeat(np.arange(len(count)), count)
        ranked = np.lexsort((self.penalties, owner))
        place = np.arange(len(owner)) - np.repeat(self.starts[:-1], count)
        kept = np.sort(ranked[place < most])
        starts = np.concatenate([[0], np.cumsum(np.minimum(count, most))]).astype(np.int64)
        return Candidates(starts, self.labels[kept], self.penalties[kept])


def candidates_of(
    mesh: TriangleMesh,
    depth_maps: Mapping[int, DepthMap],
    options: CostOptions,
    barred: Mapping[int, NDArray[np.bool_]] | None = None,
) -> Candidates:
    """The photographs that see each triangle of a mesh.

    A photograph sees a triangle if all three vertices lie on its depth mesh, where it can be used,
    and the triangle faces it. A triangle without area has none.

    Parameters
    ----------
    depth_maps : of photographs by their numbers; others are no candidates.
    barred : photographs and the triangles (m,) of which they must not be candidates.

    Raises
    ------
    InputError : a vertex is not finite.
    """
    if not np.isfinite(mesh.vertices).all():
        raise InputError("a mesh to be textured has vertices that are not finite")
    m = len(mesh.triangles)
    normals, _ = face_normals_and_areas(mesh)
    middles = mesh.vertices[mesh.triangles].mean(axis=1) if m else np.zeros((0, 3))
    parts: list[tuple[NDArray[np.int32], NDArray[np.float64]]] = []
    photos = sorted(depth_maps)
    for photo in photos:
        depth_map = depth_maps[photo]
        center = depth_map.camera.center
        seen = depth_map.shows(mesh.vertices)
        which = seen_triangles(mesh.triangles, seen, middles, normals, center, options.least_cosine)
        if barred is not None and photo in barred:
            which = which[~barred[photo][which]]
        costs = penalties(
            which, middles, normals, center, options.far, options.distance, options.orientation
        )
        parts.append((which, costs))
    owner = np.concatenate([np.zeros(0, np.int32), *(which for which, _ in parts)])
    labels = np.repeat(np.array(photos, np.int32), [len(which) for which, _ in parts])
    costs = np.concatenate([np.zeros(0), *(cost for _, cost in parts)])
    # Photographs come in rising order, and so they stay within each triangle.
    starts, order = grouped(owner, m)
    return Candidates(starts, labels[order], costs[order]).best(options.most_candidates)
