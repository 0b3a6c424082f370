"""Pictures of Potree clouds, as the page draws and lights them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.formats.gltf import srgb_from_linear
from workbench.formats.potree_reading import PotreeCloud, PotreeNode
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.point_set import PointSet, joined
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.surfels.drawing import disc_view
from workbench.viewer.page_light import PLAIN, Light, lit

# Points are that many spacings wide: the nearest on a surface may be a cell's diagonal away.
_WIDTH = 1.7
_NARROWEST_PX = 1.5
# Along a side of a node, to tell how much surface its points lie on.
_CELLS = 16


def cloud_picture(
    cloud: PotreeCloud, camera: PhotoCamera, light: Light = "camera", gap_px: float = 1.0
) -> NDArray[np.uint8]:
    """What a camera sees of points, (h, w, 4) uint8 sRGB; alpha 0 where nothing is.

    Points are round, and as wide as the gaps between them.

    Parameters
    ----------
    cloud
        A folder of Potree.
    camera
        A pinhole camera in its frame.
    light
        See `page_light.lit`.
    gap_px
        Nodes are added until the gaps between points are no wider, pixels.

    Raises
    ------
    InputError
        The cloud is damaged, or the camera has another lens.
    """
    picture = np.zeros((camera.height, camera.width, 4), np.uint8)
    chosen = _chosen(cloud, camera, gap_px)
    read = {row: cloud.read(cloud.nodes[row]) for row in chosen}
    gaps = _gaps(cloud, read)
    ahead = camera.camera_from_world[2, :3]
    parts, radii = [], []
    for row, points in read.items():
        node = cloud.nodes[row]
        upper = points.points >= node.lower + 0.5 * node.side
        octants = upper @ np.array([4, 2, 1])
        depth = np.maximum((points.points - camera.center) @ ahead, 1e-9)
        width = np.maximum(_WIDTH * gaps[row][octants], _NARROWEST_PX * depth / camera.params[0])
        parts.append(points)
        radii.append(0.5 * width)
    points, radius = joined(parts), np.concatenate(radii)
    if not len(points):
        return picture
    facing = np.broadcast_to(ahead.astype(np.float32), (len(points), 3)).copy()
    view = disc_view(PointSet(points.points, facing), radius, camera)
    seen = view.covered
    shown = view.number[seen]
    albedo = np.full((len(shown), 3), PLAIN)
    if points.color is not None:
        albedo = LINEAR_OF_BYTE[points.color[shown]]
    normals = np.zeros((len(shown), 3))
    if points.normals is not None:
        normals = points.normals[shown].astype(np.float64)
    ways = points.points[shown] - camera.center
    picture[seen, :3] = srgb_from_linear(lit(albedo, normals, ways, light))
    picture[seen, 3] = 255
    return picture


def _chosen(cloud: PotreeCloud, camera: PhotoCamera, gap_px: float) -> list[int]:
    """Rows of nodes that a view needs."""
    chosen = []
    waiting = [(0, np.inf)]
    while waiting:
        row, gap = waiting.pop()
        node = cloud.nodes[row]
        if gap <= gap_px or not _in_view(node, camera):
            continue
        if node.points:
            chosen.append(row)
        outside = np.maximum(node.lower - camera.center, camera.center - node.lower - node.side)
        pixel = float(np.linalg.norm(np.maximum(outside, 0.0))) / camera.params[0]
        left = cloud.spacing / 2.0**node.level / max(pixel, 1e-30)
        waiting += [(child, min(left, gap)) for child in node.children]
    return sorted(chosen)


def _in_view(node: PotreeNode, camera: PhotoCamera) -> bool:
    """Whether the ball around a node reaches into the pyramid of the picture."""
    middle = np.append(node.lower + 0.5 * node.side, 1.0)
    x, y, z = camera.camera_from_world[:3] @ middle
    radius = 0.5 * np.sqrt(3.0) * node.side
    fx, fy, cx, cy = camera.params
    for at, focal, low, high in ((x, fx, cx, camera.width - cx), (y, fy, cy, camera.height - cy)):
        for side, edge in ((at, high), (-at, low)):
            if (focal * side - edge * z) / np.hypot(focal, edge) > radius:
                return False
    return bool(z > -radius)


def _gaps(cloud: PotreeCloud, read: dict[int, PointSet]) -> dict[int, NDArray[np.float64]]:
    """Gaps between points in each octant (8,) of each node: as the finest children close them."""
    gaps: dict[int, NDArray[np.float64]] = {}
    for row in sorted(read, reverse=True):
        node = cloud.nodes[row]
        gaps[row] = np.full(8, _own_gap(node, read[row], cloud.spacing))
        for child in node.children:
            if child in gaps:
                gaps[row][cloud.nodes[child].octant] = gaps[child].max()
    return gaps


def _own_gap(node: PotreeNode, points: PointSet, spacing: float) -> float:
    """Between the points of a node; where a cloud ends they are wider than its level's."""
    cells = np.floor(_CELLS * (points.points - node.lower) / node.side).astype(np.int64)
    numbers = np.clip(cells, 0, _CELLS - 1) @ np.array([_CELLS**2, _CELLS, 1])
    covered = len(np.unique(numbers))
    return max(
        node.side / _CELLS * float(np.sqrt(covered / max(len(points), 1))),
        spacing / 2.0**node.level,
    )
