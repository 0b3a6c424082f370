"""Sharp shadows of a flash: where geometry is known to the pixel, else by what is seen."""

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rigid
from workbench.masking.flash_shadow import flash_shadows_by_geometry, flash_shadows_by_value


def square(z, low, high):
    """Two triangles at depth z, from (x, y) ``low`` to ``high``."""
    (a, b), (c, d) = low, high
    return np.array([[a, b, z], [c, b, z], [c, d, z], [a, d, z]], float)


def scene(offset):
    """A wall two metres off, and a plate half a metre before it."""
    vertices = np.vstack([square(2.0, (-3, -3), (3, 3)), square(1.5, (-0.1, -0.1), (0.1, 0.1))])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    return TriangleMesh(vertices + offset, triangles)


@pytest.mark.parametrize(
    "offset", [np.zeros(3), np.array([5e5, 5.2e6, 120.0])], ids=["near", "far"]
)
def test_the_shadow_lies_where_the_plate_takes_the_light(offset):
    camera = PhotoCamera("PINHOLE", 200, 160, (200.0, 200.0, 100.0, 80.0), rigid(
        np.eye(3), -offset))  # fmt: skip
    flash = np.array([0.3, 0.0, 0.0])
    shadow = flash_shadows_by_geometry(scene(offset), camera, flash + offset)
    # Through the plate's corners from the flash, the wall is met a third further on.
    low = flash[0] + (-0.1 - flash[0]) * 2.0 / 1.5
    high = flash[0] + (0.1 - flash[0]) * 2.0 / 1.5
    tall = 0.1 * 2.0 / 1.5
    y, x = (np.mgrid[:160, :200] + 0.5 - np.array([80, 100])[:, None, None]) / 200.0
    on_plate = (np.abs(1.5 * x) < 0.1) & (np.abs(1.5 * y) < 0.1)
    expected = (2 * x > low) & (2 * x < high) & (np.abs(2 * y) < tall) & ~on_plate
    assert (shadow != expected).mean() < 0.002
    assert shadow.sum() == pytest.approx(expected.sum(), rel=0.05)


def test_a_flash_at_the_lens_casts_no_shadow_that_the_camera_sees():
    camera = PhotoCamera("PINHOLE", 200, 160, (200.0, 200.0, 100.0, 80.0), np.eye(4))
    shadow = flash_shadows_by_geometry(scene(np.zeros(3)), camera, np.array([1e-6, 0, 0]))
    assert shadow.mean() < 0.005


def test_what_faces_away_from_the_flash_is_in_its_own_shadow():
    camera = PhotoCamera("PINHOLE", 200, 160, (200.0, 200.0, 100.0, 80.0), np.eye(4))
    behind = flash_shadows_by_geometry(scene(np.zeros(3)), camera, np.array([0.0, 0.0, 4.0]))
    assert behind.all()


def test_a_flash_nowhere_is_refused():
    camera = PhotoCamera("PINHOLE", 20, 16, (20.0, 20.0, 10.0, 8.0), np.eye(4))
    with pytest.raises(InputError, match="flash"):
        flash_shadows_by_geometry(scene(np.zeros(3)), camera, np.array([np.nan, 0, 0]))


def painted(side=400):
    """A lit, shaded, noisy object over the whole image and its mask."""
    y, x = np.mgrid[:side, :side] / side
    light = 0.35 + 0.25 * x + 0.1 * np.sin(9 * y)
    noise = np.random.default_rng(0).normal(0, 0.004, (side, side))
    return light, noise, np.full((side, side), 255, np.uint8)


def encoded(light, noise):
    value = np.clip(light + noise, 0, 1) ** (1 / 2.2)
    return np.asarray(255 * value[..., None] * np.array([1.0, 0.9, 0.8]), np.uint8)


def test_a_sharp_dark_stripe_is_a_shadow_and_a_soft_one_is_not():
    light, noise, mask = painted()
    stripe = np.zeros(light.shape, bool)
    stripe[100:300, 200:208] = True
    sharp = encoded(np.where(stripe, 0.03 * light, light), noise)
    found = flash_shadows_by_value(sharp, mask)
    assert (found & stripe).sum() > 0.9 * stripe.sum()
    assert (found & ~stripe).sum() < 0.1 * stripe.sum()
    x = np.arange(400)
    valley = 1 - 0.97 * np.exp(-0.5 * ((x - 200) / 60.0) ** 2)
    soft = encoded(light * valley, noise)
    assert flash_shadows_by_value(soft, mask).mean() < 0.001


def test_evenly_lit_surfaces_and_what_is_off_the_object_have_no_shadow():
    light, noise, mask = painted()
    assert not flash_shadows_by_value(encoded(light, noise), mask).any()
    dark = encoded(np.where(np.arange(400) < 150, 0.0, light), noise)
    mask[:, :150] = 0
    assert not flash_shadows_by_value(dark, mask)[:, :150].any()


def test_a_large_photograph_has_the_shadow_of_a_small_one():
    light, noise, mask = painted(500)
    stripe = np.zeros(light.shape, bool)
    stripe[120:380, 250:262] = True
    image = encoded(np.where(stripe, 0.03 * light, light), noise)
    small = flash_shadows_by_value(image, mask)
    large = flash_shadows_by_value(np.kron(image, np.ones((4, 4, 1), np.uint8)), np.kron(
        mask, np.ones((4, 4), np.uint8)))  # fmt: skip
    again = large[2::4, 2::4]
    assert small.sum() > 0.8 * stripe.sum()
    assert (small & again).sum() > 0.95 * (small | again).sum()
