"""Pixels that contradict what other photographs say."""

from __future__ import annotations

import numpy as np
import pytest

from tests.color.blending_scene import FLASH, ball, camera_at, paint, photographed
from workbench.color.blending_surface import ReadySurface
from workbench.color.photo_correction import flash_free_picture
from workbench.color.photo_doubt import doubted_pixels
from workbench.formats.gltf import srgb_from_linear


@pytest.fixture(scope="module")
def scene():
    mesh, camera = ball(5), camera_at(0.4, size=300)
    ready = ReadySurface(mesh)
    picture, mask = photographed(camera, seed=3)
    free = flash_free_picture(ready.view(camera), picture, mask, "rec709", FLASH, 1.0, border_px=2)
    return ready, camera, free, srgb_from_linear(paint(mesh.vertices))


def doubted(scene, free, limit=0.2, known=None):
    ready, camera, _, colors = scene
    known = np.ones(len(colors), bool) if known is None else known
    return doubted_pixels(free, camera, ready.rays, colors, known, 4.0, limit)


def test_a_photograph_that_agrees_is_not_doubted(scene):
    free = scene[2]
    assert doubted(scene, free)[free[..., 3] > 0].mean() < 0.002
    # Nor is one that is darker as a whole.
    darker = free.copy()
    darker[..., :3] = (darker[..., :3] * 0.8).astype(np.uint8)
    assert doubted(scene, darker)[free[..., 3] > 0].mean() < 0.002


def test_a_highlight_and_a_bar_before_the_object_are(scene):
    free = scene[2].copy()
    free[140:160, 130:150, :3] = 250
    free[60:240, 175:185, :3] = 40
    found = doubted(scene, free)
    assert found[142:158, 132:148].all()
    assert found[90:210, 176:184].mean() > 0.98
    beside = found & (free[..., 3] > 0)
    beside[128:172, 118:162] = False
    beside[48:252, 163:197] = False
    assert beside.mean() < 0.002
    # What nobody else tells is not doubted, nor anything where nothing is known.
    assert not doubted(scene, free, known=np.zeros(len(scene[3]), bool)).any()
    assert not doubted(scene, free, limit=10.0).any()
    blank = free.copy()
    blank[..., 3] = 0
    assert not doubted(scene, blank).any()
