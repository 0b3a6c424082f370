"""What the page should show, computed without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skimage.metrics import structural_similarity

from workbench.geometry.mesh import TriangleMesh, vertex_normals

BACKGROUND = np.array([0xD6, 0xD5, 0xD2], np.float64)
AMBIENT = 0.3
# Pictures are small where they may be: a processor draws them, not a graphics card.
WIDTH, HEIGHT = 480, 240


@dataclass(frozen=True)
class View:
    """A camera as the page's address has it: local coordinates, degrees over the height."""

    eye: tuple[float, float, float]
    to: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fov: float = 35.0

    @property
    def link(self) -> str:
        """Its part of an address."""
        words = [",".join(map(str, place)) for place in (self.eye, self.to)]
        return f"eye={words[0]}&to={words[1]}&fov={self.fov}"


def ray_cast(mesh: TriangleMesh, view: View, width: int = 640, height: int = 480) -> np.ndarray:
    """What a view should show of a mesh in local coordinates, (h, w, 3) uint8.

    Headlight, vertex colours and normals; 2 × 2 rays for each pixel.
    """
    ways = pixel_rays(view, width, height, 2)
    ways = (ways / np.linalg.norm(ways, axis=-1, keepdims=True)).reshape(-1, 3)
    distance, face, weights = _hits(mesh, np.array(view.eye), ways)
    met = np.isfinite(distance)
    corners = mesh.triangles[face[met]]
    linear = _linear(np.asarray(mesh.vertex_attributes["color"], np.float64) / 255)
    albedo = (linear[corners] * weights[met][..., None]).sum(axis=1)
    normal = (vertex_normals(mesh)[corners] * weights[met][..., None]).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    facing = np.maximum(-(normal * ways[met]).sum(axis=1), 0.0)
    light = albedo * (AMBIENT + (1 - AMBIENT) * facing)[:, None]
    picture = np.tile(_linear(BACKGROUND / 255), (len(ways), 1))
    picture[met] = light
    pixels = picture.reshape(height, 2, width, 2, 3)
    return np.rint(255 * _encoded(_encoded_mean(pixels))).astype(np.uint8)


def pixel_rays(view: View, width: int, height: int, side: int = 1) -> np.ndarray:
    """Directions (h, w, 3) of rays of a view, of length 1 along its axis; side² for each pixel."""
    eye, to = np.array(view.eye), np.array(view.to)
    back = (eye - to) / np.linalg.norm(eye - to)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    scale = np.tan(np.radians(view.fov) / 2)
    y, x = (np.mgrid[: side * height, : side * width] + 0.5) / side
    across = (2 * x - width) / height * scale
    above = (height - 2 * y) / height * scale
    return across[..., None] * right + above[..., None] * up - back


def _hits(mesh: TriangleMesh, eye: np.ndarray, ways: np.ndarray) -> tuple[np.ndarray, ...]:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
    )
    rays = np.concatenate([np.broadcast_to(eye, ways.shape), ways], axis=1).astype(np.float32)
    answer = scene.cast_rays(o3d.core.Tensor(rays))
    uv = answer["primitive_uvs"].numpy().astype(np.float64)
    weights = np.column_stack([1 - uv.sum(axis=1), uv])
    return answer["t_hit"].numpy(), answer["primitive_ids"].numpy().astype(np.int64), weights


def _encoded_mean(pixels: np.ndarray) -> np.ndarray:
    """Multisampling averages what is written, which is encoded."""
    return _linear(_encoded(pixels).mean(axis=(1, 3)))


def _linear(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _encoded(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def similarity(one: np.ndarray, other: np.ndarray) -> float:
    """SSIM of two pictures (h, w, 3) uint8."""
    return float(structural_similarity(one, other, channel_axis=2, data_range=255))
