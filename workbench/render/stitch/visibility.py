"""First pass: which mesh and which triangle is front-most at every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.triangle_raster import draw_front
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.screen import Screen, ScreenMesh

NO_TRIANGLE = -1


@dataclass(frozen=True)
class Visibility:
    """What is front-most.

    Attributes
    ----------
    depth : (h, w) float32 along the camera's axis, infinite where nothing is.
    triangle : (h, w) int32 number of the scene's triangle, `NO_TRIANGLE` where nothing is.
    mesh : (h, w) int32 its mesh, −1 where nothing is.
    label : (h, w) int32 its photograph; `NO_PHOTO` where it has none, too.
    """

    depth: NDArray[np.float32]
    triangle: NDArray[np.int32]
    mesh: NDArray[np.int32]
    label: NDArray[np.int32]


def on_screen(scene: StitchScene, mesh: int, screen: Screen) -> tuple[ScreenMesh, int]:
    """One mesh of a scene in the picture, its numbers being the scene's; and its first number."""
    corners = slice(scene.vertex_starts[mesh], scene.vertex_starts[mesh + 1])
    first, last = int(scene.starts[mesh]), int(scene.starts[mesh + 1])
    triangles = scene.triangles[first:last] - np.int32(corners.start)
    placed = screen.placed(scene.vertices[corners], triangles)
    numbers = placed.numbers + np.int32(first)
    return ScreenMesh(placed.pixels, placed.depths, placed.triangles, numbers), first


def visibility(scene: StitchScene, camera: PhotoCamera) -> Visibility:
    """Draw all meshes with a z-buffer, faces that turn their back left out.

    A shader writes the triangle's number, from which mesh and label follow, with the hardware's
    depth test.
    """
    screen = Screen(camera)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    triangle = np.full(depth.shape, NO_TRIANGLE, np.int32)
    for mesh in range(scene.meshes):
        placed, _ = on_screen(scene, mesh, screen)
        draw_front(placed.pixels, placed.depths, placed.triangles, placed.numbers, depth, triangle)
    return Visibility(depth, triangle, scene.mesh_of(triangle), scene.label_of(triangle))
