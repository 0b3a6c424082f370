"""Small upright pictures of photographs of every kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from workbench.errors import InputError
from workbench.formats.photo_preview import read_preview


def quarters(height: int, width: int) -> np.ndarray:
    """Red upper left, green upper right, blue lower left, black lower right."""
    picture = np.zeros((height, width, 3), np.uint8)
    picture[: height // 2, : width // 2, 0] = 255
    picture[: height // 2, width // 2 :, 1] = 255
    picture[height // 2 :, : width // 2, 2] = 255
    return picture


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_pictures_stand_upright(tmp_path: Path, orientation: int, turns: int) -> None:
    """``turns``: how often the camera was turned counter-clockwise by 90° when it was held."""
    upright = quarters(300, 200)
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "held.jpg"
    Image.fromarray(np.rot90(upright, turns)).save(path, quality=95, exif=exif)
    preview = read_preview(path, 150)
    assert preview.shape == (150, 100, 3)
    assert preview.dtype == np.uint8
    assert np.abs(preview.astype(int) - quarters(150, 100)).mean() < 6


def test_small_pictures_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "small.png"
    Image.fromarray(quarters(30, 20)).save(path)
    np.testing.assert_array_equal(read_preview(path, 150), quarters(30, 20))


@pytest.mark.parametrize("name", ["broken.jpg", "broken.dng", "broken.tif"])
@pytest.mark.parametrize("content", [b"", b"II*\x00nothing of the kind"])
def test_what_cannot_be_read_is_named(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_preview(path, 100)
    assert caught.value.file == str(path)


def test_raw_files_of_real_cameras(shared_data: Callable[..., Path]) -> None:
    files = [
        path
        for path in sorted(shared_data("raw").glob("*/*"))
        if path.suffix.lower() in (".crw", ".kdc", ".dng", ".nef", ".jpg")
    ]
    assert len(files) > 8
    for path in files:
        preview = read_preview(path, 240)
        assert max(preview.shape) == 240
        assert preview.std() > 5, path
