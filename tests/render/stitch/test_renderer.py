from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.render.stitch.stitch_cases import labelled, middles, pinhole, plain, turned_by, wall
from workbench.errors import InputError
from workbench.geometry.labelled_mesh import LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rigid
from workbench.render.stitch.alternatives import blended, overwritten, photo_depth, z_buffered
from workbench.render.stitch.renderer import RenderSettings, colored_view, stitched_view
from workbench.render.stitch.scene import StitchScene
from workbench.verification.image_quality import color_steps, psnr

PHOTOS = 6
RADIUS = 0.5


def around(degrees, width=160, height=160) -> PhotoCamera:
    """Looks at the origin from a distance of 2, turned about the vertical."""
    params = (260.0, width / 2, height / 2, -0.03)
    pose = rigid(turned_by(degrees), [0.0, 0.0, 2.0])
    return PhotoCamera("SIMPLE_RADIAL", width, height, params, pose)


def paint(places):
    """Smooth colours of a ball's surface, (n, 3) in [0, 1]."""
    waves = np.sin(places @ np.array([[14.0, 3, 5], [4, 17, 9], [8, 6, 19]]) + [0, 1, 2])
    return 0.5 + 0.25 * waves


def taken(camera, gain=0.0):
    """The ball as a photograph shows it, and where it is."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    ways = camera.directions(np.column_stack([columns.ravel(), rows.ravel()]) + 0.5)
    along = -(ways @ camera.center)
    root = along**2 - (camera.center @ camera.center - RADIUS**2)
    hit = root > 0
    places = camera.center + ways * (along - np.sqrt(np.where(hit, root, 0)))[:, None]
    picture = np.zeros((camera.height * camera.width, 4), np.uint8)
    picture[hit, :3] = np.round(255 * np.clip(paint(places[hit]) + gain, 0, 1))
    picture[hit, 3] = 255
    return picture.reshape(camera.height, camera.width, 4), places.reshape(*rows.shape, 3)


def depth_mesh(camera, own, cameras) -> LabelledMesh:
    """A coarse grid of the ball as a photograph sees it, labelled with the most frontal."""
    small = PhotoCamera(camera.model, 40, 40, (65.0, 20.0, 20.0, -0.03), camera.camera_from_world)
    picture, places = taken(small)
    inside = picture[..., 3] > 0
    number = np.arange(1600).reshape(40, 40)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    triangles = np.concatenate(
        [np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)]
    )
    triangles = triangles[inside.ravel()[triangles].all(axis=1)].astype(np.int32)
    whole = TriangleMesh(places.reshape(-1, 3), triangles).keep_triangles(
        np.ones(len(triangles), bool)
    )
    middle = middles(whole)
    normals = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    cost = np.empty((len(cameras), len(middle)))
    for k, other in enumerate(cameras):
        way = other.center - middle
        cost[k] = 2.0 * (1.0 - (way * normals).sum(axis=1) / np.linalg.norm(way, axis=1))
    labels = cost.argmin(axis=0).astype(np.int32)
    return LabelledMesh(whole, labels, labels == own, cost.min(axis=0).astype(np.float32))


@pytest.fixture(scope="module")
def ball():
    """Scene, cameras and pictures; every photograph has its own brightness."""
    cameras = [around(360.0 * k / PHOTOS) for k in range(PHOTOS)]
    meshes = [depth_mesh(camera, k, cameras) for k, camera in enumerate(cameras)]
    gains = np.random.default_rng(2).normal(0, 0.04, PHOTOS)
    pictures = [taken(camera, gain)[0] for camera, gain in zip(cameras, gains, strict=True)]
    return StitchScene.of(meshes), cameras, pictures


def quality(color, truth, shown):
    mask = (truth[..., 3] > 0) & shown.seen
    assert mask.sum() > 0.95 * (truth[..., 3] > 0).sum()
    return psnr(color, truth[..., :3] / 255.0, mask)


def test_stitching_beats_overwriting_in_any_order(ball):
    """Photographs of one brightness, views half-way between them, on average over the orders."""
    scene, cameras, _ = ball
    pictures = [taken(camera)[0] for camera in cameras]
    for degrees in (30.0, 90.0, 150.0):
        camera = around(degrees)
        truth, _ = taken(camera)
        view = stitched_view(scene, camera, cameras, pictures.__getitem__)
        others = []
        for k in range(PHOTOS):
            shown = overwritten(scene, camera, range(PHOTOS), np.roll(range(PHOTOS), k))
            bare = colored_view(scene, shown, cameras, pictures.__getitem__).textured
            others.append(quality(bare.color, truth, shown))
        assert quality(view.textured.color, truth, view.shown) > np.mean(others) + 1.0
        # Nothing was to be levelled, and little is.
        assert quality(view.color, truth, view.shown) > 40.0


def test_levelling_takes_half_of_the_steps_between_photographs(ball):
    scene, cameras, pictures = ball
    view = stitched_view(scene, around(150.0), cameras, pictures.__getitem__)
    before, after = (
        color_steps(color, view.textured.label, view.shown.depth, scene.epsilon)
        for color in (view.textured.color, view.color)
    )
    assert before.pairs > 100
    assert after.across <= 0.5 * before.across
    assert after.within < 1.1 * before.within
    assert set(view.seconds) == {"visibility", "stitching", "images", "texturing", "levelling"}


def test_at_a_photographs_pose_its_own_picture_comes_back():
    """Through the lens there and back, without levelling: its foreground to a rounding."""
    cameras = [around(360.0 * k / PHOTOS) for k in range(PHOTOS)]
    scene = StitchScene.of([depth_mesh(cameras[2], 2, cameras)])
    picture = taken(cameras[2])[0]
    view = stitched_view(scene, cameras[2], cameras, lambda _: picture)
    own = view.textured.label == 2
    assert own.sum() > 3000
    assert np.abs(view.textured.color[own] * 255 - picture[own][:, :3]).max() < 0.51


def test_a_view_is_the_same_to_the_last_bit(ball):
    scene, cameras, pictures = ball
    one, other = (stitched_view(scene, around(30.0), cameras, pictures.__getitem__) for _ in "12")
    assert one.color.tobytes() == other.color.tobytes()
    assert one.shown.triangle.tobytes() == other.shown.triangle.tobytes()


def test_pictures_that_do_not_fit_are_told_and_never_asked_for(ball):
    scene, cameras, pictures = ball
    asked = []

    def load(label):
        asked.append(label)
        return pictures[label]

    settings = RenderSettings(budget_bytes=pictures[0].nbytes)
    view = stitched_view(scene, around(30.0), cameras, load, settings)
    assert asked == list(view.plan.load)
    assert len(asked) == 1
    assert 0.3 < view.plan.share_left_out < 0.7
    assert np.isin(view.textured.label, [-1, asked[0]]).all()


def test_sequences_flicker_less(ball):
    """Two views from one place, the second under another label's brightness."""
    scene, cameras, pictures = ball
    first = stitched_view(scene, around(30.0), cameras, pictures.__getitem__)
    brighter = [
        np.where([True, True, True, False], p // 10 * 11, p).astype(np.uint8) for p in pictures
    ]
    alone = stitched_view(scene, around(30.0), cameras, brighter.__getitem__)
    after = stitched_view(scene, around(30.0), cameras, brighter.__getitem__, before=first.frame)
    seen = first.shown.seen
    mixed = 0.4 * alone.levelling.change + 0.6 * first.levelling.change
    assert np.abs(after.levelling.change - mixed)[seen].max() < 1e-4


def test_the_z_buffer_shows_the_front_and_overwriting_the_order():
    near, far = labelled(wall(2.0), 0, False, 0.1), labelled(wall(2.03), 1, True, 1.0)
    scene = StitchScene.of([near, far], 0.05)
    camera = pinhole()
    assert (z_buffered(scene, camera).mesh == 0).all()
    for order in ([0, 1], [1, 0]):
        shown = overwritten(scene, camera, [5, 6], order)
        assert (shown.mesh == order[0]).all()
        assert (shown.label == 5 + order[0]).all()
    beyond = replace(scene, epsilon=0.01)
    assert (overwritten(beyond, camera, [5, 6], [1, 0]).mesh == 0).all()
    with pytest.raises(InputError, match="rank"):
        overwritten(scene, camera, [5, 6], [1, 1])


def test_blending_weighs_by_cosine_and_distance_and_sees_no_hidden_photograph():
    """A wall photographed squarely and from beside; a third camera stands behind a screen."""
    cameras = [
        pinhole(200, 200, 100.0),
        pinhole(200, 200, 100.0, (2.0, 0, 0.5), turned_by(-50)),
        pinhole(200, 200, 100.0, (0.0, 0, -1.0)),
    ]
    screen = labelled(wall(-0.5, 1.0))
    scene = StitchScene.of([labelled(wall(2.0, 1.0)), screen], 0.1)
    pictures = [plain(cameras[0], 200), plain(cameras[1], 100), plain(cameras[2], 0)]
    shown = z_buffered(scene, pinhole())
    depths = [photo_depth(scene, camera) for camera in cameras]
    out = blended(shown, scene, cameras, pictures.__getitem__, [0, 1, 2], depths.__getitem__)
    at = np.argwhere(shown.seen)
    for row, column in at[:: len(at) // 20]:
        place = shown.position[row, column]
        total, weights = 0.0, 0.0
        for camera, value in zip(cameras[:2], (200, 100), strict=True):
            pixel = camera.project(place[None])[0][0]
            if not ((pixel > 0) & (pixel < 200)).all():
                continue
            way = camera.center - place
            weight = -way[2] / np.linalg.norm(way) ** 3
            total, weights = total + weight * value, weights + weight
        assert out[row, column, 0] == pytest.approx(total / weights / 255, abs=1e-5)
    assert len(np.unique(out[shown.seen].round(3))) > 10
