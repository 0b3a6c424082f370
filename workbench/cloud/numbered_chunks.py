"""A layered cloud's samples numbered through, chunk by chunk, and those that a camera may see."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.layered_cloud import LayeredCloud
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import PlainBlock
from workbench.geometry.regions import Frustum
from workbench.geometry.transforms import apply, inverse, rotate


class NumberedChunks:
    """The chunks of a cloud in the order of space, their samples numbered through.

    Attributes
    ----------
    order : (k,) chunks; neighbours follow one another.
    starts : (k + 1,) number of each one's first sample, and how many there are.
    spacing : by chunk, distance of samples to the nearest of all levels.
    """

    def __init__(self, cloud: LayeredCloud) -> None:
        nodes = cloud.tree.nodes
        self._cloud = cloud
        self.order = cloud.chunks()
        self.starts = np.append(0, np.cumsum(nodes["count"][self.order], dtype=np.int64))
        self.spacing = nodes["spacing_m"].astype(np.float64)
        for chunk in cloud.chunks("bottom_up"):
            parent = nodes["parent"][chunk]
            if parent >= 0:
                self.spacing[parent] = min(self.spacing[parent], self.spacing[chunk])

    def blocks(self, camera: PhotoCamera) -> Iterator[PlainBlock]:
        """Those a camera may see."""
        nodes, cloud = self._cloud.tree.nodes, self._cloud
        region = view_region(camera, *cloud.bounds)
        # A subtree's bounds are larger than its chunk's, never smaller.
        touched = region.meets(nodes["low"], nodes["high"])
        for chunk, start in zip(self.order, self.starts, strict=False):
            if touched[chunk]:
                arrays = cloud.read(int(chunk), ["points", "normals"])
                spacing = np.full(len(arrays["points"]), self.spacing[chunk])
                normals = arrays["normals"].astype(np.float64)
                yield PlainBlock(int(start), arrays["points"], normals, spacing)

    def ranges(self, most: int) -> Iterator[slice]:
        """Chunks in a row, by their places in ``order``, of so many samples at most."""
        first = 0
        while first < len(self.order):
            last = int(np.searchsorted(self.starts, self.starts[first] + most, side="right")) - 1
            yield slice(first, max(last, first + 1))
            first = max(last, first + 1)


def view_region(
    camera: PhotoCamera, low: NDArray[np.float64], high: NDArray[np.float64]
) -> Frustum:
    """All that a camera may see of what lies between two corners (3,), and a little more."""
    width, height = camera.width, camera.height
    along = np.linspace(0.0, 1.0, 9)
    rim = [(x * width, y) for x in along for y in (0.0, height)]
    rim += [(x, y * height) for y in along for x in (0.0, width)]
    ways = rotate(camera.camera_from_world, camera.directions(np.array(rim)))
    slopes = 1.02 * np.abs(ways[:, :2] / ways[:, 2:]).max(axis=0)
    corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T
    far = float(apply(camera.camera_from_world, corners)[:, 2].max())
    world_from_camera = inverse(camera.camera_from_world)
    return Frustum(world_from_camera, float(slopes[0]), float(slopes[1]), 0.0, max(far, 1e-3))
