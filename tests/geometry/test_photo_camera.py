"""Oriented photographs against a projection written out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import apply, rigid

POSE = rigid(Rotation.from_euler("xyz", [0.3, -0.5, 0.2]).as_matrix(), [0.1, -0.2, 1.5])
SIMPLE = PhotoCamera("SIMPLE_RADIAL", 600, 400, (700.0, 310.0, 190.0, -0.08), POSE)
LENSES = [
    SIMPLE,
    PhotoCamera("PINHOLE", 600, 400, (700.0, 690.0, 310.0, 190.0), POSE),
    PhotoCamera("OPENCV", 600, 400, (700.0, 690.0, 310, 190, -0.1, 0.02, 1e-3, -2e-3), POSE),
]


def test_points_are_imaged_as_the_model_says():
    points = np.random.default_rng(1).uniform(-0.3, 0.3, (50, 3))
    pixels, depth = SIMPLE.project(points)
    local = apply(POSE, points)
    x, y = (local[:, :2] / local[:, 2:]).T
    bend = 1.0 - 0.08 * (x * x + y * y)
    assert pixels == pytest.approx(
        np.column_stack([700 * bend * x + 310, 700 * bend * y + 190]), abs=1e-6
    )
    assert depth == pytest.approx(local[:, 2])


@pytest.mark.parametrize("camera", LENSES, ids=lambda camera: camera.model)
def test_a_ray_through_a_pixel_meets_what_is_imaged_there(camera):
    grid = np.stack(np.meshgrid([0.5, 150, 300, 599.5], [0.5, 200, 399.5]), -1).reshape(-1, 2)
    points = camera.center + 2.3 * camera.directions(grid)
    pixels, depth = camera.project(points)
    assert pixels == pytest.approx(grid, abs=1e-4)
    assert (depth > 0).all()


def test_what_is_behind_the_camera_has_no_pixel():
    behind = SIMPLE.center - SIMPLE.directions(np.array([[300.0, 200.0]]))
    pixels, depth = SIMPLE.project(np.vstack([behind, SIMPLE.center + SIMPLE.directions(
        np.array([[300.0, 200.0]]))]))  # fmt: skip
    assert np.isnan(pixels[0]).all()
    assert np.isfinite(pixels[1]).all()
    assert depth[0] < 0 < depth[1]
