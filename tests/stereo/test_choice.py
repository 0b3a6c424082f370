"""Neighbours and depths, by points that photographs share and without them."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
from workbench.geometry.transforms import inverse, looking_at
from workbench.stereo.choice import chosen_neighbours, depth_span, seen_points

COUNT, FAR = 12, 5.0


def ring(points: np.ndarray, turns: np.ndarray | None = None) -> ColmapModel:
    """Cameras around the origin; each sees the points on its side."""
    turns = 2.0 * np.pi * np.arange(COUNT) / COUNT if turns is None else turns
    images, tracks = {}, {k: [] for k in range(len(points))}
    for k, turn in enumerate(turns):
        place = FAR * np.array([np.cos(turn), np.sin(turn), 0.0])
        pose = inverse(looking_at(place, (0.0, 0.0, 0.0)))
        images[k + 1] = ColmapImage(k + 1, pose, 1, f"photo_{k:02d}.png")
        for number in np.flatnonzero(points @ place > 0.3 * FAR):
            tracks[int(number)].append((k + 1, 0))
    lens = ColmapCamera(1, "SIMPLE_PINHOLE", 400, 300, (500.0, 200.0, 150.0))
    return ColmapModel(
        {1: lens},
        images,
        {
            k + 1: ColmapPoint(k + 1, points[k], np.zeros(3, np.uint8), 0.5, np.array(track))
            for k, track in tracks.items()
            if track
        },
    )


def on_ball(count: int) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.mark.parametrize("count", [500, 0])
def test_neighbours_stand_beside_and_see_from_other_places(count: int) -> None:
    model = ring(on_ball(count))
    points = seen_points(model, {f"photo_{k:02d}": 0.6 for k in range(COUNT)})
    found = chosen_neighbours(points, model.photo_cameras(), 2)
    for k in range(COUNT):
        beside = {f"photo_{(k + step) % COUNT:02d}" for step in (-1, 1)}
        assert set(found[f"photo_{k:02d}"]) == beside


def test_points_without_tracks_tell_neighbours_and_spans_too() -> None:
    tracked = ring(on_ball(500))
    bare = {
        number: ColmapPoint(number, point.xyz, point.rgb, point.error, np.zeros((0, 2), np.int64))
        for number, point in tracked.points.items()
    }
    points = seen_points(ColmapModel(tracked.cameras, tracked.images, bare), {})
    cameras = tracked.photo_cameras()
    found = chosen_neighbours(points, cameras, 2)
    assert set(found["photo_05"]) == {"photo_04", "photo_06"}
    near, far = depth_span(points, 3, cameras["photo_03"])
    assert 2.5 < near < FAR - 0.9
    assert FAR + 0.9 < far < FAR + 2.0


def test_views_from_nearly_the_same_place_are_poor_neighbours() -> None:
    turns = np.radians([0.0, 0.5, 15.0, 30.0, 90.0])
    model = ring(on_ball(800), turns)
    found = chosen_neighbours(seen_points(model, {}), model.photo_cameras(), 4)
    assert found["photo_00"][0] == "photo_02"
    assert found["photo_00"].index("photo_01") > found["photo_00"].index("photo_03")


@pytest.mark.parametrize("count", [500, 0])
def test_spans_hold_the_object(count: int) -> None:
    model = ring(on_ball(count))
    points = seen_points(model, {f"photo_{k:02d}": 500.0 * 2.0 / FAR / 300.0 for k in range(COUNT)})
    near, far = depth_span(points, 3, model.photo_cameras()["photo_03"])
    assert 2.5 < near < FAR - 1.0
    assert FAR - 0.3 < far < FAR + 1.0


def test_cameras_side_by_side_without_points_are_refused() -> None:
    model = ring(on_ball(0))
    pose = model.images[1].camera_from_world
    images = {}
    for k in range(4):
        moved = pose.copy()
        moved[0, 3] += k
        images[k + 1] = ColmapImage(k + 1, moved, 1, f"photo_{k:02d}.png")
    side_by_side = ColmapModel(model.cameras, images)
    with pytest.raises(InputError, match="how far the object is"):
        seen_points(side_by_side, {f"photo_{k:02d}": 0.6 for k in range(4)})
