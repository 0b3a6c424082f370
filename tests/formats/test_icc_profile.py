"""Profiles are understood by LittleCMS, and its profiles by us."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from PIL import Image, ImageCms

from workbench.formats.icc_profile import (
    linear_rgb_profile,
    read_matrix_profile,
    srgb_profile,
)

MATRIX = srgb_profile().xyz_d50_from_rgb


def _opened(profile: bytes) -> ImageCms.ImageCmsProfile:
    return ImageCms.ImageCmsProfile(io.BytesIO(profile))


def test_littlecms_shows_linear_light_as_it_is() -> None:
    linear = np.array([[[55, 5, 128], [0, 0, 0], [255, 255, 255], [200, 30, 60]]], np.uint8)
    shown = ImageCms.profileToProfile(
        Image.fromarray(linear),
        _opened(linear_rgb_profile(MATRIX, "Linear")),
        ImageCms.createProfile("sRGB"),
    )
    light = linear / 255.0
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert np.abs(np.asarray(shown) - 255 * encoded).max() <= 1.5


def test_name_and_primaries_are_told_and_bytes_repeat() -> None:
    profile = linear_rgb_profile(MATRIX, "Linear Rec. 709")
    assert profile == linear_rgb_profile(MATRIX, "Linear Rec. 709")
    assert len(profile) == struct.unpack(">I", profile[:4])[0]
    opened = _opened(profile)
    assert ImageCms.getProfileDescription(opened).strip() == "Linear Rec. 709"
    np.testing.assert_allclose(opened.profile.red_colorant[0], MATRIX[:, 0], atol=2e-5)
    read = read_matrix_profile(profile)
    assert read is not None
    np.testing.assert_allclose(read.xyz_d50_from_rgb, MATRIX, atol=2e-5)


def _with_curve(curve: bytes) -> bytes:
    """A profile all of whose three curves are ``curve``."""
    profile = linear_rgb_profile(MATRIX, "x")
    table = bytearray(profile)
    (count,) = struct.unpack_from(">I", profile, 128)
    for k in range(count):
        if profile[132 + 12 * k : 136 + 12 * k].endswith(b"TRC"):
            struct.pack_into(">II", table, 136 + 12 * k, len(profile), len(curve))
    return bytes(table) + curve


def _parametric(kind: int, *numbers: float) -> bytes:
    fixed = [round(number * 65536) for number in numbers]
    return struct.pack(f">4sIHH{len(fixed)}i", b"para", 0, kind, 0, *fixed)


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        (struct.pack(">4sIIH", b"curv", 0, 1, round(2.2 * 256)), lambda x: x ** (563 / 256)),
        (struct.pack(">4sII3H", b"curv", 0, 3, 0, 16384, 65535), None),
        (_parametric(0, 1.8), lambda x: x**1.8),
        (_parametric(1, 2.0, 1.25, -0.25), lambda x: np.maximum(1.25 * x - 0.25, 0) ** 2),
        (
            _parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045),
            lambda x: np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4),
        ),
    ],
)
def test_every_kind_of_curve(curve: bytes, expected) -> None:
    read = read_matrix_profile(_with_curve(curve))
    assert read is not None
    x = np.linspace(0, 1, 65536)
    target = np.interp(x, [0, 0.5, 1], [0, 16384 / 65535, 1]) if expected is None else expected(x)
    np.testing.assert_allclose(read.curves[1], target, atol=2e-4)


def test_what_is_no_such_profile_is_none() -> None:
    lab = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    profile = linear_rgb_profile(MATRIX, "x")
    for other in (b"", b"text" * 100, lab, profile[:150], profile[:300]):
        assert read_matrix_profile(other) is None


def test_eight_bits_are_every_257th_of_sixteen() -> None:
    profile = srgb_profile()
    eight = np.arange(256, dtype=np.uint8).reshape(16, 16)
    picture = np.repeat(eight[..., None], 3, axis=2)
    sixteen = picture.astype(np.uint16) * 257
    np.testing.assert_array_equal(profile.linear(picture), profile.linear(sixteen))
