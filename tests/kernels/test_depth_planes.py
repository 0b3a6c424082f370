"""Normals of planes out of depth pictures, in the camera's frame."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.kernels.depth_planes import plane_normals

WIDTH, HEIGHT, FOCAL = 80, 60, 100.0
LENS = (FOCAL, FOCAL, 39.0, 31.0)


def rays() -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return np.stack([(x - LENS[2]) / FOCAL, (y - LENS[3]) / FOCAL, np.ones(x.shape)], axis=-1)


def normals_of(inverse: np.ndarray, size: float) -> np.ndarray:
    out = np.empty((HEIGHT, WIDTH, 3))
    plane_normals(inverse, np.full(inverse.shape, size), LENS, out)
    return out


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.6, 0, -0.8), (-0.3, 0.5, -0.8), (0, -0.9, -0.6)])
def test_a_plane_has_its_normal_at_every_pixel(normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    inverse = (rays() @ normal) / (-5.0)
    inverse[inverse < 0.02] = 0.0
    found = normals_of(inverse, 0.2)
    there = inverse > 0
    np.testing.assert_allclose(found[there], np.broadcast_to(normal, (there.sum(), 3)), atol=1e-9)
    assert np.isnan(found[~there]).all()


def test_steps_of_cells_do_not_turn_a_slope_and_edges_belong_to_one_side():
    normal = np.array([0.5, 0.2, -0.8]) / np.linalg.norm([0.5, 0.2, -0.8])
    depth = -5.0 / (rays() @ normal)
    stepped = 0.05 * np.floor(depth / 0.05)
    found = normals_of(1.0 / stepped, 0.05)
    inner = found[10:-10, 10:-10]
    assert np.degrees(np.arccos((inner @ normal).clip(-1, 1))).max() < 15
    # Another surface far behind, from the middle on.
    inverse = np.full((HEIGHT, WIDTH), 0.2)
    inverse[:, 40:] = 0.05
    np.testing.assert_allclose(
        normals_of(inverse, 0.05), np.broadcast_to([0, 0, -1.0], (HEIGHT, WIDTH, 3))
    )


def test_a_pixel_alone_faces_the_camera():
    inverse = np.zeros((HEIGHT, WIDTH))
    inverse[50, 7] = 0.5
    way = rays()[50, 7]
    np.testing.assert_allclose(normals_of(inverse, 0.01)[50, 7], -way / np.linalg.norm(way))
