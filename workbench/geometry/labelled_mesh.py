"""A mesh of which each triangle has a photograph to be textured with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh

NO_PHOTO = -1


@dataclass(frozen=True)
class LabelledMesh:
    """A mesh and the photograph of each triangle; photographs are numbered over the project.

    Attributes
    ----------
    mesh : with n vertices and m triangles, counter-clockwise seen from outside; its vertex
        attribute ``color`` (n, 3) uint8 sRGB is what shows where a triangle has no photograph.
    labels : (m,) int32 photograph of each triangle; `NO_PHOTO` where none sees it.
    foreground : (m,) whether the photograph is the one the mesh was made for (Arikan, 5.2.1);
        everywhere true in a mesh that was made for none.
    penalties : (m,) float32 data cost of the choice per area, eq. 2 without σ; smaller is better.
    spacing : (m,) float32 how far the samples that a triangle is made of lie apart, metres; None
        where these are its corners. Never stored.

    Raises
    ------
    InputError : the arrays do not belong together.
    """

    mesh: TriangleMesh
    labels: NDArray[np.int32]
    foreground: NDArray[np.bool_]
    penalties: NDArray[np.float32]
    spacing: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        m = len(self.mesh.triangles)
        found = [len(self.labels), len(self.foreground), len(self.penalties)]
        found += [] if self.spacing is None else [len(self.spacing)]
        if set(found) != {m}:
            raise InputError(
                "labels do not belong to the mesh", expected=f"{m} triangles", found=str(found)
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored: those of the mesh, ``labels``, ``foreground`` and ``penalties``."""
        return {
            **self.mesh.arrays(),
            "labels": self.labels,
            "foreground": self.foreground,
            "penalties": self.penalties,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> LabelledMesh:
        """The mesh that `arrays` told; further arrays are passed over."""
        return cls(
            TriangleMesh.from_arrays(arrays),
            arrays["labels"],
            arrays["foreground"],
            arrays["penalties"],
        )
