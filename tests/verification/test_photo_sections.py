"""The contact sheet and the truth beside it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from workbench.verification.photo_sections import (
    MOST_SHOWN,
    PhotoTruth,
    evenly_chosen,
    matted,
    photographs_section,
)
from workbench.verification.report_content import Paragraph, PictureRow


@pytest.fixture
def photographs(tmp_path: Path) -> list[Path]:
    paths = []
    for number, size in enumerate([(90, 60), (60, 90), (60, 90)]):
        path = tmp_path / f"p{number}.jpg"
        Image.new("RGB", size, (40 * number, 120, 60)).save(path)
        paths.append(path)
    return paths


def test_pictures_of_all_shapes_share_one_mat() -> None:
    level, upright = np.full((40, 60, 3), 200, np.uint8), np.full((60, 30, 3), 90, np.uint8)
    for mat, picture in zip(matted([level, upright]), (level, upright), strict=True):
        assert mat.shape == (60, 60, 3)
        assert (mat == picture[0, 0]).all(axis=2).sum() == picture.shape[0] * picture.shape[1]
    (alone,) = matted([level])
    np.testing.assert_array_equal(alone, level)


def test_choice_spans_all() -> None:
    paths = [Path(str(k)) for k in range(100)]
    chosen = evenly_chosen(paths, 5)
    assert [path.name for path in chosen] == ["0", "25", "50", "74", "99"]
    assert evenly_chosen(paths[:3], 5) == paths[:3]


def test_a_sheet_shows_all_and_says_that_nobody_used_them(photographs: list[Path]) -> None:
    section, warnings = photographs_section(photographs, ())
    sheet, said = section.blocks
    assert isinstance(sheet, PictureRow)
    assert isinstance(said, Paragraph)
    assert [picture.caption for picture in sheet.pictures] == ["p0", "p1", "p2"]
    assert "All 3 photographs" in sheet.caption
    assert "No stage used them" in said.text
    assert not warnings
    used, _ = photographs_section(photographs, ("color",))
    assert len(used.blocks) == 1


def test_of_many_some_are_shown(photographs: list[Path]) -> None:
    section, _ = photographs_section(photographs * 400, ("color",))
    (sheet,) = section.blocks
    assert isinstance(sheet, PictureRow)
    assert f"{MOST_SHOWN} of 1\u202f200 photographs" in sheet.caption


def test_what_cannot_be_read_is_said_and_the_rest_shown(photographs: list[Path]) -> None:
    photographs[1].write_bytes(b"no picture")
    section, warnings = photographs_section(photographs, ("color",))
    (sheet,) = section.blocks
    assert isinstance(sheet, PictureRow)
    assert [picture.caption for picture in sheet.pictures] == ["p0", "p2"]
    assert len(warnings) == 1
    assert "p1.jpg cannot be read" in warnings[0]


def test_truth_is_shown_in_its_colours(photographs: list[Path], tmp_path: Path) -> None:
    """Albedo is encoded for the eye; where masks overlap, the shadow is on top."""
    albedo = np.zeros((60, 90, 3), np.uint16)
    albedo[..., 2] = round(0.2140 * 65535)  # sRGB code 127 or 128, red last as OpenCV writes
    cv2.imwrite(str(tmp_path / "albedo.png"), albedo)
    masks = {}
    for name, columns in (("object", 30), ("support", 20), ("shadow", 10)):
        mask = np.zeros((60, 90), np.uint8)
        mask[:, :columns] = 255
        masks[name] = tmp_path / f"{name}.png"
        cv2.imwrite(str(masks[name]), mask)
    truth = PhotoTruth(photographs[0], tmp_path / "albedo.png", *masks.values())
    section, _ = photographs_section(photographs, ("color",), [truth])
    row = section.blocks[-1]
    assert isinstance(row, PictureRow)
    shot, paint, masked = (picture.pixels for picture in row.pictures)
    assert shot.shape == paint.shape == masked.shape == (60, 90, 3)
    np.testing.assert_allclose(paint[30, 45], [127.5, 0, 0], atol=1)
    colors = {entry.label: entry.color for entry in row.legend}
    shown = [tuple(masked[30, column]) for column in (5, 15, 25, 60)]
    names = ("in the flash’s shadow", "support", "object", "table, or nothing")
    assert shown == [colors[name] for name in names]
