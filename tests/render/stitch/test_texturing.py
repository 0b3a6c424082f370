from __future__ import annotations

import numpy as np
import pytest

from tests.render.stitch.stitch_cases import labelled, pinhole, plain, turned_by, wall
from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.kernels.stitch_passes import between_texels
from workbench.render.stitch.alternatives import z_buffered
from workbench.render.stitch.image_management import picture_plan
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.texturing import textured


def ramp(camera):
    """Red runs with the column, green with the row, linear up to rounding."""
    picture = plain(camera, 0)
    picture[..., 0] = np.arange(camera.width)[None] * 2
    picture[..., 1] = np.arange(camera.height)[:, None] * 2
    return picture


def painted(mesh):
    """Vertex colours that are linear over the wall."""
    color = np.zeros((len(mesh.vertices), 3), np.uint8)
    color[:, 2] = 100 + 40 * mesh.vertices[:, 0]
    return mesh.with_attributes(color=color)


def test_colours_come_from_where_the_photograph_shows_the_place():
    photo = pinhole(110, 80, 120.0, (0.3, -0.1, 0.2), turned_by(8))
    scene = StitchScene.of([labelled(painted(wall(2.0, 1.0)))])
    shown = z_buffered(scene, pinhole(60, 44, 50.0))
    out = textured(shown, scene, [photo], lambda _: ramp(photo), [0])
    pixels, _ = photo.project(shown.position.reshape(-1, 3))
    expected = (pixels.reshape(44, 60, 2) - 0.5) * 2 / 255
    inner = ((pixels > 1) & (pixels < [109, 79])).all(axis=1).reshape(44, 60) & shown.seen
    assert inner.sum() > 500
    # Bilinear between whole numbers: exact but for float32.
    assert np.abs(out.color[inner][:, :2] - expected[inner]).max() < 1e-5
    assert (out.label[inner] == 0).all()


def test_vertex_colours_stand_in_for_pictures():
    """Outside the picture, where alpha is 0, and where the picture is not to be loaded."""
    photo = pinhole(60, 44, 100.0)
    picture = plain(photo, 250)
    picture[:, :30, 3] = 0
    scene = StitchScene.of([labelled(painted(wall(2.0, 1.0)))])
    shown = z_buffered(scene, pinhole(60, 44, 50.0))
    blue = (100 + 40 * shown.position[..., 0]) / 255
    out = textured(shown, scene, [photo], lambda _: picture, [0])
    pixels, _ = photo.project(shown.position.reshape(-1, 3))
    x, y = pixels.reshape(44, 60, 2).transpose(2, 0, 1)
    usable = (x > 30) & (x < 60) & (y > 0) & (y < 44)
    unsure = np.abs(x - 30) < 1e-3
    assert (out.label[usable & ~unsure] == 0).all()
    assert (out.color[usable & ~unsure] == np.float32(250 / 255)).all()
    rest = shown.seen & ~usable & ~unsure
    assert (out.label[rest] == NO_PHOTO).all()
    assert np.abs(out.color[rest][:, 2] - blue[rest]).max() < 1 / 255
    none = textured(shown, scene, [photo], _never, [])
    assert np.abs(none.color[shown.seen][:, 2] - blue[shown.seen]).max() < 1 / 255
    assert (none.label == NO_PHOTO).all()


def _never(label):
    raise AssertionError(f"picture {label} was asked for")


def test_texels_that_may_not_be_used_do_not_bleed():
    picture = np.zeros((2, 2, 4), np.uint8)
    picture[0, 0] = [200, 100, 50, 255]
    picture[1, 1] = [100, 100, 50, 255]
    colors, coverage = between_texels(
        picture, np.array([[1.0, 1.0], [0.75, 0.5], [2.1, 1], [np.nan, 1]])
    )
    assert np.allclose(colors[0] * 255, [150, 100, 50])
    assert np.allclose(colors[1] * 255, [200, 100, 50])
    assert np.allclose(coverage, [0.5, 0.75, 0, 0])


def test_pictures_are_loaded_by_relevance_within_the_budget():
    cameras = [pinhole(10, 10), pinhole(100, 10), pinhole(10, 10), pinhole(10, 10)]
    labels = np.array([[3, 3, 1, 1, 1], [0, 0, -1, 2, 2]], np.int32)
    plan = picture_plan(labels, cameras, 800)
    # The most relevant is too large; of equals the first goes before.
    assert plan.load == (0, 2)
    assert plan.left_out == (1, 3)
    assert plan.pixels == {0: 2, 1: 3, 2: 2, 3: 2}
    assert plan.share_left_out == pytest.approx(5 / 9)
    whole = picture_plan(labels, cameras, 10_000)
    assert whole.load == (1, 0, 2, 3)
    assert whole.share_left_out == 0.0
    assert picture_plan(np.full((2, 2), -1, np.int32), cameras, 0).load == ()
    with pytest.raises(InputError, match="not there"):
        picture_plan(labels, cameras[:3], 800)


def test_seams_compare_photographs_in_one_place():
    """Two halves of a wall: one photograph shows a ramp, the other the same and 20 more."""
    photo = pinhole(110, 80, 120.0)
    left, right = labelled(wall(2.0, 2.0, 8, (-1, 0)), 0), labelled(wall(2.0, 2.0, 8, (0, 1)), 1)
    scene = StitchScene.of([left, right])
    shown = z_buffered(scene, pinhole(60, 44, 50.0))
    brighter = ramp(photo)
    brighter[..., :3] += 20
    out = textured(shown, scene, [photo] * 2, [ramp(photo), brighter].__getitem__, [0, 1])
    columns = np.flatnonzero(np.isfinite(out.seam).any(axis=(0, 2)))
    assert columns.tolist() == [29, 30]
    rows = np.isfinite(out.seam[:, 29, 0])
    assert rows.sum() > 20
    # Half of the difference to either side; the ramp itself has no part in it.
    assert np.abs(out.seam[rows, 29] - 10 / 255).max() < 1e-5
    assert np.abs(out.seam[rows, 30] + 10 / 255).max() < 1e-5


def test_a_photograph_that_does_not_show_the_place_tells_no_seam():
    photo = pinhole(110, 80, 120.0)
    left, right = labelled(wall(2.0, 2.0, 8, (-1, 0)), 0), labelled(wall(2.0, 2.0, 8, (0, 1)), 1)
    scene = StitchScene.of([left, right])
    shown = z_buffered(scene, pinhole(60, 44, 50.0))
    half = ramp(photo)
    half[:, :55, 3] = 0
    out = textured(shown, scene, [photo] * 2, [ramp(photo), half].__getitem__, [0, 1])
    assert np.isnan(out.seam[:, 29]).all()
    assert np.isfinite(out.seam[10:30, 30]).all()
    alone = textured(shown, scene, [photo] * 2, [ramp(photo), half].__getitem__, [0])
    assert np.isnan(alone.seam[:, 29]).all()
