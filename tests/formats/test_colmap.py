"""COLMAP text models against pycolmap and against damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.colmap import (
    NO_POINT,
    PARAMETER_COUNTS,
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoint,
    read_colmap_text,
    write_colmap_text,
)
from workbench.geometry import transforms


def some_model() -> ColmapModel:
    rng = np.random.default_rng(4)
    cameras = {
        1: ColmapCamera(
            1, "OPENCV", 640, 480, (600.1, 601.2, 320.3, 239.9, -0.1, 0.02, 1e-4, 3e-4)
        ),
        3: ColmapCamera(3, "SIMPLE_RADIAL", 320, 200, (1 / 3 + 300, 160.0, 100.0, 0.01)),
    }
    images = {}
    for number, camera in ((1, 1), (2, 3), (5, 1)):
        pose = transforms.rigid(
            Rotation.random(random_state=number).as_matrix(), rng.standard_normal(3)
        )
        pixels = rng.uniform(0, 200, (2 * number - 2, 2))
        ids = np.full(len(pixels), NO_POINT)
        ids[:1] = 7
        name = f"folder/photo-{number}.dng"
        images[number] = ColmapImage(number, pose, camera, name, pixels, ids)
    track = np.array([[2, 0], [5, 0]])
    point = ColmapPoint(7, rng.standard_normal(3), np.array([1, 20, 255], np.uint8), 0.5, track)
    return ColmapModel(cameras, images, {7: point})


def test_reading_gives_back_what_was_written(tmp_path: Path) -> None:
    model = some_model()
    write_colmap_text(tmp_path, model)
    again = read_colmap_text(tmp_path)
    assert again.cameras == model.cameras
    assert list(again.images) == list(model.images)
    for number, image in model.images.items():
        other = again.images[number]
        assert (other.name, other.camera_id) == (image.name, image.camera_id)
        np.testing.assert_allclose(other.camera_from_world, image.camera_from_world, atol=1e-15)
        np.testing.assert_array_equal(other.points2d, image.points2d)
        np.testing.assert_array_equal(other.point3d_ids, image.point3d_ids)
    np.testing.assert_array_equal(again.points[7].xyz, model.points[7].xyz)
    np.testing.assert_array_equal(again.points[7].rgb, model.points[7].rgb)
    np.testing.assert_array_equal(again.points[7].track, model.points[7].track)
    assert again.image_named("folder/photo-2.dng").image_id == 2


def test_pycolmap_reads_the_same_model(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    model = some_model()
    write_colmap_text(tmp_path, model)
    theirs = pycolmap.Reconstruction(str(tmp_path))
    assert set(theirs.cameras) == set(model.cameras)
    for number, camera in model.cameras.items():
        assert theirs.cameras[number].model.name == camera.model
        np.testing.assert_array_equal(theirs.cameras[number].params, camera.params)
    for number, image in model.images.items():
        pose = theirs.images[number].cam_from_world().matrix()
        np.testing.assert_allclose(pose, image.camera_from_world[:3], atol=1e-14)
        assert theirs.images[number].name == image.name
        assert len(theirs.images[number].points2D) == len(image.points2d)
    np.testing.assert_array_equal(theirs.points3D[7].xyz, model.points[7].xyz)


def test_a_model_that_pycolmap_wrote_is_read(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    write_colmap_text(tmp_path / "ours", some_model())
    (tmp_path / "theirs").mkdir()
    pycolmap.Reconstruction(str(tmp_path / "ours")).write_text(str(tmp_path / "theirs"))
    again = read_colmap_text(tmp_path / "theirs")
    for number, image in some_model().images.items():
        pose = again.images[number].camera_from_world
        np.testing.assert_allclose(pose, image.camera_from_world, atol=1e-12)
    assert again.points[7].track.tolist() == [[2, 0], [5, 0]]


def test_every_model_has_the_parameters_that_pycolmap_expects() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    for model, count in PARAMETER_COUNTS.items():
        camera = pycolmap.Camera.create_from_model_name(1, model, 500.0, 640, 480)
        assert len(camera.params) == count


@pytest.mark.parametrize(
    ("file", "line", "message"),
    [
        ("cameras.txt", "1 OPENCV 640 480 1 2 3", "OPENCV has 8 parameters"),
        ("cameras.txt", "1 SPHERE 640 480 1 2 3", "unknown camera model"),
        ("cameras.txt", "1 PINHOLE 640 480 1 2 nan 3", "not finite"),
        ("cameras.txt", "1 PINHOLE 640", "cannot be read"),
        ("images.txt", "1 0 0 0 0 0 0 0 1 a.jpg", "quaternion is zero"),
        ("images.txt", "1 1 0 0 0 0 0 0 a.jpg", "10 values expected"),
        ("images.txt", "1 1 0 0 0 0 0 0 9 a.jpg", "camera that is not there"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 2", "cannot be read"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a\n\n1 1 0 0 0 0 0 0 1 b\n", "comes twice"),
        ("points3D.txt", "1 0 0 0 300 0 0 1", "colours"),
        ("points3D.txt", "1 0 0 0 30 0 0 1 4", "cannot be read"),
    ],
)
def test_damage_is_named(tmp_path: Path, file: str, line: str, message: str) -> None:
    write_colmap_text(tmp_path, some_model())
    (tmp_path / file).write_text(f"# comment\n{line}\n", encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read_colmap_text(tmp_path)
    assert file in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing"):
        read_colmap_text(tmp_path)


def test_a_name_with_a_space_is_refused(tmp_path: Path) -> None:
    images = {1: ColmapImage(1, np.eye(4), 1, "photo 1.dng")}
    with pytest.raises(InputError, match="no room"):
        write_colmap_text(tmp_path, ColmapModel(some_model().cameras, images))


def test_points_may_be_missing(tmp_path: Path) -> None:
    write_colmap_text(tmp_path, some_model())
    (tmp_path / "points3D.txt").unlink()
    assert read_colmap_text(tmp_path).points == {}
