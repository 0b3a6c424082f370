"""Small scenes of which the right picture is known."""

from __future__ import annotations

import numpy as np

from workbench.geometry.labelled_mesh import LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rigid


def pinhole(width=120, height=90, focal=100.0, center=(0.0, 0.0, 0.0), turn=None) -> PhotoCamera:
    """Looks along +z; ``turn`` is a rotation camera from world."""
    rotation = np.eye(3) if turn is None else turn
    return PhotoCamera(
        "PINHOLE",
        width,
        height,
        (focal, focal, width / 2, height / 2),
        rigid(rotation, -rotation @ np.asarray(center, float)),
    )


def turned_by(degrees: float) -> np.ndarray:
    """Camera from world of a camera that looks to the right by so much."""
    a = np.radians(degrees)
    return np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])


def wall(z=2.0, half=2.0, cells=8, x=(-1.0, 1.0)) -> TriangleMesh:
    """A square sheet at a depth that faces who looks along +z, or columns of it."""
    columns = np.linspace(x[0] * half, x[1] * half, cells + 1)
    rows = np.linspace(-half, half, cells + 1)
    px, py = np.meshgrid(columns, rows)
    vertices = np.column_stack([px.ravel(), py.ravel(), np.full(px.size, z)])
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]
    # Counter-clockwise for who looks along +z with y down: a, c, b.
    triangles = np.concatenate(
        [np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)]
    )
    return TriangleMesh(vertices, triangles.astype(np.int32))


def labelled(mesh: TriangleMesh, labels=0, foreground=True, penalties=1.0) -> LabelledMesh:
    """With the same for all triangles, or an array."""
    m = len(mesh.triangles)
    return LabelledMesh(
        mesh,
        np.broadcast_to(np.asarray(labels, np.int32), m).copy(),
        np.broadcast_to(np.asarray(foreground, bool), m).copy(),
        np.broadcast_to(np.asarray(penalties, np.float32), m).copy(),
    )


def middles(mesh: TriangleMesh) -> np.ndarray:
    """(m, 3) of the triangles."""
    return mesh.vertices[mesh.triangles].mean(axis=1)


def plain(camera: PhotoCamera, rgb, alpha=255) -> np.ndarray:
    """A texture picture of one colour."""
    picture = np.empty((camera.height, camera.width, 4), np.uint8)
    picture[..., :3] = rgb
    picture[..., 3] = alpha
    return picture


def border_pairs(label: np.ndarray, seen: np.ndarray) -> int:
    """Direct neighbours of different labels."""
    across = (label[:, 1:] != label[:, :-1]) & seen[:, 1:] & seen[:, :-1]
    down = (label[1:] != label[:-1]) & seen[1:] & seen[:-1]
    return int(across.sum() + down.sum())
