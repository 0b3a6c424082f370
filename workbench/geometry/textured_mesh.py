"""A mesh whose colours are pictures, as other programs draw it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh with a place in one of several pictures for every vertex.

    Attributes
    ----------
    mesh : with n vertices and m triangles; where a seam runs, a vertex is there once for each
        side. Its attribute ``normal`` (n, 3) is written by the writers where it is there.
    texture_places : (n, 2) float64 right and down in [0, 1] from the picture's upper left corner.
    pages : (m,) int32 which picture each triangle is on; a vertex is on one alone.
    pictures : one or more (h, w, 3) uint8, sRGB-encoded.

    Raises
    ------
    InputError : the arrays do not belong together, or places are outside their pictures.
    """

    mesh: TriangleMesh
    texture_places: NDArray[np.float64]
    pages: NDArray[np.int32]
    pictures: tuple[NDArray[np.uint8], ...]

    def __post_init__(self) -> None:
        n, m = len(self.mesh.vertices), len(self.mesh.triangles)
        if self.texture_places.shape != (n, 2) or self.pages.shape != (m,):
            raise InputError(
                "a texture does not belong to the mesh",
                expected=f"{n} vertices and {m} triangles",
                found=f"{len(self.texture_places)} and {len(self.pages)}",
            )
        if not ((self.texture_places >= 0.0) & (self.texture_places <= 1.0)).all():
            raise InputError("places in a texture must be in its picture, from 0 to 1")
        if m and not (self.pages.min() >= 0 and self.pages.max() < len(self.pictures)):
            raise InputError(
                "triangles are on pictures that are not there",
                found=f"{int(self.pages.min())} to {int(self.pages.max())}",
                expected=f"{len(self.pictures)} pictures",
            )
