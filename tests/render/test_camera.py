from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.transforms import apply, is_rigid
from workbench.render.camera import orbit_camera, orbit_cameras

BOUNDS = np.array([[-1.0, -2.0, -3.0], [2.0, 1.0, 4.0]])
CORNERS = np.array([[x, y, z] for x in BOUNDS[:, 0] for y in BOUNDS[:, 1] for z in BOUNDS[:, 2]])


@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("azimuth", [0.0, 37.0, 180.0, 290.0])
@pytest.mark.parametrize("size", [(300, 500), (500, 200)])
def test_the_whole_box_is_in_the_picture_and_reaches_its_margin(up, azimuth, size):
    camera = orbit_camera(BOUNDS, azimuth, 20.0, *size, up=up, margin=0.05)
    assert is_rigid(camera.camera_from_world, 1e-12)
    assert apply(camera.camera_from_world, CORNERS)[:, 2].min() > 0
    from_middle = np.abs(camera.project(CORNERS) / size - 0.5)
    assert from_middle.max() == pytest.approx(0.45, abs=1e-9)


@pytest.mark.parametrize(
    ("up", "right", "vertical", "viewer"),
    [("z", 0, 2, (1, -1)), ("y", 0, 1, (2, 1)), ("x", 1, 0, (2, -1))],
)
def test_the_front_view_has_right_at_the_right_and_up_on_top(up, right, vertical, viewer):
    camera = orbit_camera([[-1, -1, -1], [1, 1, 1]], 0, 0, 100, 100, up=up)
    middle = camera.project(np.zeros((1, 3)))[0]
    axes = 0.1 * np.eye(3)
    assert camera.project(axes[[right]])[0] == pytest.approx([middle[0] + 10, middle[1]], abs=9)
    assert camera.project(axes[[right]])[0, 0] > middle[0] + 1
    assert camera.project(axes[[vertical]])[0, 1] < middle[1] - 1
    axis, sign = viewer
    assert sign * camera.center_in_world[axis] > 1


def test_azimuth_90_shows_the_side_that_was_at_the_right():
    camera = orbit_camera([[-1, -1, -1], [1, 1, 1]], 90, 0, 100, 100)
    assert camera.center_in_world[0] > 1
    assert camera.center_in_world[1:] == pytest.approx([0, 0], abs=1e-9)


def test_cameras_around_an_object_share_their_distance():
    cameras = orbit_cameras(BOUNDS, [0, 90, 180, 270], 10, 200, 200)
    middle = BOUNDS.mean(axis=0)
    distances = [np.linalg.norm(camera.center_in_world - middle) for camera in cameras]
    assert np.ptp(distances) < 1e-9
