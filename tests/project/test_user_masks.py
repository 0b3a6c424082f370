"""Masks people draw: what they belong to, and every way to get that wrong."""

import numpy as np
import pytest
from PIL import Image

from workbench.errors import InputError
from workbench.project.mask_subjects import photos_by_name, scan_subjects
from workbench.project.user_masks import (
    Subject,
    mask_path,
    masks_by_subject,
    read_mask,
    write_mask,
)

SCAN = Subject("scan", "left", "left.ply", (30, 20))
CLOUD = Subject("scan", "cloud", "cloud.xyz", None)
PHOTO = Subject("photo", "DSC_1", "DSC_1.NEF", (60, 40))
TWIN_SCAN = Subject("scan", "front", "front.ptx", (30, 20))
TWIN_PHOTO = Subject("photo", "front", "front.jpg", (60, 40))
EVERY = (SCAN, CLOUD, PHOTO, TWIN_SCAN, TWIN_PHOTO)


def files(folder, *names):
    return [folder / name for name in names]


def test_masks_are_matched_by_name_and_twins_by_the_whole_file_name(tmp_path):
    given = files(tmp_path, "DSC_1.png", "front.jpg.png", "left.png", "front.ptx.png")
    found = masks_by_subject(given, EVERY)
    assert {subject: path.name for subject, path in found.items()} == {
        SCAN: "left.png",
        PHOTO: "DSC_1.png",
        TWIN_SCAN: "front.ptx.png",
        TWIN_PHOTO: "front.jpg.png",
    }
    assert list(found) == [SCAN, PHOTO, TWIN_SCAN, TWIN_PHOTO]


@pytest.mark.parametrize("subject", [SCAN, PHOTO, TWIN_SCAN, TWIN_PHOTO])
def test_the_path_a_mask_is_written_to_is_the_one_it_is_found_by(tmp_path, subject):
    path = mask_path(tmp_path, "corrected", subject, EVERY)
    assert path.parent == tmp_path / "masks" / "corrected"
    assert masks_by_subject([path], EVERY) == {subject: path}


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["lefd.png"], "did you mean 'left'"),
        (["front.png"], r"front\.ptx\.png or front\.jpg\.png"),
        (["cloud.png"], "no grid"),
        (["left.jpg"], "PNG"),
        (["left.png", "left.ply.png"], "Two masks"),
    ],
)
def test_a_mask_that_belongs_nowhere_is_an_error_that_names_it(tmp_path, names, told):
    with pytest.raises(InputError, match=told) as caught:
        masks_by_subject(files(tmp_path, *names), EVERY)
    assert caught.value.file == str(tmp_path / names[-1])


def test_a_mask_comes_back_as_it_was_and_has_the_same_bytes_each_time(tmp_path):
    mask = np.where(np.random.default_rng(3).random((40, 60)) > 0.5, 255, 0).astype(np.uint8)
    path = mask_path(tmp_path, "training", PHOTO, EVERY)
    write_mask(path, mask)
    first = path.read_bytes()
    write_mask(path, mask)
    assert path.read_bytes() == first
    assert np.array_equal(read_mask(path, PHOTO.size), mask)


@pytest.mark.parametrize("mode", ["1", "L", "RGB", "RGBA", "P", "I;16"])
def test_white_is_kept_whatever_kind_of_png_a_painting_program_writes(tmp_path, mode):
    grey = np.zeros((20, 30), np.uint8)
    grey[5:15, 8:20] = 255
    if mode == "I;16":
        picture = Image.fromarray(grey.astype(np.uint16) * 257)
    else:
        picture = Image.fromarray(grey).convert(mode)
    picture.save(tmp_path / "left.png")
    assert np.array_equal(read_mask(tmp_path / "left.png", (30, 20)), grey)


def test_a_mask_of_another_size_or_no_picture_is_an_error(tmp_path):
    write_mask(tmp_path / "left.png", np.zeros((30, 20), np.uint8))
    with pytest.raises(InputError, match="30 × 20") as caught:
        read_mask(tmp_path / "left.png", (30, 20))
    assert caught.value.found == "20 × 30 pixels"
    (tmp_path / "left.png").write_bytes(b"no picture at all")
    with pytest.raises(InputError, match="cannot be read"):
        read_mask(tmp_path / "left.png", (30, 20))


def test_two_photographs_of_one_name_are_refused(tmp_path):
    with pytest.raises(InputError, match="share a name"):
        photos_by_name(files(tmp_path, "a/DSC_1.NEF", "a/DSC_1.jpg"))


def test_a_scan_without_a_grid_can_have_no_mask_and_a_grid_is_as_wide_as_its_columns():
    entries = [
        {"name": "a", "file": "a.ptx", "grid": [20, 30]},
        {"name": "b", "file": "b.xyz", "grid": None},
    ]
    assert [s.size for s in scan_subjects({"scans": entries})] == [(30, 20), None]
