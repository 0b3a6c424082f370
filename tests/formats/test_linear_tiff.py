from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from workbench.errors import InputError
from workbench.formats.icc_profile import linear_rgb_profile, srgb_profile
from workbench.formats.linear_tiff import LinearPicture, read_linear_tiff, write_linear_tiff

PROFILE = linear_rgb_profile(srgb_profile().xyz_d50_from_rgb, "Linear")


def _picture(scale: float = 2.5) -> LinearPicture:
    rng = np.random.default_rng(0)
    values = rng.uniform(0, scale, (130, 70, 3)).astype(np.float32)
    return LinearPicture(values, "rec709", scale, PROFILE)


def test_what_is_written_is_read_to_half_a_step(tmp_path: Path) -> None:
    picture = _picture()
    write_linear_tiff(tmp_path / "a.tif", picture)
    read = read_linear_tiff(tmp_path / "a.tif")
    assert np.abs(read.values - picture.values).max() <= 0.51 * 2.5 / 65535
    assert (read.space, read.scale, read.profile) == ("rec709", 2.5, PROFILE)
    other = cv2.imread(str(tmp_path / "a.tif"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_allclose(other * (2.5 / 65535), read.values, rtol=1e-6)


def test_same_picture_same_bytes_and_no_time_in_them(tmp_path: Path) -> None:
    for name in ("a.tif", "b.tif"):
        write_linear_tiff(tmp_path / name, _picture())
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_beyond_the_range_is_clipped_not_wrapped_and_counted(tmp_path: Path) -> None:
    values = np.full((10, 10, 3), 0.5, np.float32)
    values[0, 0] = [-0.2, 1.5, 0.5]
    values[0, 1] = [-0.001, 1.001, 0.5]
    picture = LinearPicture(values, "rec709", 1.0, PROFILE)
    assert picture.share_beyond == pytest.approx(2 / 300), "noise about black is no clipping"
    write_linear_tiff(tmp_path / "a.tif", picture)
    read = read_linear_tiff(tmp_path / "a.tif").values
    np.testing.assert_allclose(read[0, 0], [0, 1, 0.5], atol=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5])
def test_damage_is_told(tmp_path: Path, share: float) -> None:
    path = tmp_path / "a.tif"
    write_linear_tiff(path, _picture())
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="cannot be read") as error:
        read_linear_tiff(path)
    assert error.value.file == str(path)


def test_a_tiff_that_does_not_say_what_it_means_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4, 3), np.uint16), photometric="rgb")
    with pytest.raises(InputError, match="cannot be read"):
        read_linear_tiff(tmp_path / "a.tif")
