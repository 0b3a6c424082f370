"""Photographs of known cameras are oriented; what cannot be is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.orientation.corner_pictures import (
    FOCAL,
    HEIGHT,
    WIDTH,
    corner_camera,
    corner_picture,
)
from workbench.errors import InputError
from workbench.formats.colmap import NO_POINT, ColmapModel
from workbench.geometry.similarity import Similarity, best_similarity
from workbench.geometry.transforms import inverse
from workbench.orientation.features import FeatureSettings
from workbench.orientation.mapping import MappingSettings
from workbench.orientation.photographs import PhotoToOrient
from workbench.orientation.structure_from_motion import (
    Orientation,
    OrientationSettings,
    oriented,
)

FEW = OrientationSettings(features=FeatureSettings(max_features=1000))
POSES = {f"{k}.png": corner_camera(-1 + k / 4, 0.5 + 0.05 * (k % 3)) for k in range(9)}


@pytest.fixture(scope="module")
def pictures() -> dict[str, np.ndarray]:
    return {name: corner_picture(pose) for name, pose in POSES.items()}


def photos_of(pictures: dict[str, np.ndarray], focal: float | None = None) -> list[PhotoToOrient]:
    return [PhotoToOrient(name, picture, "A", focal) for name, picture in pictures.items()]


def center_errors(model: ColmapModel, truth: dict[str, np.ndarray]) -> np.ndarray:
    """Distances of the cameras to the true ones after the best similarity."""
    images = list(model.images.values())
    found = np.array([inverse(image.camera_from_world)[:3, 3] for image in images])
    true = np.array([inverse(truth[image.name])[:3, 3] for image in images])
    similarity = best_similarity(found, true)
    assert isinstance(similarity, Similarity)
    return np.linalg.norm(similarity.apply(found) - true, axis=1)


def same(a: Orientation, b: Orientation) -> bool:
    """Whether two orientations are the same to the last bit."""
    images = zip(a.model.images.values(), b.model.images.values(), strict=True)
    return (
        a.model.cameras == b.model.cameras
        and all(
            x.name == y.name
            and np.array_equal(x.camera_from_world, y.camera_from_world)
            and np.array_equal(x.points2d, y.points2d)
            and np.array_equal(x.point3d_ids, y.point3d_ids)
            for x, y in images
        )
        and a.model.points.keys() == b.model.points.keys()
        and all(np.array_equal(p.xyz, b.model.points[n].xyz) for n, p in a.model.points.items())
    )


@pytest.fixture(scope="module")
def corner(pictures: dict[str, np.ndarray]) -> Orientation:
    return oriented(photos_of(pictures), FEW)


def test_every_photograph_is_placed_where_it_was_taken(corner: Orientation) -> None:
    assert corner
    assert corner.unplaced == {}
    # The cameras stand three metres off; nothing but the pictures was known.
    assert center_errors(corner.model, POSES).max() < 0.006
    (camera,) = corner.model.cameras.values()
    assert camera.params[0] == pytest.approx(FOCAL, rel=5e-3)
    assert 0.05 < corner.reprojection_px < 0.6
    assert corner.mean_track > 3
    assert corner.pairs_verified <= corner.pairs_compared == 36


def test_the_model_tells_which_feature_shows_which_point(
    corner: Orientation, pictures: dict[str, np.ndarray]
) -> None:
    model = corner.model
    seen = 0
    for image in model.images.values():
        camera = model.photo_cameras()[image.name.removesuffix(".png")]
        rows = np.flatnonzero(image.point3d_ids != NO_POINT)
        points = [model.points[number] for number in image.point3d_ids[rows]]
        pixels, _ = camera.project(np.array([point.xyz for point in points]))
        assert np.linalg.norm(pixels - image.points2d[rows], axis=1).max() < 5.0
        for row, point in zip(rows, points, strict=True):
            assert [image.image_id, row] in point.track.tolist()
        seen += len(rows)
    assert seen == sum(len(point.track) for point in model.points.values())
    # A point bears the colour of what it lies on.
    point = max(model.points.values(), key=lambda point: len(point.track))
    shades = []
    for number, row in point.track:
        x, y = model.images[number].points2d[row].astype(int)
        shades.append(pictures[model.images[number].name][y, x])
    np.testing.assert_allclose(point.rgb, np.mean(shades, axis=0), atol=0.51)


def test_the_result_does_not_depend_on_the_run_or_the_number_of_workers(
    corner: Orientation, pictures: dict[str, np.ndarray]
) -> None:
    for workers in (1, 3):
        assert same(corner, oriented(photos_of(pictures), replace(FEW, workers=workers)))


def test_strangers_are_named_with_their_reasons(
    corner: Orientation, pictures: dict[str, np.ndarray]
) -> None:
    blank = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    other = corner_picture(corner_camera(0.1), seed=5)
    found = oriented(photos_of(pictures | {"blank.png": blank, "other.png": other}), FEW)
    assert len(found.model.images) == len(POSES)
    assert "no features" in found.unplaced["blank.png"]
    assert "no other photograph" in found.unplaced["other.png"]


def test_of_two_subjects_the_larger_is_kept(pictures: dict[str, np.ndarray]) -> None:
    few = dict(list(pictures.items())[2:7])
    others = {f"other {k}.png": corner_picture(corner_camera(k / 4), seed=5) for k in range(3)}
    found = oriented(photos_of(others | few), FEW)
    assert {image.name for image in found.model.images.values()} == few.keys()
    assert found.unplaced.keys() == others.keys()
    assert all("none of which" in reason for reason in found.unplaced.values())


def test_photographs_that_show_nothing_in_common_give_a_reason() -> None:
    pictures = {f"{k}.png": corner_picture(corner_camera(0.0), seed=k) for k in range(2)}
    found = oriented(photos_of(pictures))
    assert not found
    assert "enough of the same" in found.reason
    assert found.unplaced.keys() == pictures.keys()
    assert not oriented([])
    alone = oriented(photos_of(pictures)[:1], FEW)
    assert not alone
    assert alone.unplaced.keys() == {"0.png"}


def test_features_stay_inside_the_masks(pictures: dict[str, np.ndarray], tmp_path: Path) -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, : WIDTH // 2] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    photos = [replace(photo, mask=tmp_path / "mask.png") for photo in photos_of(pictures)]
    photos[3] = replace(photos[3], mask=np.zeros_like(mask))
    found = oriented(photos, FEW)
    assert len(found.model.images) >= 6
    assert "3.png" in found.unplaced
    for image in found.model.images.values():
        assert len(image.points2d) > 100
        assert image.points2d[:, 0].max() <= WIDTH // 2 + 0.5


def test_cameras_are_shared_by_key_and_size(pictures: dict[str, np.ndarray]) -> None:
    photos = photos_of(pictures, FOCAL)
    photos = [replace(p, camera_key="AB"[k % 2]) for k, p in enumerate(photos)]
    model = oriented(photos, FEW).model
    assert len(model.cameras) == 2
    assert {model.image_named(f"{k}.png").camera_id for k in (0, 2, 4)} != {
        model.image_named(f"{k}.png").camera_id for k in (1, 3, 5)
    }


def test_the_global_mapper_places_them_too(pictures: dict[str, np.ndarray]) -> None:
    settings = replace(FEW, mapping=MappingSettings(mapper="global"))
    found = oriented(photos_of(pictures, FOCAL), settings)
    assert len(found.model.images) == len(POSES)
    assert center_errors(found.model, POSES).max() < 0.006


def test_bad_input_is_refused_with_its_name(pictures: dict[str, np.ndarray]) -> None:
    photos = photos_of(pictures)
    with pytest.raises(InputError, match=r"twice[\s\S]*0\.png"):
        oriented([photos[0], photos[0]])
    with pytest.raises(InputError, match="not of the photograph's size"):
        oriented([replace(photos[0], mask=np.zeros((HEIGHT, WIDTH - 1), np.uint8)), photos[1]])
    with pytest.raises(InputError, match="focal length"):
        oriented([replace(photos[0], focal_px=float("nan")), photos[1]])
    with pytest.raises(InputError, match="no picture"):
        oriented([replace(photos[0], picture=np.zeros((9, 9), np.uint8)), photos[1]])
    with pytest.raises(InputError, match="cannot be read"):
        oriented([replace(photos[0], picture=Path("absent.jpg")), photos[1]])


def test_progress_is_told_and_can_stop_the_work(pictures: dict[str, np.ndarray]) -> None:
    told: list[tuple[str, float]] = []
    few = dict(list(pictures.items())[3:6])
    oriented(photos_of(few), FEW, lambda step, share: told.append((step, share)))
    assert [step for step, share in told if share == 0.0] == [
        "features",
        "matching",
        "placing",
        "adjusting",
    ]
    assert all(0.0 <= share <= 1.0 for _, share in told)

    class StopError(Exception):
        pass

    def stop(step: str, share: float) -> None:
        if step == "placing" and share > 0.5:
            raise StopError

    with pytest.raises(StopError):
        oriented(photos_of(few), FEW, stop)


def test_nothing_is_written_to_the_terminal(
    pictures: dict[str, np.ndarray], capfd: pytest.CaptureFixture[str]
) -> None:
    oriented(photos_of(dict(list(pictures.items())[3:6])), FEW)
    assert capfd.readouterr() == ("", "")
