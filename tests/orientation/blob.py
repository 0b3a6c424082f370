"""A lumpy body without symmetry, photographed from all round: points and exact observations."""

from __future__ import annotations

import numpy as np
import trimesh

from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rigid

LENS = ColmapCamera(1, "OPENCV", 800, 600, (900.0, 900.0, 403.0, 298.0, -0.08, 0.03, 2e-4, -1e-4))


def body(subdivisions: int = 4) -> TriangleMesh:
    """About half a metre across."""
    ball = trimesh.creation.icosphere(subdivisions)
    way = np.asarray(ball.vertices)
    rng = np.random.default_rng(5)
    radius = np.ones(len(way))
    for _ in range(14):
        middle = rng.normal(size=3)
        middle /= np.linalg.norm(middle)
        radius += rng.uniform(0.1, 0.35) * np.exp(-np.sum((way - middle) ** 2, 1) / 0.15)
    return TriangleMesh(0.25 * radius[:, None] * way, np.asarray(ball.faces, np.int32))


def ring(count: int) -> list[np.ndarray]:
    """camera_from_world of cameras two metres off, at two heights, looking at the middle."""
    poses = []
    for k in range(count):
        angle, height = 2 * np.pi * k / count, 0.5 if k % 2 else -0.2
        center = np.array([1.6 * np.cos(angle), 1.6 * np.sin(angle), height])
        z = -center / np.linalg.norm(center)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        rotation = np.array([x, np.cross(z, x), z])
        poses.append(rigid(rotation, -rotation @ center))
    return poses


def photographed(
    mesh: TriangleMesh, cameras: int = 12, points: int = 900, noise_px: float = 0.0,
    stray: float = 0.0,
) -> ColmapModel:  # fmt: skip
    """Points on the body where cameras see them; ``stray`` of them hang in the air."""
    rng = np.random.default_rng(1)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chosen = rng.choice(len(corners), points, replace=False)
    weights = rng.dirichlet(np.ones(3), points)
    places = np.einsum("nc,ncd->nd", weights, corners[chosen])
    off = rng.random(points) < stray
    places[off] *= rng.uniform(1.3, 1.6, off.sum())[:, None]
    observed = {k: [] for k in range(1, points + 1)}
    images = {}
    for number, pose in enumerate(ring(cameras), 1):
        camera = PhotoCamera(LENS.model, LENS.width, LENS.height, LENS.params, pose)
        towards = camera.center - places
        cosine = (normals[chosen] * towards).sum(1) / np.linalg.norm(towards, axis=1)
        pixels, _ = camera.project(places)
        seen = np.flatnonzero((cosine > 0.3) | off)
        noisy = pixels[seen] + rng.normal(0, noise_px, (len(seen), 2))
        for row, k in enumerate(seen):
            observed[k + 1].append((number, row))
        images[number] = ColmapImage(number, pose, 1, f"photo_{number:02d}.png", noisy, seen + 1)
    kept = {k for k, track in observed.items() if len(track) >= 3}
    images = {
        n: ColmapImage(
            n, i.camera_from_world, 1, i.name, i.points2d,
            np.array([p if p in kept else -1 for p in i.point3d_ids]),
        )
        for n, i in images.items()
    }  # fmt: skip
    grey = np.full(3, 128, np.uint8)
    found = {
        k: ColmapPoint(k, places[k - 1].copy(), grey, 0.1, np.array(observed[k])) for k in kept
    }
    return ColmapModel({1: LENS}, images, found)
