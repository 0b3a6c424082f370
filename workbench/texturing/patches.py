"""Patches of a texture: connected triangles of one photograph, as that photograph shows them.

Triangles that no photograph shows are laid on a plane across the axis they face most, at two
texels to their median edge: there is no more in the colours of their vertices.

Source: Waechter, Moehrle, Goesele 2014, section 4, keeps photographs' pixels as they are, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.patch_drawing import SUBTEXELS, overlapping
from workbench.texturing.texture_costs import side_by_side

_TEXELS_PER_EDGE = 2.0
# Triangles that cover others of their patch go to one above, and so on; the few that still do
# after so many rounds each become their own.
_LAYERS = 6


@dataclass(frozen=True)
class Patches:
    """Patches one after the other; the triangles of patch p are from ``starts[p]`` on.

    Attributes
    ----------
    triangles : (m,) int64 numbers of the mesh's triangles, patch by patch.
    starts : (p + 1,) int64.
    labels : (p,) int32 photograph of each, `NO_PHOTO` where none shows it.
    corners : (m, 3, 2) int32 right and down in its photograph (or on its plane), `SUBTEXELS` to
        a pixel, in the order of ``triangles``.
    rects : (p, 4) int32 left, top, width and height in pixels of all that is drawn of it; may
        reach beyond the photograph.
    """

    triangles: NDArray[np.int64]
    starts: NDArray[np.int64]
    labels: NDArray[np.int32]
    corners: NDArray[np.int32]
    rects: NDArray[np.int32]

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.labels)

    @property
    def patch_of(self) -> NDArray[np.int64]:
        """(m,) patch of each row of ``triangles``."""
        return np.repeat(np.arange(self.count), np.diff(self.starts))


def patches_of(
    labelled: LabelledMesh,
    cameras: Mapping[int, PhotoCamera],
    *,
    padding: int = 4,
    largest: int = 8192,
) -> Patches:
    """Cut a labelled mesh into patches of which none covers itself and none is too large.

    Parameters
    ----------
    cameras : of the photographs by their numbers, of their pictures' sizes.
    padding : texels around what is read of a patch, kept free for continuing it.
    largest : longest side of a patch with its padding, texels.

    Raises
    ------
    InputError : a triangle lies behind its photograph's camera, or is larger than a patch may be.
    """
    mesh = labelled.mesh
    facing = _facing(mesh)
    groups = np.where(labelled.labels == NO_PHOTO, NO_PHOTO - facing, labelled.labels)
    corners = _corners(labelled, groups, cameras)
    group_names, group = np.unique(groups, return_inverse=True)
    cell = np.zeros(len(group), np.int64)
    edges, _ = side_by_side(mesh.triangles)
    layer = np.zeros(len(group), np.int64)
    for turn in range(_LAYERS + 1):
        found = _cut(edges, group, layer, cell, corners, group_names, padding)
        too_large = found.rects[:, 2:].max(axis=1, initial=0) > largest
        if too_large.any():
            cell = _cells(corners, largest - 2 * padding - 4, found, too_large, cell)
            found = _cut(edges, group, layer, cell, corners, group_names, padding)
        covering = overlapping(found.corners, found.starts, found.rects)
        if not covering.any():
            break
        above = found.triangles[covering]
        layer[above] = layer.max() + 1 + (np.arange(len(above)) if turn == _LAYERS - 1 else 0)
    return found


def _facing(mesh: TriangleMesh) -> NDArray[np.int32]:
    """(m,) which axis the normals of the corners face together: 0 to 2, or 3 to 5 against it."""
    toward = vertex_normals(mesh)[mesh.triangles].sum(axis=1)
    axis = np.abs(toward).argmax(axis=1) if len(toward) else np.zeros(0, np.int64)
    against = np.take_along_axis(toward, axis[:, None], axis=1)[:, 0] < 0.0
    return (axis + 3 * against).astype(np.int32)


def _corners(
    labelled: LabelledMesh, groups: NDArray[np.int32], cameras: Mapping[int, PhotoCamera]
) -> NDArray[np.int32]:
    """(m, 3, 2) corners in pixels of each triangle's photograph or plane, times `SUBTEXELS`."""
    mesh = labelled.mesh
    corners = np.zeros((len(mesh.triangles), 3, 2))
    bare = labelled.labels == NO_PHOTO
    if bare.any():
        ends = mesh.vertices[mesh.triangles[bare]]
        sides = np.linalg.norm(ends - np.roll(ends, 1, axis=1), axis=2)
        edge = float(np.median(sides))
        scale = _TEXELS_PER_EDGE / edge if edge > 0.0 else 0.0
        axis = (NO_PHOTO - groups[bare]) % 3
        middle = mesh.vertices.mean(axis=0)
        for k in range(3):
            across = [(k + 1) % 3, (k + 2) % 3]
            rows = np.flatnonzero(bare)[axis == k]
            corners[rows] = (mesh.vertices[mesh.triangles[rows]] - middle)[..., across] * scale
    by_label = np.argsort(labelled.labels, kind="stable")
    labels, first = np.unique(labelled.labels[by_label], return_index=True)
    for label, rows in zip(labels.tolist(), np.split(by_label, first[1:]), strict=False):
        if label == NO_PHOTO:
            continue
        used, place = np.unique(mesh.triangles[rows], return_inverse=True)
        pixels, _ = cameras[label].project(mesh.vertices[used])
        corners[rows] = pixels[place.reshape(-1, 3)]
    if not (np.abs(corners) < 2.0**31 / SUBTEXELS / 4).all():
        raise InputError(
            "triangles are labelled with photographs that cannot show them",
            found=f"{int((~np.isfinite(corners)).any(axis=(1, 2)).sum())} behind their cameras",
            fix="label the mesh with these cameras",
        )
    return np.rint(corners * SUBTEXELS).astype(np.int32)


def _cut(
    edges: NDArray[np.int32],
    group: NDArray[np.int64],
    layer: NDArray[np.int64],
    cell: NDArray[np.int64],
    corners: NDArray[np.int32],
    group_names: NDArray[np.int32],
    padding: int,
) -> Patches:
    """Patches: triangles side by side with the same group, layer and cell."""
    m = len(group)
    same = np.ones(len(edges), bool)
    for part in (group, layer, cell):
        same &= part[edges[:, 0]] == part[edges[:, 1]]
    joined = edges[same]
    graph = coo_array((np.ones(len(joined), np.int8), (joined[:, 0], joined[:, 1])), (m, m))
    count, patch = connected_components(graph, directed=False)
    # In the order of the photographs, so that each is drawn at once.
    first = np.full(count, m)
    np.minimum.at(first, patch, np.arange(m))
    order = np.lexsort((first, group[first]))
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    triangles = np.argsort(rank[patch], kind="stable")
    starts = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(rank[patch], minlength=count), out=starts[1:])
    corners = corners[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    if count:
        low = np.minimum.reduceat(low, starts[:-1])
        high = np.maximum.reduceat(high, starts[:-1])
    # Half a texel to the side of a corner is the last middle that reading there touches.
    upper_left = (low - SUBTEXELS // 2) // SUBTEXELS - padding
    lower_right = (high + SUBTEXELS // 2) // SUBTEXELS + 1 + padding
    rects = np.hstack([upper_left, lower_right - upper_left]).astype(np.int32)
    names = group_names[group[first[order]]]
    labels = np.maximum(names, NO_PHOTO).astype(np.int32)
    return Patches(triangles, starts, labels, corners, rects)


def _cells(
    corners: NDArray[np.int32],
    side: int,
    found: Patches,
    too_large: NDArray[np.bool_],
    cell: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Cells of a grid for the triangles of patches that are too large."""
    extent = corners.max(axis=1) - corners.min(axis=1)
    widest = int(extent.max()) / SUBTEXELS
    if side < 2 or widest > 0.5 * side:
        raise InputError(
            "triangles are too large for a page of the texture",
            found=f"a triangle {widest:.0f} pixels wide on patches of at most {side}",
            fix="allow larger pages, or cut the mesh finer",
        )
    rows = found.triangles[too_large[found.patch_of]]
    # Triangles reach out of their cells by at most half their extent.
    step = int((side - widest) * SUBTEXELS)
    at = (corners[rows].max(axis=1) + corners[rows].min(axis=1)) // 2 // step
    at -= at.min(axis=0)
    cells = cell.copy()
    cells[rows] = 1 + at[:, 0].astype(np.int64) + at[:, 1] * (int(at[:, 0].max()) + 1)
    return cells
