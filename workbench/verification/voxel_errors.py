"""How far pictures of voxels are from pictures of the surface they were cut from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.voxels.lod_export import LodOptions, write_voxel_lod
from workbench.voxels.lod_file import LodFile
from workbench.voxels.voxel_set import VoxelGrid

PIXELS = 512


@dataclass(frozen=True)
class MeshViews:
    """A surface seen straight onto the six faces of a cube around it, lit from beside.

    Attributes
    ----------
    rays : along the side of each view, a multiple of `PIXELS`, averaged to pixels.
    views : (PIXELS, PIXELS) grey values 0 … 255 for −x, +x, −y, +y, −z, +z; background 0.
    """

    rays: int
    views: tuple[NDArray[np.float64], ...]

    @classmethod
    def of(cls, mesh: TriangleMesh, grid: VoxelGrid, rays: int) -> MeshViews:
        """Look at a mesh.

        Parameters
        ----------
        mesh : the surface.
        grid : the cube around it.
        rays : along a side: `PIXELS` times a power of two, no fewer than the voxels to compare.
        """
        import open3d as o3d

        scene = o3d.t.geometry.RaycastingScene()
        local = ((mesh.vertices - grid.origin) / grid.size).astype(np.float32)
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(local),
            o3d.core.Tensor.from_numpy(mesh.triangles.astype(np.uint32)),
        )
        normals = face_normals_and_areas(mesh)[0]
        views = []
        for face in range(6):
            answer = scene.cast_rays(o3d.core.Tensor.from_numpy(_rays(rays, face)))
            hit = answer["primitive_ids"].numpy()
            found = hit < len(mesh.triangles)
            normal = normals[np.where(found, hit, 0)]
            views.append(_pixels(np.where(found, _shaded(normal, face), 0.0)))
        return cls(rays, tuple(views))

    def error_of(self, file: LodFile, level: int) -> float:
        """Mean absolute difference (of 255) over the pixels that either shows, six views.

        Parameters
        ----------
        file : voxels of the same cube.
        level : which to draw, of at most `rays` voxels a side.
        """
        total = count = 0.0
        for face, wanted in enumerate(self.views):
            image = _voxel_view(file, level, face, self.rays)
            shown = (image > 0) | (wanted > 0)
            total += float(np.abs(image - wanted)[shown].sum())
            count += float(shown.sum())
        return total / count


def seconds_to_make(mesh: TriangleMesh, file: LodFile, level: int) -> float:
    """Wall time of a file whose finest level this is, without the surface itself.

    Parameters
    ----------
    mesh : the surface the file was cut from.
    file : whose chunks it is made with; one thread.
    level : of 2**level voxels a side.
    """
    options = LodOptions(1 << level, geometry=False, chunk_level=file.chunk_level)
    with TemporaryDirectory() as folder:
        start = perf_counter()
        write_voxel_lod(mesh, Path(folder) / "made.vlod", options)
        return perf_counter() - start


def _rays(count: int, face: int) -> NDArray[np.float32]:
    """(count, count, 6) origins and directions in a cube of side 1, looking along an axis."""
    axis = face // 2
    steps = (np.arange(count) + 0.5) / count
    rays = np.zeros((count, count, 6), np.float32)
    rays[..., (axis + 1) % 3], rays[..., (axis + 2) % 3] = np.meshgrid(steps, steps, indexing="ij")
    rays[..., axis] = 2.0 if face % 2 else -1.0
    rays[..., 3 + axis] = -1.0 if face % 2 else 1.0
    return rays


def _shaded(normal: NDArray[np.float64], face: int) -> NDArray[np.float64]:
    """Grey values 0 … 255 of unit normals (…, 3) seen straight onto a face."""
    light = np.array([0.4, 0.5, 0.6])
    light[face // 2] = 1.0 if face % 2 else -1.0
    return np.asarray(255.0 * np.abs(normal @ (light / np.linalg.norm(light))))


def _pixels(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean over the rays of each pixel."""
    per_pixel = len(image) // PIXELS
    return np.asarray(image.reshape(PIXELS, per_pixel, PIXELS, per_pixel).mean(axis=(1, 3)))


def _voxel_view(file: LodFile, level: int, face: int, rays: int) -> NDArray[np.float64]:
    """The voxels of one level of a file (PIXELS, PIXELS) along an axis, background 0."""
    side, axis = 1 << level, face // 2
    image, depth = np.zeros((side, side)), np.full((side, side), -1, np.int64)
    for row in np.flatnonzero(file.nodes["level"] == level):
        chunk = file.chunk(int(row))
        cells = chunk.cells + (file.nodes["place"][row].astype(np.int64) << file.chunk_level)
        near = cells[:, axis] if face % 2 else side - 1 - cells[:, axis]
        u, v = cells[:, (axis + 1) % 3], cells[:, (axis + 2) % 3]
        # The last writer wins: the nearest comes last.
        order = np.argsort(near, kind="stable")
        normal = chunk.normal.astype(np.float64)
        kept = chunk.side >= 0
        normal[kept] = chunk.face_normal[chunk.side[kept], face]
        order = order[near[order] > depth[u[order], v[order]]]
        depth[u[order], v[order]] = near[order]
        image[u[order], v[order]] = _shaded(normal[order], face)
    scale = rays // side
    return _pixels(np.repeat(np.repeat(image, scale, axis=0), scale, axis=1))
