"""What stands before the scanner: one surface with its materials, in a local frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.synthetic.raycasting import Hits, RayCaster

OBJECT = 0
SUPPORT = 1


@dataclass(frozen=True)
class Scene:
    """The true surface of a simulation.

    Attributes
    ----------
    name : the scene's name in the options.
    surface : closed meshes of all bodies in local coordinates (metres, z up) with the vertex
        attributes ``material`` (n,) uint8 — `OBJECT` or `SUPPORT` — and ``reflectance`` (n,)
        float32 in [0, 1] at the scanner's wavelength. No triangle mixes materials. A flash
        camera finds the colour of a surface point in a further attribute ``albedo`` (n, 3)
        float32 linear RGB, interpolated like the reflectance; the range scanner needs none.
    origin_in_world : (3,) float64, so that world = local + origin.
    focus : (3,) float64 local point that the stations turn about.
    """

    name: str
    surface: TriangleMesh
    origin_in_world: NDArray[np.float64]
    focus: NDArray[np.float64]

    @cached_property
    def caster(self) -> RayCaster:
        """Rays against the surface, in local coordinates; built at first use."""
        return RayCaster(self.surface)

    @property
    def material(self) -> NDArray[np.uint8]:
        """Material of every vertex (n,)."""
        material: NDArray[np.uint8] = np.asarray(
            self.surface.vertex_attributes["material"], np.uint8
        )
        return material

    def reflectance_at(self, hits: Hits) -> NDArray[np.float64]:
        """Reflectance (n,) where rays hit, 0 for a miss."""
        corner = np.asarray(self.surface.vertex_attributes["reflectance"], np.float64)
        value: NDArray[np.float64] = (
            corner[self.surface.triangles[hits.triangle]] * hits.barycentric
        ).sum(axis=1)
        return value

    def material_of(self, triangle: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Material (n,) of triangles (n,); meaningless for a miss."""
        material: NDArray[np.uint8] = self.material[self.surface.triangles[triangle, 0]]
        return material

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the ray caster, which a worker process builds for itself."""
        return {name: value for name, value in self.__dict__.items() if name != "caster"}


def painted(mesh: TriangleMesh, material: int, reflectance: NDArray[np.float64]) -> TriangleMesh:
    """The mesh with its material and a reflectance per vertex (n,) or for all (1,)."""
    n = len(mesh.vertices)
    return mesh.with_attributes(
        material=np.full(n, material, np.uint8),
        reflectance=np.broadcast_to(reflectance, (n,)).astype(np.float32),
    )
