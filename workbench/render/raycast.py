"""What a camera sees of a mesh, by ray casting with Embree: no display, no GL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.render.camera import Camera

NO_FACE = -1
# Rays and answers of one band stay in the processor's cache.
_RAYS_AT_ONCE = 1 << 17


@dataclass(frozen=True)
class RayScene:
    """A mesh made ready for rays; build it once for several pictures.

    Attributes
    ----------
    mesh : the mesh, in world coordinates.
    center : (3,) float64 subtracted from the vertices before Embree's float32, so that a
        mesh far from the origin keeps its detail.
    size : length of the diagonal of the bounding box, in the mesh's unit.
    embree : the ``open3d.t.geometry.RaycastingScene`` over the centred vertices.
    normals : (n, 3) float32 unit vertex normals for shading.
    """

    mesh: TriangleMesh
    center: NDArray[np.float64]
    size: float
    embree: Any
    normals: NDArray[np.float32]

    @classmethod
    def of(cls, mesh: TriangleMesh) -> RayScene:
        """Build the ray-casting structure; normals are the mesh's ``normal`` or area-weighted."""
        import open3d as o3d  # Costs seconds: only who draws pays.

        center, size = _middle_and_size(mesh.vertices)
        scene = o3d.t.geometry.RaycastingScene()
        if len(mesh.triangles):
            scene.add_triangles(
                o3d.core.Tensor.from_numpy((mesh.vertices - center).astype(np.float32)),
                o3d.core.Tensor.from_numpy(mesh.triangles.astype(np.uint32)),
            )
        normals = mesh.vertex_attributes.get("normal")
        if normals is None:
            normals = vertex_normals(mesh)
        return cls(mesh, center, size, scene, normals.astype(np.float32))


@dataclass(frozen=True)
class RenderBuffers:
    """Per-pixel geometry of one view; rows × columns, first row on top.

    Attributes
    ----------
    depth : (h, w) float32 distance along the camera's z axis, infinite where nothing is.
    face : (h, w) int32 triangle, `NO_FACE` where nothing is.
    barycentric : (h, w, 3) float32 weights of the triangle's corners; 0 where nothing is.
    normal : (h, w, 3) float32 unit normal of the triangle in world coordinates, as its
        winding says (away from the camera for a triangle seen from behind).
    hit : (h, w) bool, whether there is a surface.
    """

    depth: NDArray[np.float32]
    face: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    normal: NDArray[np.float32]
    hit: NDArray[np.bool_]


def render_buffers(
    surface: TriangleMesh | RayScene, camera: Camera, samples_per_side: int = 1
) -> RenderBuffers:
    """Cast one ray through the middle of every (sub)pixel.

    Parameters
    ----------
    surface
        a mesh, or a `RayScene` when several views are wanted.
    camera
        where from.
    samples_per_side
        2 gives 2 × 2 rays per pixel and buffers of twice the width and height.
    """
    import open3d as o3d

    scene = RayScene.of(surface) if isinstance(surface, TriangleMesh) else surface
    width, height = camera.width * samples_per_side, camera.height * samples_per_side
    if not len(scene.mesh.triangles):
        return _empty_buffers(height, width)
    origin, across, down = _ray_terms(scene, camera, samples_per_side)
    buffers = _empty_buffers(height, width)
    band = max(1, _RAYS_AT_ONCE // width)
    rays = np.empty((band, width, 6), np.float32)
    rays[..., :3] = origin
    for top in range(0, height, band):
        rows = slice(top, min(top + band, height))
        count = rows.stop - top
        np.add(across[None], down[rows, None], out=rays[:count, :, 3:])
        answer = scene.embree.cast_rays(o3d.core.Tensor.from_numpy(rays[:count]))
        # Directions have unit z, so that the ray parameter is the depth.
        depth = answer["t_hit"].numpy()
        buffers.depth[rows] = depth
        buffers.hit[rows] = np.isfinite(depth)
        # Most pixels show background: only the hits are worth arithmetic.
        at = np.flatnonzero(buffers.hit[rows])
        face = answer["primitive_ids"].numpy().ravel()[at]
        buffers.face[rows].reshape(-1)[at] = face.astype(np.int32)
        uv = answer["primitive_uvs"].numpy().reshape(-1, 2)[at]
        weights = np.column_stack([1 - uv[:, 0] - uv[:, 1], uv])
        buffers.barycentric[rows].reshape(-1, 3)[at] = weights
        normal = answer["primitive_normals"].numpy().reshape(-1, 3)[at]
        length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
        normal /= np.maximum(length, np.float32(1e-30))[:, None]
        buffers.normal[rows].reshape(-1, 3)[at] = normal
    return buffers


def ray_directions(
    scene: RayScene,
    camera: Camera,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    samples_per_side: int = 1,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origin (3,), relative to ``scene.center``, and directions (p, 3) of the rays of (sub)pixels.

    ``origin + depth * direction`` is the surface point there.
    """
    origin, across, down = _ray_terms(scene, camera, samples_per_side)
    return origin, across[columns] + down[rows]


def open_sky(
    scene: RayScene,
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    direction_sets: NDArray[np.float32],
    set_of_point: NDArray[np.intp],
    reach: float,
) -> NDArray[np.float32]:
    """Share of the cosine-weighted hemisphere that is free of surface near each point.

    Parameters
    ----------
    scene
        the mesh.
    points
        (p, 3) surface positions relative to ``scene.center``.
    normals
        (p, 3) unit normals towards the open side.
    direction_sets
        (s, r, 3) sets of unit directions, cosine-distributed about +z.
    set_of_point
        (p,) which of the sets each point uses.
    reach
        how far an obstacle may be to count, in the mesh's unit.

    Returns
    -------
    (p,) float32 in [0, 1]; 1 is fully open.
    """
    import open3d as o3d

    rays_each = direction_sets.shape[1]
    tangent, bitangent = _tangent_frames(normals)
    local = direction_sets[set_of_point]
    rays = np.empty((len(points), rays_each, 6), np.float32)
    # Lifted off the surface, so that a facet does not hide itself at grazing angles.
    rays[..., :3] = (points + normals * np.float32(1e-3 * scene.size))[:, None]
    rays[..., 3:] = (
        local[..., 0:1] * tangent[:, None]
        + local[..., 1:2] * bitangent[:, None]
        + local[..., 2:3] * normals[:, None]
    )
    blocked = scene.embree.test_occlusions(
        o3d.core.Tensor.from_numpy(rays), 0.0, float(reach)
    ).numpy()
    return np.asarray(1 - blocked.mean(axis=1, dtype=np.float32), np.float32)


def _ray_terms(
    scene: RayScene, camera: Camera, samples_per_side: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Origin (3,) and two terms (w, 3), (h, 3) whose sum is the direction of unit camera z.

    Directions are affine in column and row: two short tables replace a matrix product per
    pixel.
    """
    camera_from_centered = camera.camera_from_world @ transforms.rigid(np.eye(3), scene.center)
    rotation = camera_from_centered[:3, :3]
    columns = (np.arange(camera.width * samples_per_side) + 0.5) / samples_per_side
    rows = (np.arange(camera.height * samples_per_side) + 0.5) / samples_per_side
    world_from_pixel = rotation.T @ np.linalg.inv(camera.K)
    across = columns[:, None] * world_from_pixel[:, 0]
    down = rows[:, None] * world_from_pixel[:, 1] + world_from_pixel[:, 2]
    origin = transforms.inverse(camera_from_centered)[:3, 3]
    return origin.astype(np.float32), across.astype(np.float32), down.astype(np.float32)


def _tangent_frames(
    normals: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two unit vectors (p, 3) square to each normal (Duff et al. 2017, JCGT 6(1), listing 3)."""
    x, y, z = normals.T
    sign = np.where(z < 0, np.float32(-1), np.float32(1))
    a = -1 / (sign + z)
    b = x * y * a
    tangent = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    bitangent = np.stack([b, sign + y * y * a, -y], axis=1)
    return tangent, bitangent


def _middle_and_size(vertices: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    if not len(vertices):
        return np.zeros(3), 0.0
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    return 0.5 * (lower + upper), float(np.linalg.norm(upper - lower))


def _empty_buffers(height: int, width: int) -> RenderBuffers:
    return RenderBuffers(
        np.full((height, width), np.inf, np.float32),
        np.full((height, width), NO_FACE, np.int32),
        np.zeros((height, width, 3), np.float32),
        np.zeros((height, width, 3), np.float32),
        np.zeros((height, width), bool),
    )
