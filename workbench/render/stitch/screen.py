"""Where the corners of triangles fall in a picture, and what is cut off before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import apply, rotate
from workbench.kernels.triangle_raster import FARTHEST_PX
from workbench.render.camera import Camera

# A lens is believed this share of the picture beyond its borders. Farther out its polynomial
# may turn back into the picture, and it goes on as a pinhole instead.
_MARGIN = 0.1
_BORDER_STEPS = 32
# Of the distance to the farthest vertex: nearer than that nothing is drawn.
_NEAR = 1e-4
_PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")


@dataclass(frozen=True)
class ScreenMesh:
    """Triangles of one mesh as a camera sees them.

    Attributes
    ----------
    pixels : (n, 2) float64 of the corners, at most `FARTHEST_PX` from the picture.
    depths : (n,) float64 along the camera's axis, positive.
    triangles : (m, 3) int32.
    numbers : (m,) int32, which triangle of the mesh each is a part of; ascending.
    """

    pixels: NDArray[np.float64]
    depths: NDArray[np.float64]
    triangles: NDArray[np.int32]
    numbers: NDArray[np.int32]


def photo_camera(camera: Camera) -> PhotoCamera:
    """The same pinhole camera as photographs have."""
    K = camera.K
    params = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return PhotoCamera("PINHOLE", camera.width, camera.height, params, camera.camera_from_world)


class Screen:
    """A camera's picture, to put corners of triangles on.

    Photographs' lenses are not straight. Corners are imaged by the real lens and edges between
    them drawn straight: an edge of n pixels bends by about k · n² / (4 f), below a hundredth of
    a pixel for the small triangles of depth meshes, and neither the picture nor the labels have
    to be resampled. A pinhole is exact.

    Parameters
    ----------
    camera : of the picture.
    """

    def __init__(self, camera: PhotoCamera) -> None:
        self.camera = camera
        self._pinhole = camera.model in _PINHOLES
        model, params = camera.model, camera.params
        self._focal = np.array([params[0], params[1] if model == "PINHOLE" else params[0]])
        self._middle = np.array(params[-2:]) if self._pinhole else np.zeros(2)
        along = np.linspace(0.0, 1.0, _BORDER_STEPS)
        border: NDArray[np.float64] = np.concatenate(
            [np.column_stack(pair) for k in (0.0, 1.0) for pair in _sides(along, k)]
        )
        size = np.array([camera.width, camera.height], np.float64)
        ways = rotate(
            camera.camera_from_world, camera.directions(np.asarray(border * size, np.float64))
        )
        slopes = ways[:, :2] / ways[:, 2:]
        spread = _MARGIN * (slopes.max(axis=0) - slopes.min(axis=0))
        self._low, self._high = slopes.min(axis=0) - spread, slopes.max(axis=0) + spread

    def slopes(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
        """(p, 2) right and down per forward of the rays through the middles of some pixels."""
        pixels = np.column_stack([columns, rows]).astype(np.float64) + 0.5
        if self._pinhole:
            return np.asarray((pixels - self._middle) / self._focal)
        ways = rotate(self.camera.camera_from_world, self.camera.directions(pixels))
        return np.asarray(ways[:, :2] / ways[:, 2:])

    def placed(
        self, vertices_in_world: NDArray[np.float64], triangles: NDArray[np.int32]
    ) -> ScreenMesh:
        """Vertices (n, 3) and triangles (m, 3) in the picture, cut where they come too near."""
        points = apply(self.camera.camera_from_world, vertices_in_world)
        numbers = np.arange(len(triangles), dtype=np.int32)
        farthest = float(points[:, 2].max(initial=0.0))
        if farthest <= 0.0:
            return ScreenMesh(np.zeros((0, 2)), np.zeros(0), triangles[:0], numbers[:0])
        near = _NEAR * farthest
        reach = FARTHEST_PX / (4.0 * float(self._focal.max()))
        z = points[:, 2]
        bad = (z < near) | (np.abs(points[:, 0]) > reach * z) | (np.abs(points[:, 1]) > reach * z)
        if bad.any():
            points, triangles, numbers = _cut(points, triangles, bad, near, reach)
        return ScreenMesh(self._imaged(points), points[:, 2].copy(), triangles, numbers)

    def _imaged(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of points (n, 3) in the camera's frame; of those behind it anything."""
        slopes = points[:, :2] / np.where(points[:, 2:] > 0.0, points[:, 2:], 1.0)
        if self._pinhole:
            return np.asarray(slopes * self._focal + self._middle)
        held = np.clip(slopes, self._low, self._high)
        ways = np.column_stack([held, np.ones(len(held))])
        flat = PhotoCamera(
            self.camera.model, self.camera.width, self.camera.height, self.camera.params, np.eye(4)
        )
        pixels, _ = flat.project(ways)
        return np.asarray(pixels + (slopes - held) * self._focal)


def _sides(along: NDArray[np.float64], k: float) -> list[tuple[NDArray[np.float64], ...]]:
    across = np.full(len(along), k)
    return [(along, across), (across, along)]


def _cut(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    bad: NDArray[np.bool_],
    near: float,
    reach: float,
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Points, triangles and their numbers with what is too near or too far aside cut off."""
    whole = ~bad[triangles].any(axis=1)
    touched = np.flatnonzero(~whole)
    touched = touched[~(points[triangles[touched]][:, :, 2] < near).all(axis=1)]
    planes = [np.array([0.0, 0.0, 1.0, -near])]
    planes += [np.array([sx, sy, reach, 0.0]) for sx, sy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    pieces: list[NDArray[np.float64]] = []
    owners: list[int] = []
    for t in touched:
        polygon = points[triangles[t]]
        for plane in planes:
            polygon = _clipped(polygon, plane)
        for k in range(1, len(polygon) - 1):
            pieces.append(polygon[[0, k, k + 1]])
            owners.append(int(t))
    kept = np.flatnonzero(whole)
    if not pieces:
        return points, triangles[kept], kept.astype(np.int32)
    new = np.concatenate(pieces)
    added = (len(points) + np.arange(len(new), dtype=np.int32)).reshape(-1, 3)
    numbers = np.concatenate([kept, np.array(owners)])
    order = np.argsort(numbers, kind="stable")
    together = np.concatenate([triangles[kept], added])[order]
    return np.concatenate([points, new]), together, numbers[order].astype(np.int32)


def _clipped(polygon: NDArray[np.float64], plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part (j, 3) of a convex polygon (i, 3) on the positive side of a plane (4,)."""
    if not len(polygon):
        return polygon
    level = polygon @ plane[:3] + plane[3]
    corners = []
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if level[i] >= 0.0:
            corners.append(polygon[i])
        if (level[i] >= 0.0) != (level[j] >= 0.0):
            # Always from the inner corner: triangles that share the edge get the same point.
            inner, outer = (i, j) if level[i] >= 0.0 else (j, i)
            share = level[inner] / (level[inner] - level[outer])
            corners.append(polygon[inner] + share * (polygon[outer] - polygon[inner]))
    return np.array(corners).reshape(-1, 3)
