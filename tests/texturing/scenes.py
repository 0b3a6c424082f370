"""Cameras about the origin, and pictures of a surface that is painted by its place."""

from __future__ import annotations

import numpy as np

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import rigid


def camera_at(center, target=(0, 0, 0), size=(240, 180), focal=260.0, bend=-0.08) -> PhotoCamera:
    """Upright at a place, looking at another; the lens bends lines."""
    center, target = np.asarray(center, float), np.asarray(target, float)
    forward = (target - center) / np.linalg.norm(target - center)
    down = np.array([0.0, 0.0, -1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    width, height = size
    params = (focal, 0.5 * width, 0.5 * height, bend)
    return PhotoCamera("SIMPLE_RADIAL", width, height, params, rigid(turn, -turn @ center))


def ring(count, distance=3.0, height=0.4, **options) -> dict[int, PhotoCamera]:
    """Cameras evenly round the origin."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return {
        k: camera_at((distance * np.cos(a), distance * np.sin(a), height), **options)
        for k, a in enumerate(angles)
    }


def paint(points) -> np.ndarray:
    """Colours (n, 3) in [0, 1] of places (n, 3): smooth, and different everywhere."""
    x, y, z = np.asarray(points).T
    return 0.5 + 0.4 * np.stack(
        [np.sin(3 * x + y), np.sin(2 * y - 3 * z + 1), np.sin(4 * z + 2 * x)], axis=1
    )


def picture(rays: SurfaceRays, camera: PhotoCamera, gain=1.0, shift=0.0) -> np.ndarray:
    """A texture picture of the painted surface, brighter by a gain, its paint shifted."""
    met = rays.seen_by(camera)
    out = np.zeros((camera.height * camera.width, 4), np.uint8)
    colors = np.clip(gain * paint(met.points[met.found] + shift), 0.0, 1.0)
    out[met.found, :3] = np.round(255 * colors)
    out[met.found, 3] = 255
    return out.reshape(camera.height, camera.width, 4)


def sheet(corner, along, up, steps) -> TriangleMesh:
    """A flat rectangle of (steps + 1)² vertices; ``along`` × ``up`` is its outside."""
    u, v = np.meshgrid(np.linspace(0, 1, steps + 1), np.linspace(0, 1, steps + 1))
    points = np.asarray(corner) + u.reshape(-1, 1) * np.asarray(along, float)
    points = points + v.reshape(-1, 1) * np.asarray(up, float)
    a = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).ravel()
    b, c, d = a + 1, a + steps + 2, a + steps + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(points, triangles.astype(np.int32))


def together(*meshes: TriangleMesh) -> TriangleMesh:
    """One mesh of several."""
    offset = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [mesh.triangles + n for mesh, n in zip(meshes, offset[:-1], strict=True)]
        ).astype(np.int32),
    )
