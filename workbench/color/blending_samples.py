"""A mesh's vertices as samples to be coloured, and the seams between photographs on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.robust import robust_sigma

_SAMPLES_AT_ONCE = 1 << 20
_FEWEST_EDGES = 50


@dataclass(frozen=True)
class PlainBlock:
    """Samples in arrays; see `workbench.color.photo_view.Block`."""

    first: int
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    spacing: NDArray[np.float64]


def blocks_of_mesh(mesh: TriangleMesh) -> list[PlainBlock]:
    """The vertices in order, some at a time; each stands for what lies around it.

    Normals are those of the mesh, where it has some. A vertex without triangles has no spacing,
    and no normal.
    """
    known = mesh.vertex_attributes.get("normal")
    normals = vertex_normals(mesh) if known is None else np.asarray(known, np.float64)
    spacing = vertex_spacing(mesh)
    cuts = range(0, len(mesh.vertices), _SAMPLES_AT_ONCE)
    return [
        PlainBlock(at, mesh.vertices[part], normals[part], spacing[part])
        for at in cuts
        for part in (slice(at, at + _SAMPLES_AT_ONCE),)
    ]


def vertex_spacing(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Mean length (n,) of the edges at each vertex; 0 for one without."""
    total, count = np.zeros(len(mesh.vertices)), np.zeros(len(mesh.vertices))
    for k in range(3):
        start, end = mesh.triangles[:, k], mesh.triangles[:, (k + 1) % 3]
        length = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
        for corner in (start, end):
            total += np.bincount(corner, length, len(total))
            count += np.bincount(corner, minlength=len(total))
    return total / np.maximum(count, 1.0)


@dataclass(frozen=True)
class SeamSteps:
    """How colours step along edges of the surface, standard deviations of the logarithm.

    Attributes
    ----------
    across : on edges between samples that other photographs see.
    within : on edges between samples that the same photographs see.
    """

    across: float
    within: float

    @property
    def seam(self) -> float:
        """What the borders of photographs add; NaN where there are too few of either kind."""
        return float(np.sqrt(max(self.across**2 - self.within**2, 0.0)))


def seam_steps(
    levels: NDArray[np.float64], photo_sets: NDArray[np.uint64], triangles: NDArray[np.int32]
) -> SeamSteps:
    """Steps of levels (n,) along the edges of triangles (m, 3), across borders and elsewhere.

    Parameters
    ----------
    levels : logarithms; NaN where there is no colour.
    photo_sets : (n,) a number for the set of photographs that see a sample.
    """
    apart: list[NDArray[np.float64]] = []
    across: list[NDArray[np.bool_]] = []
    for k in range(3):
        start, end = triangles[:, k], triangles[:, (k + 1) % 3]
        step = levels[start] - levels[end]
        known = np.isfinite(step)
        apart.append(step[known])
        across.append((photo_sets[start] != photo_sets[end])[known])
    steps, border = np.concatenate(apart), np.concatenate(across)
    if min(border.sum(), (~border).sum()) < _FEWEST_EDGES:
        return SeamSteps(np.nan, np.nan)
    return SeamSteps(robust_sigma(steps[border]), robust_sigma(steps[~border]))
