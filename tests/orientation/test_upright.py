"""Photographs alone stand upright: z is up, the front is where the cameras stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
from workbench.geometry.similarity import Similarity
from workbench.geometry.transforms import inverse, looking_at
from workbench.orientation.alignment import transformed
from workbench.orientation.upright import standing

TURN = Rotation.from_rotvec([1.0, 1.7, -0.5]).as_matrix()
MIDDLE = np.array([3.0, -7.0, 11.0])
LENS = ColmapCamera(1, "SIMPLE_PINHOLE", 640, 480, (700.0, 320.0, 240.0))


def taken(
    places: Sequence[Sequence[float]], *, rolled_deg: Sequence[float] = (0.0,)
) -> ColmapModel:
    """Cameras at ``places`` around an object at the origin, z up; all of it then turned away."""
    images, rolls = {}, np.radians(np.resize(rolled_deg, len(places)))
    for number, (place, roll) in enumerate(zip(places, rolls, strict=True), 1):
        above = np.hypot(place[0], place[1]) < 1e-9
        pose = inverse(looking_at(place, (0, 0, 0), up=(0, 1, 0) if above else (0, 0, 1)))
        rolled = np.eye(4)
        rolled[:2, :2] = [[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]
        images[number] = ColmapImage(number, rolled @ pose, 1, f"photo_{number:02d}.jpg")
    half = np.random.default_rng(2).normal(size=(50, 3))
    spread = np.concatenate([half, -half])
    points = {
        number: ColmapPoint(number, place, np.zeros(3, np.uint8), 0.0, np.zeros((0, 2), np.int64))
        for number, place in enumerate(spread, 1)
    }
    return transformed(ColmapModel({1: LENS}, images, points), Similarity(1.0, TURN, MIDDLE))


def stands(model: ColmapModel) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """What was up and the middle once the model stands, and where its cameras do."""
    found = standing(model)
    stood = transformed(model, found).photo_cameras()
    places = {name: camera.center for name, camera in stood.items()}
    return found.rotation @ TURN @ [0.0, 0.0, 1.0], found.apply(MIDDLE), places


def around(count: int, elevation_deg: float, span_deg: float = 360.0) -> list[list[float]]:
    angles = np.radians(np.arange(count) * span_deg / count - 0.5 * span_deg)
    height = np.radians(elevation_deg)
    return [
        [9 * np.cos(a) * np.cos(height), 9 * np.sin(a) * np.cos(height), 9 * np.sin(height)]
        for a in angles
    ]


@pytest.mark.parametrize("elevation_deg", [-20.0, 0.0, 35.0])
def test_photographs_from_all_around_stand_upright(elevation_deg: float) -> None:
    rolled = np.random.default_rng(1).normal(0.0, 2.0, 24)
    up, middle, places = stands(taken(around(24, elevation_deg), rolled_deg=rolled))
    assert up[2] > np.cos(np.radians(1.5))
    assert middle == pytest.approx(np.zeros(3), abs=1e-9)
    # From all around: the first camera is in front.
    assert places["photo_01"][0] == pytest.approx(0.0, abs=1e-9)
    assert places["photo_01"][1] < -5.0


def test_from_one_side_and_from_above_the_tilt_is_told_where_cameras_turn() -> None:
    # A mean of what is up in these pictures would lean by 28 degrees.
    up, _, places = stands(taken(around(12, 30.0, span_deg=100.0)))
    assert up[2] > np.cos(np.radians(0.1))
    assert np.mean([place[1] for place in places.values()]) < -5.0
    assert np.mean([place[0] for place in places.values()]) == pytest.approx(0.0, abs=1e-6)


def test_cameras_side_by_side_that_look_one_way_stand_as_their_pictures_do() -> None:
    model = taken([[x, -9.0, 0.0] for x in np.linspace(-0.5, 0.5, 5)], rolled_deg=(1.0, -1.0))
    up, _, places = stands(model)
    assert up[2] > np.cos(np.radians(1.0))
    assert all(place[1] < -8.0 for place in places.values())


def test_from_above_up_is_where_the_cameras_are() -> None:
    model = taken([[0.0, 0.0, 9.0]] * 4, rolled_deg=(0.0, 90.0, 180.0, 270.0))
    up, _, places = stands(model)
    assert up[2] == pytest.approx(1.0)
    assert all(place[2] > 8.0 for place in places.values())
    one = taken([[0.0, 0.0, 9.0]])
    assert np.isfinite(standing(one).rotation).all()
    assert np.linalg.det(standing(one).rotation) == pytest.approx(1.0)
