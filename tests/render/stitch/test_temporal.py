from __future__ import annotations

import numpy as np
import pytest

from tests.render.stitch.stitch_cases import labelled, pinhole, wall
from workbench.errors import InputError
from workbench.render.stitch.alternatives import z_buffered
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.temporal import LevelledFrame, smoothed


def two_walls():
    """A small one before a large one."""
    near = wall(1.5, 0.3)
    return StitchScene.of([labelled(near, 0), labelled(wall(2.0, 2.0), 1)], 0.05)


def test_a_still_camera_averages_with_the_weights_of_the_paper():
    shown = z_buffered(two_walls(), pinhole())
    rng = np.random.default_rng(0)
    new, old = rng.random((2, 90, 120, 3)).astype(np.float32)
    out = smoothed(new, shown, LevelledFrame(shown, old))
    assert np.abs(out - (0.4 * new + 0.6 * old)).max() < 1e-5


def test_a_constant_error_fades_by_the_weight_each_frame():
    shown = z_buffered(two_walls(), pinhole())
    target = np.zeros((90, 120, 3), np.float32)
    change = np.ones_like(target)
    for _ in range(5):
        change = smoothed(target, shown, LevelledFrame(shown, change))
    assert np.abs(change - 0.6**5).max() < 1e-5


def test_places_are_followed_and_what_is_new_keeps_its_value():
    """The old texture is a function of the place; the camera moves to the right by 0.2."""
    scene = two_walls()
    before, now = z_buffered(scene, pinhole()), z_buffered(scene, pinhole(center=(0.2, 0, 0)))
    old = (0.1 * before.position).astype(np.float32)
    new = np.full_like(old, 7.0)
    out = smoothed(new, now, LevelledFrame(before, old))
    pixels, _ = pinhole().project(now.position.reshape(-1, 3))
    x, y = pixels.reshape(90, 120, 2).transpose(2, 0, 1)
    outside = (x < 0) | (x > 120) | (y < 0) | (y > 90)
    # The small wall hid these: x of the ray through the near wall's plane.
    behind = now.mesh == 1
    hidden = behind & (np.abs(now.position[..., 0] * 0.75) < 0.28)
    hidden &= np.abs(now.position[..., 1] * 0.75) < 0.28
    assert hidden.sum() > 50
    assert outside.sum() > 500
    assert (out[outside | hidden] == 7.0).all()
    kept = (x > 1) & (x < 119) & (y > 1) & (y < 89)
    kept &= ~((np.abs(now.position[..., 0]) < 0.45) & behind)
    kept &= ~((np.abs(np.abs(now.position[..., 0]) - 0.3) < 0.03) & ~behind)
    kept &= ~((np.abs(np.abs(now.position[..., 1]) - 0.3) < 0.03) & ~behind)
    expected = 0.4 * 7.0 + 0.6 * 0.1 * now.position
    assert kept.sum() > 3000
    assert np.abs(out - expected)[kept].max() < 1e-3


def test_shares_are_checked():
    shown = z_buffered(two_walls(), pinhole())
    change = np.zeros((90, 120, 3), np.float32)
    with pytest.raises(InputError, match="shares"):
        smoothed(change, shown, LevelledFrame(shown, change), 1.5)
