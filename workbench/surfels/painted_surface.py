"""A triangle mesh with the normals and colours its surfels will have."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, corner_normals, face_normals_and_areas
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.geometry.textured_mesh import TexturedMesh

_CREASE_DEG = 40.0


@dataclass(frozen=True)
class PaintedSurface:
    """A mesh and, where there is one, its texture.

    Attributes
    ----------
    mesh : its attributes ``normal`` and ``color`` (uint8 sRGB) are used where they are there.
    texture : goes before ``color``.

    Raises
    ------
    InputError
        No triangle with area, or vertices that are not finite.
    """

    mesh: TriangleMesh
    texture: SurfaceTexture | None = None

    def __post_init__(self) -> None:
        corners = self.mesh.vertices[self.mesh.triangles]
        if not np.isfinite(corners).all():
            raise InputError(
                "The mesh has vertices that are not finite.",
                found=f"{int((~np.isfinite(corners)).any(axis=2).sum())} corners of triangles",
                fix="Check the file; the program that wrote it may have marked holes so.",
            )
        if not len(corners) or not face_normals_and_areas(self.mesh)[1].any():
            raise InputError(
                "The mesh has no triangle with area.",
                found=f"{len(corners)} triangles",
                fix="Check the file; there is no surface to put surfels on.",
            )

    @classmethod
    def of(cls, source: TriangleMesh | TexturedMesh | PaintedSurface) -> PaintedSurface:
        """Either kind of mesh, or a surface as it is."""
        if isinstance(source, PaintedSurface):
            return source
        if isinstance(source, TriangleMesh):
            return cls(source)
        texture = SurfaceTexture(source.texture_places, source.pages, source.pictures)
        return cls(source.mesh, texture)

    @property
    def colored(self) -> bool:
        return self.texture is not None or "color" in self.mesh.vertex_attributes

    @cached_property
    def corner_normals(self) -> NDArray[np.float32]:
        """(m, 3, 3) unit normals at the corners of every triangle, split at creases."""
        given = self.mesh.vertex_attributes.get("normal")
        if given is not None:
            return np.asarray(given[self.mesh.triangles], np.float32)
        return corner_normals(self.mesh, _CREASE_DEG)

    def colors_at(
        self, triangles: NDArray[np.int64], weights: NDArray[np.float64]
    ) -> NDArray[np.uint8] | None:
        """(n, 3) uint8 sRGB at places (n,), (n, 3) of the surface; None without colours.

        Of a texture it is the texel there: what is finer than surfels is for their averages.
        """
        corners = self.mesh.triangles[triangles]
        if self.texture is not None:
            places = np.einsum("ij,ijk->ik", weights, self.texture.places[corners])
            # One vertex a place, each on the picture of its triangle: the texture's own lookup.
            spread = SurfaceTexture(places, self.texture.pages[triangles], self.texture.pictures)
            rows = np.repeat(np.arange(len(places), dtype=np.int32)[:, None], 3, axis=1)
            return spread.vertex_colors(rows)
        color = self.mesh.vertex_attributes.get("color")
        if color is None:
            return None
        mixed = np.einsum("ij,ijk->ik", weights, color[corners].astype(np.float64))
        return np.asarray(np.rint(np.clip(mixed, 0.0, 255.0)), np.uint8)
