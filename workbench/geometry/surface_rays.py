"""Rays against a triangle mesh, and the nearest place on it, by Embree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera

NO_TRIANGLE = -1
_ROWS_AT_ONCE = 256
_LARGEST = 1e18


@dataclass(frozen=True)
class SurfacePlaces:
    """Places on a surface, one for each question.

    Attributes
    ----------
    points : (n, 3) float64 in the mesh's frame; NaN where there is none.
    normals : (n, 3) float64 unit normals of the triangles, as their winding says; NaN alike.
    triangles : (n,) int64, `NO_TRIANGLE` where there is none.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    triangles: NDArray[np.int64]

    @property
    def found(self) -> NDArray[np.bool_]:
        """(n,) whether there is a place."""
        return np.asarray(self.triangles != NO_TRIANGLE)


class SurfaceRays:
    """A mesh made ready for questions; build it once.

    Embree computes in float32, so everything is asked about the mesh's own middle.

    Parameters
    ----------
    mesh : in any frame, also far from its origin.

    Raises
    ------
    InputError : the mesh has no triangles, vertices that are not finite, or is so large that
        squares of lengths leave single precision.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        import open3d as o3d

        if not len(mesh.triangles):
            raise InputError("the surface has no triangles", fix="check the file it came from")
        largest = float(np.abs(mesh.vertices).max())
        if not largest < _LARGEST:
            wrong = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
            raise InputError(
                "no rays can be cast at the surface",
                expected=f"finite vertices, within {_LARGEST:g} of the origin",
                found=f"{wrong} that are not finite" if wrong else f"coordinates up to {largest:g}",
                fix="repair the mesh, or give it in a larger unit",
            )
        self.mesh = mesh
        self.middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor.from_numpy((mesh.vertices - self.middle).astype(np.float32)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles, np.uint32)),
        )

    def nearest(self, points: NDArray[np.float64]) -> SurfacePlaces:
        """The place of the surface nearest to each point (n, 3); none to one that is not finite."""
        import open3d as o3d

        asked = o3d.core.Tensor.from_numpy((points - self.middle).astype(np.float32))
        answer = self._scene.compute_closest_points(asked)
        places = answer["points"].numpy().astype(np.float64) + self.middle
        normals = _unit(answer["primitive_normals"].numpy())
        triangles = answer["primitive_ids"].numpy().astype(np.int64)
        # Embree finds none where squared distances leave its range, and leaves what was there.
        nowhere = triangles >= len(self.mesh.triangles)
        places[nowhere] = normals[nowhere] = np.nan
        triangles[nowhere] = NO_TRIANGLE
        return SurfacePlaces(places, normals, triangles)

    def first_met(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> SurfacePlaces:
        """Where rays from one ``origin`` (3,) along unit ``directions`` (n, 3) end."""
        import open3d as o3d

        start = np.broadcast_to(origin - self.middle, directions.shape)
        rays = np.hstack([start, directions]).astype(np.float32)
        answer = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        distance = answer["t_hit"].numpy().astype(np.float64)
        met = np.isfinite(distance)
        points = np.full(directions.shape, np.nan)
        points[met] = origin + distance[met, None] * directions[met]
        normals = _unit(answer["primitive_normals"].numpy())
        normals[~met] = np.nan
        triangles = answer["primitive_ids"].numpy().astype(np.int64)
        return SurfacePlaces(points, normals, np.where(met, triangles, NO_TRIANGLE))

    def seen_by(self, camera: PhotoCamera, step_px: int = 1) -> SurfacePlaces:
        """What every ``step_px``-th pixel of every such row shows, rows first.

        The middle pixel of each step is asked; the answer has
        ``ceil(height / step) · ceil(width / step)`` places.
        """
        columns = np.arange(0, camera.width, step_px) + 0.5 * step_px
        parts = []
        for top in range(0, camera.height, step_px * _ROWS_AT_ONCE):
            last = min(top + step_px * _ROWS_AT_ONCE, camera.height)
            rows = np.arange(top, last, step_px) + 0.5 * step_px
            pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
            parts.append(self.first_met(camera.center, camera.directions(pixels)))
        return SurfacePlaces(
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.triangles for part in parts]),
        )

    def silhouette(self, camera: PhotoCamera, step_px: int = 1) -> NDArray[np.bool_]:
        """Whether every ``step_px``-th pixel of either side shows the surface, (h', w')."""
        shape = (-(-camera.height // step_px), -(-camera.width // step_px))
        return self.seen_by(camera, step_px).found.reshape(shape)


def _unit(normals: NDArray[np.float32]) -> NDArray[np.float64]:
    long = normals.astype(np.float64)
    length = np.linalg.norm(long, axis=1, keepdims=True)
    return np.asarray(long / np.where(length > 0.0, length, 1.0))
