"""Pictures of a painted inner corner, and the cameras that took them; nothing to download."""

from __future__ import annotations

import cv2
import numpy as np

from workbench.geometry.transforms import Matrix4, inverse, rigid

WIDTH, HEIGHT, FOCAL = 480, 360, 450.0
_TEXELS = 500


def corner_camera(turn: float, height: float = 0.55, distance: float = 3.0) -> Matrix4:
    """camera_from_world of a camera that looks into the corner; ``turn`` from −1 to 1."""
    azimuth = np.radians(45.0 + 30.0 * turn)
    center = np.array([np.cos(azimuth), np.sin(azimuth), height]) * distance
    forward = np.array([0.35, 0.35, 0.35]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    world_from_camera = rigid(np.column_stack([right, np.cross(forward, right), forward]), center)
    return inverse(world_from_camera)


def corner_picture(camera_from_world: Matrix4, seed: int = 0) -> np.ndarray:
    """The corner's picture (HEIGHT, WIDTH, 3) uint8; the seed is that of its paint."""
    # OpenCV calls the centre of the upper left pixel (0, 0).
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for number, (across, along) in enumerate(((0, 1), (1, 2), (2, 0))):
        plane = np.zeros((4, 3))
        plane[across, 0] = plane[along, 1] = 1.5 / _TEXELS
        plane[3, 2] = 1.0
        mapping = intrinsics @ camera_from_world[:3] @ plane
        paint = _paint(3 * seed + number)
        size = (WIDTH, HEIGHT)
        face = cv2.warpPerspective(paint, mapping, size, flags=cv2.INTER_LINEAR)
        inside = cv2.warpPerspective(
            np.full(paint.shape[:2], 255, np.uint8), mapping, size, flags=cv2.INTER_NEAREST
        )
        picture[inside > 0] = face[inside > 0]
    return picture


def _paint(seed: int) -> np.ndarray:
    """Noise of several sizes, in colour."""
    rng = np.random.default_rng(seed)
    total = np.zeros((_TEXELS, _TEXELS, 3))
    for size in (2.0, 5.0, 10.0):
        noise = cv2.GaussianBlur(rng.normal(size=total.shape), (0, 0), size)
        total += noise / noise.std()
    return np.clip(128 + 35 * total, 0, 255).astype(np.uint8)
