"""Binary COLMAP models against pycolmap, there and back, and cut or broken anywhere."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.colmap import (
    NO_POINT,
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoint,
    read_colmap_text,
)
from workbench.formats.colmap_binary import MODELS, read_colmap_binary, write_colmap_binary
from workbench.geometry import transforms

FILES = ("cameras.bin", "images.bin", "points3D.bin")


def some_model() -> ColmapModel:
    rng = np.random.default_rng(8)
    cameras = {
        2: ColmapCamera(2, "OPENCV", 640, 480, (600.1, 601.2, 320.3, 239.9, -0.1, 0.02, 1e-4, 0.0)),
        7: ColmapCamera(7, "SIMPLE_RADIAL", 320, 200, (300.25, 160.0, 100.0, 0.01)),
    }
    images = {}
    for number, camera in ((3, 2), (1, 7)):
        pose = transforms.rigid(
            Rotation.random(random_state=number).as_matrix(), rng.standard_normal(3)
        )
        pixels = rng.uniform(0, 200, (number, 2))
        ids = np.full(number, NO_POINT)
        ids[-1] = 9
        images[number] = ColmapImage(number, pose, camera, f"a folder/é {number}.jpg", pixels, ids)
    track = np.array([[3, 2], [1, 0]])
    point = ColmapPoint(9, rng.standard_normal(3), np.array([1, 20, 255], np.uint8), 0.5, track)
    return ColmapModel(cameras, images, {9: point})


def assert_same(found: ColmapModel, model: ColmapModel) -> None:
    assert found.cameras == model.cameras
    assert found.images.keys() == model.images.keys()
    for number, image in model.images.items():
        other = found.images[number]
        assert (other.name, other.camera_id) == (image.name, image.camera_id)
        np.testing.assert_allclose(other.camera_from_world, image.camera_from_world, atol=1e-14)
        np.testing.assert_array_equal(other.points2d, image.points2d)
        np.testing.assert_array_equal(other.point3d_ids, image.point3d_ids)
    assert found.points.keys() == model.points.keys()
    for number, point in model.points.items():
        np.testing.assert_array_equal(found.points[number].xyz, point.xyz)
        np.testing.assert_array_equal(found.points[number].rgb, point.rgb)
        np.testing.assert_array_equal(found.points[number].track, point.track)
        assert found.points[number].error == point.error


def test_reading_gives_back_what_was_written(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path / "model", some_model())
    assert_same(read_colmap_binary(tmp_path / "model"), some_model())


def test_pycolmap_reads_the_same_and_what_it_writes_is_read(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    model = some_model()
    write_colmap_binary(tmp_path / "ours", model)
    theirs = pycolmap.Reconstruction(str(tmp_path / "ours"))
    assert theirs.images[3].name == model.images[3].name
    np.testing.assert_allclose(
        theirs.images[3].cam_from_world().matrix(), model.images[3].camera_from_world[:3]
    )
    assert theirs.cameras[2].model.name == "OPENCV"
    (tmp_path / "theirs").mkdir()
    theirs.write_binary(str(tmp_path / "theirs"))
    assert_same(read_colmap_binary(tmp_path / "theirs"), model)
    theirs.write_text(str(tmp_path / "theirs"))
    assert_same(read_colmap_text(tmp_path / "theirs"), model)


def test_models_are_numbered_as_pycolmap_numbers_them() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    for number, name in enumerate(MODELS):
        assert pycolmap.CameraModelId(number).name == name


@pytest.mark.parametrize("file", FILES)
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, file: str) -> None:
    write_colmap_binary(tmp_path, some_model())
    whole = (tmp_path / file).read_bytes()
    for length in range(len(whole)):
        (tmp_path / file).write_bytes(whole[:length])
        with pytest.raises(InputError) as caught:
            read_colmap_binary(tmp_path)
        assert file in str(caught.value)
        assert length == 0 or "byte" in (caught.value.where or "")
    (tmp_path / file).write_bytes(whole + b"\0")
    with pytest.raises(InputError, match="1 bytes too many"):
        read_colmap_binary(tmp_path)


@settings(
    max_examples=300, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damage_is_refused_or_read_and_never_ends_the_process(
    tmp_path: Path, data: st.DataObject
) -> None:
    write_colmap_binary(tmp_path, some_model())
    file = data.draw(st.sampled_from(FILES))
    content = bytearray((tmp_path / file).read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place : place + 4] = data.draw(st.binary(min_size=1, max_size=8))
    (tmp_path / file).write_bytes(bytes(content))
    try:
        model = read_colmap_binary(tmp_path)
    except InputError:
        return
    assert all(np.isfinite(image.camera_from_world).all() for image in model.images.values())


def test_an_absurd_count_takes_no_memory(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path, some_model())
    for file in FILES:
        (tmp_path / file).write_bytes(struct.pack("<Q", 2**60))
        with pytest.raises(InputError, match="do not fit"):
            read_colmap_binary(tmp_path)
        write_colmap_binary(tmp_path, some_model())


def test_twins_and_strangers_are_refused(tmp_path: Path) -> None:
    model = some_model()
    write_colmap_binary(tmp_path, model)
    cameras = (tmp_path / "cameras.bin").read_bytes()
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<Q", 4) + cameras[8:] * 2)
    with pytest.raises(InputError, match="comes twice"):
        read_colmap_binary(tmp_path)
    write_colmap_binary(tmp_path, ColmapModel({2: model.cameras[2]}, model.images))
    with pytest.raises(InputError, match="camera that is not there"):
        read_colmap_binary(tmp_path)


def test_points_may_be_missing(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path, some_model())
    (tmp_path / "points3D.bin").unlink()
    assert read_colmap_binary(tmp_path).points == {}
