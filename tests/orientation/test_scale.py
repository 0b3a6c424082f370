"""The scale of photographs by coded markers and by distances between cameras."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import inverse, looking_at
from workbench.orientation.scale import (
    MARKER_DICTIONARIES,
    NoScale,
    markers_in,
    scale_by_cameras,
    scale_by_markers,
)

# The model's unit is half a metre.
UNIT = 0.5
SIZE, FOCAL = (640, 480), 700.0
CENTERS = {3: np.array([-0.4, 0.1]), 7: np.array([0.35, -0.2])}
SIDE = 0.24


def camera(x: float) -> PhotoCamera:
    pose = inverse(looking_at((x, 0.3, 2.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0)))
    return PhotoCamera("SIMPLE_PINHOLE", *SIZE, (FOCAL, SIZE[0] / 2, SIZE[1] / 2), pose)


CAMERAS = {"a": camera(-0.5), "b": camera(0.1), "c": camera(0.6)}


def photographed(one: PhotoCamera, dictionary: str) -> np.ndarray:
    """Two markers on the plane z = 0 as a camera sees them."""
    known = cv2.aruco.getPredefinedDictionary(MARKER_DICTIONARIES[dictionary])
    picture = np.full((SIZE[1], SIZE[0]), 220, np.uint8)
    for number, middle in CENTERS.items():
        drawn = cv2.aruco.generateImageMarker(known, number, 400)
        tile = np.full((560, 560), 220, np.uint8)
        tile[80:480, 80:480] = drawn
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * SIDE / 2.0 + middle
        pixels, _ = one.project(np.column_stack([corners, np.zeros(4)]))
        source = np.array([[80, 80], [480, 80], [480, 480], [80, 480]], np.float32) - 0.5
        turn = cv2.getPerspectiveTransform(source, (pixels - 0.5).astype(np.float32))
        drawn = cv2.warpPerspective(tile, turn, SIZE, flags=cv2.INTER_AREA, borderValue=0)
        inside = cv2.warpPerspective(np.ones_like(tile), turn, SIZE, flags=cv2.INTER_NEAREST)
        picture[inside > 0] = drawn[inside > 0]
    return cv2.GaussianBlur(picture, (0, 0), 0.7)


@pytest.mark.parametrize("dictionary", ["apriltag-36h11", "aruco-5x5"])
def test_markers_of_known_side_and_of_known_distance_tell_the_scale(dictionary: str) -> None:
    corners = {n: markers_in(photographed(c, dictionary), dictionary) for n, c in CAMERAS.items()}
    assert all(set(found) == {3, 7} for found in corners.values())
    by_side = scale_by_markers(CAMERAS, corners, SIDE * UNIT, {})
    assert by_side
    assert by_side.metres == pytest.approx(UNIT, rel=0.01)
    assert by_side.told_by == 8
    assert by_side.spread < 0.02
    apart = UNIT * float(np.linalg.norm(CENTERS[3] - CENTERS[7]))
    by_bar = scale_by_markers(CAMERAS, corners, None, {(3, 7): apart})
    assert by_bar
    assert by_bar.metres == pytest.approx(UNIT, rel=0.003)


def test_markers_nobody_sees_or_that_do_not_cross_tell_nothing() -> None:
    nothing = scale_by_markers(CAMERAS, {name: {} for name in CAMERAS}, 0.1, {})
    assert isinstance(nothing, NoScale)
    corners = {n: markers_in(photographed(c, "aruco-4x4"), "aruco-4x4") for n, c in CAMERAS.items()}
    # Another marker of the same number in one of two photographs.
    two = {"a": {3: corners["a"][3]}, "b": {3: corners["b"][3] + [60.0, 40.0]}}
    assert not scale_by_markers(CAMERAS, two, 0.1, {})


def test_cameras_at_known_distances_tell_the_scale() -> None:
    found = scale_by_cameras(CAMERAS, {("a", "b"): 0.6 * UNIT, ("b", "c"): 0.5 * UNIT})
    assert found
    assert found.metres == pytest.approx(UNIT)
    assert found.told_by == 2
    lost = scale_by_cameras(CAMERAS, {("a", "z"): 1.0})
    assert isinstance(lost, NoScale)
    assert "z" in lost.reason
