"""Whatever a ready-made orientation is, it is recognised and goes to the right photographs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from workbench.errors import InputError
from workbench.formats.colmap import (
    NO_POINT,
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoint,
    write_colmap_text,
)
from workbench.formats.colmap_binary import write_colmap_binary
from workbench.formats.photo_orientations import read_orientations
from workbench.geometry.transforms import rigid

NAMES = ("A.JPG", "b.jpg", "c.jpg")


def photographs(folder: Path, names: Sequence[str] = NAMES, size=(64, 48)) -> list[Path]:
    folder.mkdir(exist_ok=True)
    for name in names:
        Image.new("RGB", size).save(folder / name, format="JPEG")
    return [folder / name for name in names]


def model(names: Sequence[str] = NAMES) -> ColmapModel:
    camera = ColmapCamera(1, "OPENCV", 64, 48, (70.0, 71.0, 33.0, 25.0, 0.1, 0.2, 0.3, 0.4))
    images = {
        k + 1: ColmapImage(
            k + 1, rigid(np.eye(3), [k, 0, 5]), 1, name, np.array([[k, 4.0]]), np.array([9])
        )
        for k, name in enumerate(names)
    }
    track = np.array([[k + 1, 0] for k in range(len(names))])
    point = ColmapPoint(9, np.zeros(3), np.zeros(3, np.uint8), 0.5, track)
    lonely = ColmapPoint(11, np.ones(3), np.zeros(3, np.uint8), 0.5, track[-1:])
    return ColmapModel({1: camera}, images, {9: point, 11: lonely})


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
@pytest.mark.parametrize("below", [".", "sparse/0"])
def test_colmap_models_are_found(tmp_path: Path, write, below: str) -> None:
    write(tmp_path / "given" / below, model())
    found = read_orientations(tmp_path / "given", photographs(tmp_path / "photos"))
    assert [image.name for image in found.images.values()] == list(NAMES)
    assert found.cameras == model().cameras
    assert found.points[9].track.tolist() == [[1, 0], [2, 0], [3, 0]]
    suffix = "txt" if write is write_colmap_text else "bin"
    by_file = read_orientations(
        tmp_path / "given" / below / f"images.{suffix}", photographs(tmp_path / "photos")
    )
    assert by_file.images.keys() == found.images.keys()


def test_the_other_formats_are_found_by_their_names(tmp_path: Path) -> None:
    photos = photographs(tmp_path / "photos")
    (tmp_path / "bundler").mkdir()
    text = "# Bundle file v0.3\n1 0\n70 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 -5\n"
    (tmp_path / "bundler" / "bundle.out").write_text(text)
    (tmp_path / "bundler" / "list.txt").write_text("./images/b.jpg 0 70\n")
    (tmp_path / "nerf").mkdir()
    frame = {"file_path": "images/b", "transform_matrix": np.diag([1, -1, -1, 1]).tolist()}
    frame["transform_matrix"][2][3] = -5
    (tmp_path / "nerf" / "transforms.json").write_text(json.dumps({"fl_x": 70, "frames": [frame]}))
    (tmp_path / "agisoft").mkdir()
    (tmp_path / "agisoft" / "any.xml").write_text(
        '<document><chunk><sensors><sensor id="0"><resolution width="64" height="48"/>'
        "<calibration><f>70</f></calibration></sensor></sensors><cameras>"
        '<camera id="0" sensor_id="0" label="b"><transform>1 0 0 0 0 1 0 0 0 0 1 -5 0 0 0 1'
        "</transform></camera></cameras></chunk></document>"
    )
    for folder in ("bundler", "nerf", "agisoft"):
        found = read_orientations(tmp_path / folder, photos)
        assert [image.name for image in found.images.values()] == ["b.jpg"]
        # However it is written, a camera 5 behind the origin that looks at it.
        pixels, depths = found.photo_cameras()["b"].project(np.array([[0.5, 0.25, 0.0]]))
        if folder == "bundler":
            pixels, depths = found.photo_cameras()["b"].project(np.array([[0.5, -0.25, 0.0]]))
        np.testing.assert_allclose(pixels, [[32 + 7.0, 24 + 3.5]])
        np.testing.assert_allclose(depths, [5.0])


def test_bundlers_cameras_without_a_list_are_the_photographs_in_order(tmp_path: Path) -> None:
    camera = "{} 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 -5\n"
    (tmp_path / "bundle.out").write_text(
        "# Bundle file v0.3\n3 0\n" + camera.format(0) + camera.format(70) + camera.format(80)
    )
    photos = photographs(tmp_path / "photos")
    found = read_orientations(tmp_path / "bundle.out", photos[::-1])
    assert {i.name: found.cameras[i.camera_id].params[0] for i in found.images.values()} == {
        "b.jpg": 70.0,
        "c.jpg": 80.0,
    }
    with pytest.raises(InputError, match="does not go with"):
        read_orientations(tmp_path / "bundle.out", photos[:2])


def test_names_match_by_file_then_by_stem_in_any_case(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path / "m", model(("x/y/a.jpg", "B.png", "other.jpg")))
    found = read_orientations(tmp_path / "m", photographs(tmp_path / "photos"))
    assert {number: image.name for number, image in found.images.items()} == {
        1: "A.JPG",
        2: "b.jpg",
    }
    # What only the unknown image saw is gone with it.
    assert found.points.keys() == {9}
    assert found.points[9].track.tolist() == [[1, 0], [2, 0]]
    assert found.images[1].point3d_ids.tolist() == [9]


def test_an_image_whose_point_is_gone_sees_none(tmp_path: Path) -> None:
    whole = model()
    write_colmap_binary(tmp_path / "m", ColmapModel(whole.cameras, whole.images, {}))
    found = read_orientations(tmp_path / "m", photographs(tmp_path / "photos"))
    assert found.images[1].point3d_ids.tolist() == [NO_POINT]


def test_a_name_that_could_mean_two_is_refused(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "m", model(("b.png",)))
    photos = [*photographs(tmp_path / "photos"), *photographs(tmp_path / "photos", ["b.tif"])]
    with pytest.raises(InputError, match="Several photographs"):
        read_orientations(tmp_path / "m", photos)
    # The name itself decides where it can.
    write_colmap_text(tmp_path / "m", model(("b.jpg",)))
    assert read_orientations(tmp_path / "m", photos).images[1].name == "b.jpg"


def test_one_photograph_oriented_twice_is_refused(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "m", model(("b.jpg", "b.png")))
    with pytest.raises(InputError, match="twice"):
        read_orientations(tmp_path / "m", photographs(tmp_path / "photos"))


def test_none_that_match_is_refused_with_both_sides_named(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "m", model(("x.jpg",)))
    with pytest.raises(InputError, match="None of the photographs") as caught:
        read_orientations(tmp_path / "m", photographs(tmp_path / "photos"))
    assert "x.jpg" in str(caught.value)
    assert "A.JPG" in str(caught.value)


def test_photographs_at_twice_the_size_get_cameras_at_twice_the_size(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "m", model())
    photos = photographs(tmp_path / "photos", NAMES[:2])
    photos += photographs(tmp_path / "photos", NAMES[2:], size=(128, 96))
    found = read_orientations(tmp_path / "m", photos)
    small, large = found.photo_cameras()["b"], found.photo_cameras()["c"]
    assert (large.width, large.height) == (128, 96)
    point = np.array([[0.4, -0.3, 0.0]])
    shifted = point - np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(large.project(shifted)[0], 2 * small.project(point)[0])
    np.testing.assert_allclose(found.images[3].points2d, [[4.0, 8.0]])
    assert found.images[1].camera_id == found.images[2].camera_id != found.images[3].camera_id


def test_another_shape_is_refused(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "m", model())
    with pytest.raises(InputError, match="not of the shape"):
        read_orientations(tmp_path / "m", photographs(tmp_path / "photos", size=(48, 64)))


def test_what_is_no_orientation_is_refused(tmp_path: Path) -> None:
    photos = photographs(tmp_path / "photos")
    with pytest.raises(InputError, match="no orientation in this folder"):
        read_orientations(tmp_path / "photos", photos)
    with pytest.raises(InputError, match="no such file"):
        read_orientations(tmp_path / "absent", photos)
    with pytest.raises(InputError, match="no orientation that can be read"):
        read_orientations(photos[0], photos)
    for name in ("a.xml", "b.xml"):
        (tmp_path / name).write_text("<a/>")
    with pytest.raises(InputError, match="more than one"):
        read_orientations(tmp_path, photos)


def test_the_given_cameras_of_the_skull_are_read(shared_data) -> None:
    photos = sorted(shared_data("skull-flash", "photos").glob("*.jpg"))
    found = read_orientations(shared_data("skull-flash", "cameras"), photos)
    assert len(found.images) == 66
    assert len(found.points) == 14849
