"""Seams between patches, and the colours on their two sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.kernels.patch_drawing import SUBTEXELS, read_between
from workbench.texturing.patches import Patches
from workbench.texturing.texture_costs import side_by_side


@dataclass(frozen=True)
class Seams:
    """Edges of the mesh at which the photograph changes.

    Attributes
    ----------
    rows : (e, 2) int64 the triangles of both sides, as rows of their `Patches`.
    corners : (e, 2, 2) int64 which corner of either side (second axis) is at each end of the
        edge (third axis).
    ends : (e, 2) int32 vertices.
    lengths : (e,) float64 in the world's units.
    """

    rows: NDArray[np.int64]
    corners: NDArray[np.int64]
    ends: NDArray[np.int32]
    lengths: NDArray[np.float64]

    @property
    def count(self) -> int:
        """How many edges."""
        return len(self.rows)

    def where(self, kept: NDArray[np.bool_]) -> Seams:
        """Those that ``kept`` (e,) says."""
        return Seams(self.rows[kept], self.corners[kept], self.ends[kept], self.lengths[kept])


def seams_of(labelled: LabelledMesh, patches: Patches) -> Seams:
    """The seams of a labelled mesh; none lies between patches of one photograph."""
    mesh = labelled.mesh
    edges, ends = side_by_side(mesh.triangles)
    changes = labelled.labels[edges[:, 0]] != labelled.labels[edges[:, 1]]
    edges, ends = edges[changes], ends[changes]
    corners = np.argmax(mesh.triangles[edges][:, :, None, :] == ends[:, None, :, None], axis=3)
    row_of = np.empty(len(patches.triangles), np.int64)
    row_of[patches.triangles] = np.arange(len(row_of))
    sides = mesh.vertices[ends]
    lengths = np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1)
    return Seams(row_of[edges], corners, ends, lengths)


def places_along(
    seams: Seams, corners: NDArray[np.float64], shares: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(e, 2, s, 2) places on both sides, at shares (s,) of the way along each edge.

    ``corners`` (m, 3, 2) are those of the triangles, in the order of the patches.
    """
    ends = corners[seams.rows[:, :, None], seams.corners]
    start, end = ends[:, :, 0, None, :], ends[:, :, 1, None, :]
    return np.asarray(start + shares[None, None, :, None] * (end - start))


def colors_along(
    seams: Seams,
    labelled: LabelledMesh,
    patches: Patches,
    pictures: Callable[[int], NDArray[np.uint8]],
    shares: NDArray[np.float64],
) -> NDArray[np.float32]:
    """(e, 2, s, 3) colours of 255 that both sides' photographs show along each edge.

    Without a photograph it is what the vertices' colours make of it.
    """
    out = np.empty((seams.count, 2, len(shares), 3), np.float32)
    places = places_along(seams, patches.corners / SUBTEXELS, shares)
    labels = labelled.labels[patches.triangles[seams.rows]]
    vertex_colors = np.asarray(labelled.mesh.vertex_attributes["color"], np.float32)
    for label in np.unique(labels).tolist():
        there = labels == label
        if label == NO_PHOTO:
            ends = vertex_colors[seams.ends[np.nonzero(there)[0]]]
            out[there] = (
                ends[:, None, 0] * (1 - shares)[None, :, None]
                + ends[:, None, 1] * shares[None, :, None]
            )
        else:
            read = read_between(pictures(label), places[there].reshape(-1, 2))
            out[there] = read.reshape(-1, len(shares), 3)
    return out


@dataclass(frozen=True)
class ColorStep:
    """How visible seams are: the root mean square over channels of the step, of 255.

    Attributes
    ----------
    mean : over the length of all seams.
    percentile_95 : below which 95 % of their length is.
    length : of all seams, in the world's units.
    """

    mean: float
    percentile_95: float
    length: float


def color_step(colors: NDArray[np.floating], lengths: NDArray[np.float64]) -> ColorStep:
    """Of colours (e, 2, s, 3) of 255 on both sides of edges (e,); 0 without seams."""
    if not len(lengths) or not lengths.sum() > 0.0:
        return ColorStep(0.0, 0.0, 0.0)
    step = np.sqrt(np.square(colors[:, 0] - colors[:, 1], dtype=np.float64).mean(axis=2))
    weight = np.broadcast_to(lengths[:, None] / step.shape[1], step.shape).ravel()
    order = np.argsort(step.ravel(), kind="stable")
    below = np.searchsorted(np.cumsum(weight[order]), 0.95 * weight.sum())
    return ColorStep(
        float((step.ravel() * weight).sum() / weight.sum()),
        float(step.ravel()[order[min(int(below), len(order) - 1)]]),
        float(lengths.sum()),
    )
