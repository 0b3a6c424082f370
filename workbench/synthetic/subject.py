"""A surface made ready to be photographed: smooth normals, rays, paint."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, corner_normals
from workbench.kernels.flash_shading import surface_points
from workbench.synthetic import solids
from workbench.synthetic.albedo import SURROUNDINGS, Paint, SurfacePaint, WeatheredPaint
from workbench.synthetic.photo_options import SurfaceOptions
from workbench.synthetic.scene import Scene, painted

# Edges sharper than this stay sharp in the picture.
_CREASE_DEG = 42.0
_TABLE_CELL_M = 0.02
_FLOOR_CELL_M = 0.10


@dataclass(frozen=True)
class Sightings:
    """Where n rays first meet a subject.

    Attributes
    ----------
    rays : (n,) int64 the rays that meet it, in order; those that miss are left out.
    triangle : (n,) int64.
    uv : (n, 2) float32 weights of the second and third corner.
    distance : (n,) float64 along the ray, metres.
    """

    rays: NDArray[np.int64]
    triangle: NDArray[np.int64]
    uv: NDArray[np.float32]
    distance: NDArray[np.float64]


@dataclass(frozen=True)
class Subject:
    """What stands before the camera.

    Attributes
    ----------
    mesh : in local coordinates, with the vertex attribute ``material`` (n,) uint8; no
        triangle mixes materials.
    paint : how points of each material look.
    """

    mesh: TriangleMesh
    paint: Paint

    @classmethod
    def of_scene(cls, scene: Scene, options: SurfaceOptions, seed: int) -> Subject:
        """A simulation's scene, painted, on what the options put it on."""
        surface = TriangleMesh(
            scene.surface.vertices,
            scene.surface.triangles,
            {
                "material": scene.material,
                "reflectance": scene.surface.vertex_attributes["reflectance"],
            },
        )
        around = _surroundings(scene, options)
        mesh = solids.collected([surface, around]) if around is not None else surface
        return cls(mesh, WeatheredPaint.of(scene, options, seed))

    @property
    def material(self) -> NDArray[np.uint8]:
        """Material (n,) of every vertex."""
        return np.asarray(self.mesh.vertex_attributes["material"], np.uint8)

    @cached_property
    def corner_normals(self) -> NDArray[np.float32]:
        """Unit shading normals (m, 3, 3) at the corners of every triangle."""
        return corner_normals(self.mesh, _CREASE_DEG)

    @cached_property
    def vertex_paint(self) -> SurfacePaint:
        """The look of every vertex."""
        return self.paint.at(self.mesh.vertices, self.material)

    @cached_property
    def _embree(self) -> tuple[Any, Any, NDArray[np.float64]]:
        # Costs seconds: only who casts rays pays.
        o3d: Any = importlib.import_module("open3d")
        # Embree works in float32: small numbers keep its points exact to a micrometre.
        middle = 0.5 * (self.mesh.vertices.min(axis=0) + self.mesh.vertices.max(axis=0))
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            o3d.core.Tensor((self.mesh.vertices - middle).astype(np.float32)),
            o3d.core.Tensor(self.mesh.triangles.astype(np.uint32)),
        )
        return o3d, scene, middle

    @property
    def middle(self) -> NDArray[np.float64]:
        """(3,) origin of the coordinates in which rays are given to `seen` and `blocked`."""
        return self._embree[2]

    def seen(self, rays: NDArray[np.float32]) -> Sightings:
        """First hits of rays (n, 6): origin relative to `middle`, unit direction."""
        o3d, scene, _ = self._embree
        answer = scene.cast_rays(o3d.core.Tensor(rays))
        distance = answer["t_hit"].numpy()
        hit = np.flatnonzero(np.isfinite(distance))
        return Sightings(
            hit,
            answer["primitive_ids"].numpy()[hit].astype(np.int64),
            answer["primitive_uvs"].numpy()[hit],
            distance[hit].astype(np.float64),
        )

    def blocked(self, rays: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether something lies within one direction's length (n,) of rays (n, 6)."""
        o3d, scene, _ = self._embree
        blocked: NDArray[np.bool_] = scene.test_occlusions(
            o3d.core.Tensor(rays), tnear=0.0, tfar=1.0
        ).numpy()
        return blocked

    def points(self, hits: Sightings) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Local points (n, 3) and unit shading normals (n, 3) of sightings."""
        points, normals = surface_points(
            hits.triangle,
            hits.uv,
            self.mesh.vertices,
            self.mesh.triangles,
            self.corner_normals,
        )
        return points, normals

    def material_of(self, triangle: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Material (n,) of triangles (n,)."""
        material: NDArray[np.uint8] = self.material[self.mesh.triangles[triangle, 0]]
        return material

    def __getstate__(self) -> dict[str, Any]:
        """Mesh and paint; a worker process derives the rest for itself."""
        return {"mesh": self.mesh, "paint": self.paint}


def sheet(
    low: tuple[float, float],
    high: tuple[float, float],
    height: float,
    cell_m: float,
    material: int,
) -> TriangleMesh:
    """A level rectangle at z = ``height`` that faces up, cut into cells of ``cell_m``."""
    counts = [max(1, round((b - a) / cell_m)) for a, b in zip(low, high, strict=True)]
    x, y = (np.linspace(low[k], high[k], counts[k] + 1) for k in range(2))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    vertices = np.column_stack([grid, np.full(len(grid), height)])
    index = np.arange(len(grid), dtype=np.int32).reshape(len(x), len(y))
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return painted(TriangleMesh(vertices, triangles), material, np.array([0.1]))


def _surroundings(scene: Scene, options: SurfaceOptions) -> TriangleMesh | None:
    """The table or floor just below the lowest point of a scene."""
    if options.surroundings == "none":
        return None
    low, high = scene.surface.vertices.min(axis=0), scene.surface.vertices.max(axis=0)
    wide = float((high - low)[:2].max())
    # A hair lower than the body that stands on it: no ray is undecided between the two.
    height = float(low[2]) - 2e-4
    if options.surroundings == "table":
        margin, cell = 0.3 * wide, _TABLE_CELL_M * max(1.0, wide)
    else:
        margin, cell = 4.0 * wide, _FLOOR_CELL_M * max(1.0, wide)
    return sheet(
        (low[0] - margin, low[1] - margin),
        (high[0] + margin, high[1] + margin),
        height,
        cell,
        SURROUNDINGS,
    )
