"""A street's painted front, photographed along it: each photograph sees few of the others' places.

As in the buildings of Arikan et al., table 1, and unlike an object that is walked round.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.texturing.scenes import camera_at, picture, sheet
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays

LENGTH, HEIGHT, AWAY, STEPS = 64.0, 4.0, 3.0, 400
SIZE, FOCAL, TURN = (900, 600), 780.0, 0.8


def street_front() -> TriangleMesh:
    """Pillars and bays of half a metre, rounded so that a sheet can have them."""
    flat = sheet((0.0, 0.0, 0.0), (LENGTH, 0, 0), (0, 0, HEIGHT), STEPS)
    x, _, z = flat.vertices.T
    depth = 0.25 * np.tanh(6.0 * np.sin(2.0 * x)) + 0.05 * np.sin(5.0 * z)
    return TriangleMesh(np.column_stack([x, depth, z]), flat.triangles)


def street_cameras(count: int) -> dict[int, PhotoCamera]:
    """Along the street, turned to the left and right in turns."""
    cameras = {}
    for k in range(count):
        x = (k + 0.5) * LENGTH / count
        turn = TURN if k % 2 else -TURN
        place, target = (x, -AWAY, 0.45 * HEIGHT), (x + turn, 0.0, 0.5 * HEIGHT)
        cameras[k] = camera_at(place, target, SIZE, FOCAL, bend=-0.02)
    return cameras


def take(rays: SurfaceRays, camera: PhotoCamera, number: int, path: Path) -> None:
    """A texture picture as a file; its exposure is a little off, so that seams cost something."""
    off = 1.0 + 0.05 * np.sin(7.0 * number)
    cv2.imwrite(str(path), picture(rays, camera, off)[..., [2, 1, 0, 3]])


def read(path: Path) -> NDArray[np.uint8]:
    """As texture pictures are: red first."""
    stored = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.uint8)
    return np.ascontiguousarray(stored[..., [2, 1, 0, 3]])
