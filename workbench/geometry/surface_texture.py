"""Pictures that tell the colours of a mesh between its vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError


@dataclass(frozen=True)
class SurfaceTexture:
    """A place in one of several pictures for every vertex of a mesh.

    Unlike in a ``TexturedMesh`` places may lie outside their picture, which then repeats.

    Attributes
    ----------
    places : (n, 2) float64 right and down from the picture's upper left corner, whose side is 1.
    pages : (m,) int32 which picture each triangle is on; a vertex is on one alone.
    pictures : (h, w, 3) uint8 each, sRGB-encoded.

    Raises
    ------
    InputError : places are not finite, or triangles are on pictures that are not there.
    """

    places: NDArray[np.float64]
    pages: NDArray[np.int32]
    pictures: tuple[NDArray[np.uint8], ...]

    def __post_init__(self) -> None:
        if not np.isfinite(self.places).all():
            raise InputError(
                "Places in a texture are not finite.",
                found=f"{int((~np.isfinite(self.places)).any(axis=1).sum())} of {len(self.places)}",
                fix="Export the mesh again, or without its texture.",
            )
        if len(self.pages) and not 0 <= self.pages.min() <= self.pages.max() < len(self.pictures):
            raise InputError(
                "Triangles are on pictures that are not there.",
                found=f"{int(self.pages.min())} to {int(self.pages.max())}",
                expected=f"{len(self.pictures)} pictures",
            )

    def page_of_vertices(self, triangles: NDArray[np.int32]) -> NDArray[np.int32]:
        """(n,) the picture of each vertex, 0 for those of no triangle."""
        page = np.zeros(len(self.places), np.int32)
        page[triangles] = self.pages[:, None]
        return page

    def vertex_colors(self, triangles: NDArray[np.int32]) -> NDArray[np.uint8]:
        """(n, 3) uint8 sRGB, the texel that each vertex lies on.

        Parameters
        ----------
        triangles : (m, 3) int32 of the mesh.
        """
        page = self.page_of_vertices(triangles)
        colors = np.zeros((len(self.places), 3), np.uint8)
        for number, picture in enumerate(self.pictures):
            chosen = page == number
            places = self.places[chosen]
            outside = ((places < 0.0) | (places > 1.0)).any()
            inside = places - np.floor(places) if outside else places
            size = np.array(picture.shape[1::-1])
            column, row = np.minimum((inside * size).astype(np.int64), size - 1).T
            colors[chosen] = picture[row, column]
        return colors
