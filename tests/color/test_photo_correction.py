"""Photographs free of their flash, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from tests.color.blending_scene import FLASH, ball, camera_at, paint, photographed
from workbench.color.blending_surface import ReadySurface
from workbench.color.flash_light import FlashLight
from workbench.color.photo_correction import flash_free_picture
from workbench.formats.gltf import linear_from_srgb

GAIN = 0.8


@pytest.fixture(scope="module")
def seen():
    camera = camera_at(0.7, size=300)
    ready = ReadySurface(ball(6))
    view = ready.view(camera)
    rows, columns = np.nonzero(view.seen)
    ways = camera.directions(np.column_stack([columns, rows]) + 0.5)
    places = (
        camera.center
        + (view.depth[view.seen] / (ways @ camera.camera_from_world[2, :3]))[:, None] * ways
    )
    truth = np.full((300, 300, 3), np.nan)
    truth[view.seen] = paint(places)
    return camera, view, truth


def test_the_paint_is_left_when_the_flash_is_taken_out(seen):
    camera, view, truth = seen
    picture, mask = photographed(camera, gain=GAIN)
    found = flash_free_picture(view, picture, mask, "rec709", FLASH, GAIN, border_px=2)
    used = found[..., 3] == 255
    assert used.sum() > 0.8 * view.seen.sum()
    assert set(np.unique(found[..., 3])) == {0, 255}
    off = np.abs(linear_from_srgb(found[used][:, :3]) - truth[used])
    assert off.max() < 0.03
    assert np.median(off) < 0.004
    # As it was taken, the ball is darker towards its rim, whatever its gain.
    taken = flash_free_picture(view, picture, mask, "rec709", None, GAIN, border_px=2)
    assert np.abs(linear_from_srgb(taken[used][:, :3]) - truth[used]).max() > 0.1


def test_borders_are_not_used_and_bleed_outwards(seen):
    camera, view, _ = seen
    picture, mask = photographed(camera, gain=GAIN)
    mask = mask.copy()
    mask[:, 150:] = False
    picture[~mask] = 7.0
    near = flash_free_picture(view, picture, mask, "rec709", FLASH, GAIN, border_px=0)
    far = flash_free_picture(view, picture, mask, "rec709", FLASH, GAIN, border_px=3)
    middle = 150
    assert near[middle, 149, 3] == 255
    assert near[middle, 150, 3] == 0
    assert far[middle, 146, 3] == 255
    assert not far[middle, 147:, 3].any()
    # What is not used carries the colour of the used pixel next to it, not the clutter's.
    assert np.array_equal(near[middle, 152, :3], near[middle, 149, :3])
    bright = FlashLight(np.zeros(3), reference_distance=1.0)
    nothing = flash_free_picture(
        view, picture, np.zeros_like(mask), "rec709", bright, GAIN, border_px=3
    )
    assert not nothing.any()
