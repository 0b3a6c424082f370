"""Light on the sensor, from files whose numbers are known."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

from tests.photos.conftest import BLACK, WHITE
from workbench.errors import InputError
from workbench.formats.icc_profile import linear_rgb_profile, srgb_profile
from workbench.formats.photo_preview import read_preview
from workbench.formats.photo_reading import read_photo
from workbench.photos.decoding import read_linear


def _light(mosaic):
    return (mosaic.astype(float) - BLACK) / (WHITE - BLACK)


def _half(mosaic):
    """What 2 × 2 photosites of RGGB say, greens averaged."""
    light = _light(mosaic)
    green = 0.5 * (light[0::2, 1::2] + light[1::2, 0::2])
    return np.stack([light[0::2, 0::2], green, light[1::2, 1::2]], axis=-1)


def test_half_size_is_the_photosites_own_light(dng, gradient) -> None:
    photo = read_linear(dng(gradient), half_size=True)
    np.testing.assert_allclose(photo.values, _half(gradient), atol=1.5 / 65535)
    assert (photo.usable == 255).all()
    assert (photo.black_level, photo.white_level) == (BLACK, WHITE)


@pytest.mark.parametrize("demosaic", ["ahd", "dht", "vng", "linear"])
def test_full_size_keeps_every_photosite(dng, gradient, demosaic) -> None:
    values = read_linear(dng(gradient), demosaic).values
    assert values.shape == (48, 64, 3)
    inner = (slice(4, -4, 2), slice(4, -4, 2))
    np.testing.assert_allclose(values[..., 0][inner], _light(gradient)[inner], atol=2e-3)


def test_brightness_does_not_depend_on_the_brightest_pixel(dng, gradient) -> None:
    """LibRaw stretches each photograph to its own maximum where it is not told otherwise."""
    dark = read_linear(dng(gradient), half_size=True).values
    spotted = gradient.copy()
    spotted[40:44, 50:54] = WHITE - 30
    other = read_linear(dng(spotted, "spotted"), half_size=True).values
    np.testing.assert_array_equal(dark[:18], other[:18])
    assert other.max() > 0.99


def test_the_white_balance_is_told_and_not_applied(dng, gradient) -> None:
    one = read_linear(dng(gradient))
    other = read_linear(dng(gradient, "other", as_shot_neutral=(1.0, 0.6, 0.9)))
    np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_allclose(one.white_balance, [2.0, 1.0, 1.25], rtol=1e-4)
    np.testing.assert_allclose(other.white_balance, [0.6, 1.0, 0.6 / 0.9], rtol=1e-4)
    assert one.camera_from_xyz is not None


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("half", [False, True])
def test_pictures_and_masks_stand_upright_together(dng, gradient, orientation, half) -> None:
    turns = {1: 0, 3: 2, 6: 3, 8: 1}[orientation]
    mosaic = gradient.copy()
    mosaic[8:10, 20:22] = WHITE
    lying = read_linear(dng(mosaic), "linear", half_size=half)
    upright = read_linear(dng(mosaic, "turned", orientation), "linear", half_size=half)
    np.testing.assert_allclose(upright.values, np.rot90(lying.values, turns), atol=1e-6)
    np.testing.assert_array_equal(upright.usable, np.rot90(lying.usable, turns))
    assert (upright.usable == 0).any()


def test_a_full_photosite_marks_all_it_went_into_and_no_more(dng, gradient) -> None:
    mosaic = gradient.copy()
    mosaic[20, 30] = WHITE
    for demosaic, reach in (("linear", 1), ("ahd", 3), ("dht", 3)):
        photo = read_linear(dng(mosaic), demosaic)
        before = read_linear(dng(gradient, "before"), demosaic)
        changed = np.abs(photo.values - before.values).max(axis=2) > 1e-4
        # What the photosite changed is marked. AHD also chooses directions further off.
        near = np.zeros_like(changed)
        near[20 - reach : 21 + reach, 30 - reach : 31 + reach] = True
        assert not (changed & near & (photo.usable == 255)).any()
        assert (photo.usable == 0).sum() == (2 * reach + 1) ** 2
    half = read_linear(dng(mosaic), half_size=True)
    assert np.argwhere(half.usable == 0).tolist() == [[10, 15]]


def test_below_the_white_level_nothing_is_marked(dng, gradient) -> None:
    mosaic = gradient.copy()
    mosaic[20, 30] = WHITE - 0.01 * (WHITE - BLACK)
    assert (read_linear(dng(mosaic)).usable == 255).all()


def test_a_sensor_that_is_full_below_its_white_level_is_found_out(dng) -> None:
    """By the heap of one number at the top, which no scene makes by itself."""
    rng = np.random.default_rng(9)
    scene = rng.normal(8000, 1000, (120, 160)).clip(BLACK, 0.98 * WHITE)
    full = 9800
    mosaic = np.minimum(scene, full).astype(np.uint16)
    photo = read_linear(dng(mosaic), half_size=True)
    near = mosaic >= full - 0.002 * (full - BLACK)
    blocks = near.reshape(60, 2, 80, 2).any(axis=(1, 3))
    np.testing.assert_array_equal(photo.usable == 0, blocks)
    assert (read_linear(dng(scene, "free"), half_size=True).usable == 255).all()


def _picture(shape=(40, 60)) -> np.ndarray:
    rng = np.random.default_rng(2)
    return rng.integers(5, 250, (*shape, 3)).astype(np.uint8)


def test_pictures_are_linearised_from_srgb_and_say_so(tmp_path: Path) -> None:
    encoded = _picture()
    encoded[3, 4] = 255
    Image.fromarray(encoded).save(tmp_path / "a.png")
    photo = read_linear(tmp_path / "a.png")
    level = encoded / 255.0
    light = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(photo.values, light, atol=1e-4)
    assert "no profile" in (photo.linearised_from or "")
    assert np.argwhere(photo.usable == 0).tolist() == [[3, 4]]


def test_pictures_are_linearised_from_their_own_profile(tmp_path: Path) -> None:
    encoded = _picture()
    matrix = srgb_profile().xyz_d50_from_rgb[:, [1, 2, 0]]
    profile = linear_rgb_profile(matrix, "Odd primaries")
    Image.fromarray(encoded).save(tmp_path / "a.tif", icc_profile=profile)
    photo = read_linear(tmp_path / "a.tif")
    np.testing.assert_allclose(photo.values, encoded / 255.0, atol=1e-5)
    np.testing.assert_allclose(photo.profile_matrix, matrix, atol=2e-5)
    assert photo.linearised_from == "Odd primaries"


def test_littlecms_agrees_on_what_a_profile_means(tmp_path: Path) -> None:
    encoded = _picture()
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(encoded).save(tmp_path / "a.jpg", icc_profile=profile, quality=100)
    photo = read_linear(tmp_path / "a.jpg")
    shown = np.asarray(Image.open(tmp_path / "a.jpg"))
    np.testing.assert_allclose(photo.values, srgb_profile().linear(shown), atol=1e-4)
    assert photo.linearised_from is not None
    assert "sRGB" in photo.linearised_from


def test_sixteen_bits_are_all_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    deep = rng.integers(0, 65535, (30, 20, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), deep[..., ::-1])
    tifffile.imwrite(tmp_path / "b.tif", deep, photometric="rgb")
    light = srgb_profile().linear(deep)
    assert len(np.unique(light)) > 1500
    for name in ("a.png", "b.tif"):
        np.testing.assert_array_equal(read_linear(tmp_path / name).values, light)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_stand_as_their_exif_says(tmp_path: Path, orientation: int) -> None:
    picture = Image.fromarray(_picture((24, 36)))
    exif = picture.getexif()
    exif[0x0112] = orientation
    picture.save(tmp_path / "a.png", exif=exif)
    from PIL import ImageOps

    with Image.open(tmp_path / "a.png") as opened:
        upright = np.asarray(ImageOps.exif_transpose(opened))
    photo = read_linear(tmp_path / "a.png")
    np.testing.assert_array_equal(photo.values, srgb_profile().linear(upright))


@pytest.mark.parametrize("share", [0.0, 0.0003, 0.01, 0.2, 0.6, 0.95, 0.999])
def test_a_cut_file_is_named_and_never_half_read(dng, share: float) -> None:
    rng = np.random.default_rng(1)
    path = dng(rng.integers(BLACK, WHITE, (300, 400)))
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError) as error:
        read_linear(path)
    assert error.value.file == str(path)
    assert error.value.fix


@pytest.mark.parametrize("suffix", [".dng", ".nef", ".cr2", ".jpg", ".png", ".tif", ".crw"])
def test_what_is_no_photograph_is_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"text{suffix}"
    path.write_text("not a photograph at all " * 50)
    with pytest.raises(InputError, match="cannot be read") as error:
        read_linear(path)
    assert error.value.file == str(path)
    with pytest.raises(InputError, match="no such"):
        read_linear(tmp_path / f"nowhere{suffix}")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_cut_picture_is_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    Image.fromarray(_picture((200, 200))).save(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cannot be read"):
        read_linear(path)


def test_a_camera_without_colour_gives_three_channels_alike(dng, gradient) -> None:
    path = dng(gradient)
    of_colors, of_none = (struct.pack("<HHIH", 262, 3, 1, k) for k in (32803, 34892))
    data = path.read_bytes()
    assert data.count(of_colors) == 1
    path.write_bytes(data.replace(of_colors, of_none))
    photo = read_linear(path)
    assert photo.white_balance is None
    assert photo.camera_from_xyz is None
    rows, cols = gradient.shape
    for pixels in (photo.values, read_photo(path), read_preview(path, max(rows, cols) // 2)):
        assert pixels.shape[2] == 3
        np.testing.assert_array_equal(pixels[..., 0], pixels[..., 1])
        np.testing.assert_array_equal(pixels[..., 0], pixels[..., 2])
    np.testing.assert_allclose(photo.values[..., 0], _light(gradient), atol=2e-4)
    assert read_photo(path).flags.writeable
