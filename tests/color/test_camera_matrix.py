"""Colours without a chart are those of an ordinary raw converter."""

from __future__ import annotations

import numpy as np

from workbench.color.camera_matrix import camera_color, profile_color
from workbench.color.spaces import working_space
from workbench.formats.icc_profile import srgb_profile

CAMERA_FROM_XYZ = np.array([[0.8, -0.2, -0.1], [-0.4, 1.2, 0.3], [-0.1, 0.2, 0.8]])


def test_white_stays_white_and_colours_come_back() -> None:
    space = working_space("rec709")
    color, told = camera_color(space, np.array([2.0, 1.0, 1.5]), CAMERA_FROM_XYZ)
    np.testing.assert_allclose(
        color.applied(np.array([[0.5, 1.0, 1 / 1.5]], np.float32)), 1.0, rtol=1e-5
    )
    assert "maker" in told
    xyz_from_rgb = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    to_camera = CAMERA_FROM_XYZ @ xyz_from_rgb
    rgb = np.array([[0.6, 0.2, 0.1], [0.1, 0.4, 0.3]])
    seen = rgb @ (to_camera / to_camera.sum(axis=1, keepdims=True)).T / [2.0, 1.0, 1.5]
    np.testing.assert_allclose(color.applied(seen.astype(np.float32)), rgb, atol=1e-3)


def test_what_is_not_known_is_said() -> None:
    color, told = camera_color(working_space("rec709"), None, None)
    np.testing.assert_array_equal(color.matrix, np.eye(3))
    assert told == "no white balance, no colour matrix"


def test_a_picture_keeps_its_colours() -> None:
    color = profile_color(working_space("rec709"), srgb_profile().xyz_d50_from_rgb)
    np.testing.assert_allclose(color.matrix, np.eye(3), atol=2e-3)
    wide = profile_color(working_space("prophoto"), srgb_profile().xyz_d50_from_rgb)
    white = wide.applied(np.ones((1, 3), np.float32))
    np.testing.assert_allclose(white, 1.0, atol=2e-3)
