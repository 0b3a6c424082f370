"""Labelled meshes made ready to be drawn together, as often as wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import LabelledMesh

# Depth meshes of one surface lie apart by a part of their sampling; along a grazing line of
# sight that is several times as much. Arikan's table 3 has about as much: 0.1 m in rooms, the
# same for all meshes; here each has its own, by its coarseness.
_EPSILON_SPACINGS = 6.0
_GREY = 128
_COARSEST, _FURTHEST = 5.0, 2.0
# So many steps to 1 has coarseness: pages hold it in a byte.
COARSENESS_STEPS = 32

_Number = TypeVar("_Number", bound=np.generic)


@dataclass(frozen=True)
class StitchScene:
    """Meshes one after the other in common arrays: triangles and vertices are numbered over all.

    Attributes
    ----------
    vertices : (n, 3) float64 in the world.
    colors : (n, 3) uint8 sRGB, for where there is no photograph.
    triangles : (t, 3) int32 into `vertices`, counter-clockwise seen from outside.
    starts : (k + 1,) int64, mesh i has the triangles from ``starts[i]`` to ``starts[i + 1]``.
    vertex_starts : (k + 1,) int64 likewise of the vertices.
    labels, foreground, penalties : (t,) as in `LabelledMesh`; a penalty is infinite where there is
        no photograph.
    coarseness : (t,) float32 spacing of the samples of each triangle over the median of all, at
        most 5 and in steps of 1/32: how poorly a mesh samples the surface where it sees it from
        afar or from the side.
    epsilon : fragments of usual coarseness at most this far behind the front-most show the same
        surface, metres.
    """

    vertices: NDArray[np.float64]
    colors: NDArray[np.uint8]
    triangles: NDArray[np.int32]
    starts: NDArray[np.int64]
    vertex_starts: NDArray[np.int64]
    labels: NDArray[np.int32]
    foreground: NDArray[np.bool_]
    penalties: NDArray[np.float32]
    coarseness: NDArray[np.float32]
    epsilon: float

    @property
    def reach(self) -> NDArray[np.float32]:
        """(t,) how far behind the front-most surface each triangle still competes, in ε.

        A mesh is off by as much more as it samples the surface more poorly; at most twice as far,
        for surfaces that are seen from the side may end there.
        """
        return np.minimum(self.coarseness, np.float32(_FURTHEST))

    @property
    def meshes(self) -> int:
        """How many there are."""
        return len(self.starts) - 1

    def mesh_of(self, triangle: NDArray[np.int32]) -> NDArray[np.int32]:
        """Mesh of each triangle number; −1 of −1."""
        table = np.repeat(np.arange(self.meshes, dtype=np.int32), np.diff(self.starts))
        return np.asarray(np.append(table, np.int32(-1))[triangle])

    def label_of(self, triangle: NDArray[np.int32]) -> NDArray[np.int32]:
        """Photograph of each triangle number; `NO_PHOTO` of −1."""
        return np.asarray(np.append(self.labels, np.int32(-1))[triangle])

    @classmethod
    def of(cls, meshes: Sequence[LabelledMesh], epsilon: float | None = None) -> StitchScene:
        """Put meshes together.

        Parameters
        ----------
        meshes : each oriented towards its photograph; one without vertex attribute ``color`` is
            grey where it has no photograph.
        epsilon : metres; by default six times the median spacing of the meshes' samples.

        Raises
        ------
        InputError : a vertex is not finite, a penalty NaN, or `epsilon` negative.
        """
        if epsilon is not None and not epsilon >= 0.0:
            raise InputError("fragments compete within a distance", found=f"{epsilon} m")
        vertex_starts = _starts([len(mesh.mesh.vertices) for mesh in meshes])
        vertices = _joined([mesh.mesh.vertices for mesh in meshes], np.zeros((0, 3)))
        triangles = _joined(
            [
                mesh.mesh.triangles.astype(np.int32) + np.int32(first)
                for mesh, first in zip(meshes, vertex_starts[:-1], strict=True)
            ],
            np.zeros((0, 3), np.int32),
        )
        penalties = _joined([mesh.penalties for mesh in meshes], np.zeros(0, np.float32))
        spacing = _joined([_spacing(mesh) for mesh in meshes], np.zeros(0, np.float32))
        usual = float(np.median(spacing)) if len(spacing) else 0.0
        if not np.isfinite(vertices).all():
            raise InputError("a mesh has vertices that are not finite", fix="make the meshes again")
        if np.isnan(penalties).any():
            raise InputError("a mesh has penalties that are NaN", fix="label the meshes again")
        return cls(
            vertices,
            _joined([_colors(mesh) for mesh in meshes], np.zeros((0, 3), np.uint8)),
            triangles,
            _starts([len(mesh.labels) for mesh in meshes]),
            vertex_starts,
            _joined([mesh.labels for mesh in meshes], np.zeros(0, np.int32)),
            _joined([mesh.foreground for mesh in meshes], np.zeros(0, bool)),
            penalties,
            _in_steps(np.minimum(spacing / np.float32(usual or 1.0), np.float32(_COARSEST))),
            _EPSILON_SPACINGS * usual if epsilon is None else epsilon,
        )


def _in_steps(coarseness: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.rint(coarseness * COARSENESS_STEPS) / np.float32(COARSENESS_STEPS))


def _starts(counts: list[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _joined(parts: list[NDArray[_Number]], none: NDArray[_Number]) -> NDArray[_Number]:
    return np.ascontiguousarray(np.concatenate([none, *parts]), none.dtype)


def _colors(mesh: LabelledMesh) -> NDArray[np.uint8]:
    shape = (len(mesh.mesh.vertices), 3)
    colors = mesh.mesh.vertex_attributes.get("color")
    return np.full(shape, _GREY, np.uint8) if colors is None else colors[:, :3]


def _spacing(labelled: LabelledMesh) -> NDArray[np.float32]:
    if labelled.spacing is not None:
        return labelled.spacing
    vertices, triangles = labelled.mesh.vertices, labelled.mesh.triangles
    longest = np.zeros(len(triangles))
    for k in range(3):
        edge = vertices[triangles[:, k]] - vertices[triangles[:, (k + 1) % 3]]
        np.maximum(longest, np.linalg.norm(edge, axis=1), out=longest)
    return longest.astype(np.float32)
