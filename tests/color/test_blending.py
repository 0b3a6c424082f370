"""Blending photographs: the albedo they agree on, in any order, without seams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.color.blending_scene import (
    FLASH,
    RADIUS,
    ball,
    camera_at,
    colored,
    looked,
    paint,
    photographed,
    ring,
)
from workbench.color.blending import BlendSums, blended
from workbench.color.blending_colors import Colored, level_of, uncorrected
from workbench.color.blending_display import encoded_srgb
from workbench.color.blending_levels import gains_against, leveled_gains
from workbench.color.blending_observations import Observations
from workbench.color.blending_samples import blocks_of_mesh, vertex_spacing
from workbench.color.blending_seams import seam_steps
from workbench.color.blending_votes import median_levels
from workbench.color.blending_weights import feathered, sharpness
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh

NOISE = 0.01
MESH = ball(5)


@pytest.fixture(scope="module")
def photos():
    """Ten photographs of the ball with 1 % noise, as they look at the mesh."""
    return [
        looked(MESH, camera, *photographed(camera, seed=k)) for k, camera in enumerate(ring(10))
    ]


@pytest.fixture(scope="module")
def albedos(photos):
    return [colored(MESH, photo) for photo in photos]


def relative_errors(colors, which=None):
    truth = paint(MESH.vertices)
    which = np.isfinite(colors).all(axis=1) if which is None else which
    return (colors[which] / truth[which] - 1.0).ravel()


def test_the_albedo_comes_out_to_the_noise(albedos):
    result = blended(albedos, len(MESH.vertices))
    told = result.weights > 0.0
    assert told.mean() > 0.9
    assert (result.photos[told] >= 1).all()
    assert not result.photos[~told].any()
    assert np.isnan(result.colors[~told]).all()
    # Several pixels and photographs: less than the noise of one pixel.
    assert relative_errors(result.colors).std() < NOISE
    assert abs(np.median(relative_errors(result.colors))) < 0.2 * NOISE
    # What is left uncorrected is far worse: that is what the flash does.
    plain = blended([uncorrected(p, 1.0) for p in _seen(albedos)], len(MESH.vertices))
    assert relative_errors(plain.colors).std() > 10.0 * NOISE


def _seen(albedos):
    """The same samples with the light that the flash gave them."""
    places = [MESH.vertices[a.index] for a in albedos]
    for a, p, camera in zip(albedos, places, ring(10), strict=True):
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        light = FLASH.received(p @ turn.T + shift, (p / RADIUS) @ turn.T)
        values = (a.colors * light[:, None]).astype(np.float32)
        yield Observations(a.index, values, values, np.ones(len(p), np.float32))


def test_the_order_of_photographs_does_not_matter(albedos):
    first = blended(albedos, len(MESH.vertices))
    order = np.random.default_rng(0).permutation(len(albedos))
    other = blended([albedos[k] for k in order], len(MESH.vertices))
    told = first.weights > 0.0
    assert np.array_equal(told, other.weights > 0.0)
    assert np.abs(first.colors - other.colors)[told].max() < 1e-12
    assert np.array_equal(first.photos, other.photos)


def test_a_later_photograph_changes_what_it_sees_and_nothing_else(albedos):
    sums = BlendSums(len(MESH.vertices))
    for photo in albedos[:-1]:
        sums.add(photo)
    before = sums.mean_colors
    sums.add(albedos[-1])
    unseen = np.ones(len(before), bool)
    unseen[albedos[-1].index] = False
    assert np.array_equal(sums.mean_colors[unseen], before[unseen], equal_nan=True)
    whole = blended(albedos, len(MESH.vertices), robust="none")
    assert np.array_equal(sums.mean_colors, whole.colors, equal_nan=True)


def test_a_mean_by_hand():
    one = Colored(np.array([0, 2]), np.array([[1.0, 1, 1], [0.5, 0.5, 0.5]]), np.array([1.0, 2]))
    two = Colored(np.array([2]), np.array([[0.2, 0.8, 0.5]]), np.array([4.0]))
    result = blended([one, two], 4, robust="none")
    assert result.colors[[0, 2]] == pytest.approx(
        np.array([[1.0, 1.0, 1.0], [0.3, 0.7, 0.5]]), abs=1e-15
    )
    assert result.weights.tolist() == [1.0, 0.0, 6.0, 0.0]
    assert result.photos.tolist() == [1, 0, 2, 0]
    assert result.scatter[2] == pytest.approx(0.0, abs=1e-7)
    assert np.isnan(result.scatter[0])


def test_nothing_seen_is_no_colour():
    result = blended([], 3)
    assert np.isnan(result.colors).all()
    assert result.doubted == 0.0


@pytest.mark.parametrize(
    ("color", "weight"), [(np.nan, 1.0), (np.inf, 1.0), (0.5, np.nan), (0.5, -1.0)]
)
def test_what_cannot_be_blended_is_refused(color, weight):
    with pytest.raises(InputError, match="cannot be blended"):
        Colored(np.array([0]), np.full((1, 3), color), np.array([weight]))


def test_a_photograph_without_weight_adds_nothing():
    index = np.arange(4)
    none = Colored(index, np.full((4, 3), 0.9), np.zeros(4))
    some = Colored(index[:2], np.full((2, 3), 0.2), np.ones(2))
    found = blended([none, some], 4)
    np.testing.assert_allclose(found.colors[:2], 0.2, rtol=1e-12)
    assert np.isnan(found.colors[2:]).all()
    assert found.weights.tolist() == [1.0, 1.0, 0.0, 0.0]


def test_highlights_in_some_photographs_are_outvoted():
    rng = np.random.default_rng(1)
    coarse, spoilt = ball(4), []
    for camera in ring(24, size=120):
        photo = colored(coarse, looked(coarse, camera, *photographed(camera)))
        factor = np.where(rng.random(len(photo.index)) < 0.12, 2.5, 1.0)
        spoilt.append(replace(photo, colors=photo.colors * factor[:, None]))
    truth = level_of(paint(coarse.vertices))
    robust, mean = (blended(spoilt, len(truth), way) for way in ("median", "none"))
    enough = robust.photos >= 8
    assert enough.mean() > 0.5
    assert np.mean((level_of(mean.colors) - truth)[enough] > 0.05) > 0.4
    assert np.mean(np.abs(level_of(robust.colors) - truth)[enough] > 0.05) < 0.05
    assert 0.05 < robust.doubted < 0.5


def test_medians_are_those_of_a_sort_by_hand():
    rng = np.random.default_rng(7)
    photos = []
    for _ in range(9):
        index = np.flatnonzero(rng.random(200) < 0.6)
        colors = np.repeat(rng.uniform(0.1, 0.9, len(index))[:, None], 3, axis=1)
        photos.append(Colored(index, colors, rng.uniform(0.0, 1.0, len(index)) ** 2))
    counts = np.zeros(201, np.int64)
    for photo in photos:
        counts[photo.index] += 1
    found = median_levels(photos, counts)
    assert np.isnan(found[200])
    for k in range(200):
        said = [
            (level, weight**0.25)
            for photo in photos
            for i, level, weight in zip(photo.index, photo.levels, photo.weights, strict=True)
            if i == k
        ]
        said.sort()
        through = np.cumsum([vote for _, vote in said])
        expected = said[int(np.argmax(through >= 0.5 * through[-1]))][0]
        assert found[k] == expected
    # In pieces, as where there is more than memory holds: the same.
    assert np.array_equal(median_levels(photos, counts, at_once=50), found, equal_nan=True)


def test_masked_pixels_never_reach_a_sample():
    camera = camera_at(0.3)
    picture, mask = photographed(camera)
    usable = mask.copy()
    usable[:, :120] = False
    clean = looked(MESH, camera, picture, usable)
    for poison in (1e6, np.nan, np.inf):
        spoilt = picture.copy()
        spoilt[~usable] = poison
        found = looked(MESH, camera, spoilt, usable)
        assert np.array_equal(found.seen.index, clean.seen.index)
        assert np.array_equal(found.seen.values, clean.seen.values)
    pixels, _ = camera.project(MESH.vertices[clean.seen.index])
    assert pixels[:, 0].min() >= 119.5


def test_no_seam_where_a_photograph_ends(albedos):
    # Photographs of which every other is 10 % too bright: hard borders would show as steps.
    uneven = [
        replace(photo, colors=photo.colors * (1.1 if k % 2 else 1.0))
        for k, photo in enumerate(albedos)
    ]
    even = [replace(photo, weights=np.ones(len(photo.weights))) for photo in uneven]
    seams = {}
    for name, group in (("feathered", uneven), ("hard", even)):
        result = blended(group, len(MESH.vertices), robust="none")
        sets = np.zeros(len(MESH.vertices), np.uint64)
        for k, photo in enumerate(group):
            sets[photo.index] ^= np.uint64(1 << k)
        seams[name] = seam_steps(group, level_of(result.colors), sets, MESH.triangles)
    assert seams["feathered"].seam < seams["feathered"].noise
    assert seams["feathered"].seam < 0.25 * seams["hard"].seam
    assert seams["hard"].seam > 0.01


def test_seams_cannot_be_told_of_nothing():
    steps = seam_steps([], np.full(4, np.nan), np.zeros(4, np.uint64), np.array([[0, 1, 2]]))
    assert np.isnan(steps.seam)
    assert np.isnan(steps.noise)


def test_finer_pixels_are_averaged_over_what_a_sample_stands_for():
    # Stripes of three pixels, far finer than the vertices of a coarse ball.
    coarse, camera = ball(3), camera_at(0.0, size=480)
    picture, mask = photographed(camera)
    stripes = (np.arange(480) // 3) % 2
    striped = picture * (2.0 * stripes[None, :, None]).astype(np.float32)
    found = looked(coarse, camera, striped, mask)
    plain = looked(coarse, camera, picture, mask)
    sure = found.seen.weights > 0.1
    assert np.isin(found.seen.index[sure], plain.seen.index).all()
    same = np.searchsorted(plain.seen.index, found.seen.index[sure])
    ratio = found.seen.values[sure] / plain.seen.values[same]
    assert ratio.mean() == pytest.approx(1.0, abs=0.02)
    assert ratio.std() < 0.15  # point sampling gives 1


def test_the_back_of_a_thin_wall_is_not_painted_through():
    front = _sheet(0.0, 1)
    back = _sheet(-0.001, -1)
    wall = TriangleMesh(
        np.concatenate([front.vertices, back.vertices]),
        np.concatenate([front.triangles, back.triangles + len(front.vertices)]).astype(np.int32),
    )
    camera = camera_at(np.pi / 2, 0.0)
    picture = np.ones((240, 240, 3), np.float32)
    found = looked(wall, camera, picture, np.ones((240, 240), bool), flash=None)
    assert len(found.seen) > 100
    assert (found.seen.index < len(front.vertices)).all()


def _sheet(y: float, facing: int) -> TriangleMesh:
    """A square in the plane y, facing +y or −y."""
    steps = np.linspace(-0.2, 0.2, 31)
    x, z = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    corner = (np.arange(30)[:, None] * 31 + np.arange(30)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + 31], 1),
         np.stack([corner + 1, corner + 32, corner + 31], 1)]
    ).astype(np.int32)  # fmt: skip
    return TriangleMesh(
        np.stack([x, np.full(len(x), y), z], 1), triangles if facing > 0 else triangles[:, ::-1]
    )


def test_the_sharper_photograph_counts_more():
    import cv2

    rng = np.random.default_rng(5)
    detail = cv2.GaussianBlur(rng.random((200, 200, 1)).astype(np.float32), (0, 0), 0.8)
    picture = np.repeat(detail[..., None], 3, axis=2)
    told = np.ones((200, 200), bool)
    told[:, :20] = False
    sharp = sharpness(picture, told)
    blurred = sharpness(cv2.GaussianBlur(picture, (0, 0), 2.0), told)
    inside = np.s_[30:-30, 40:-30]
    assert (sharp[inside] > 2.0 * blurred[inside]).all()
    # Brightness is not sharpness, and what lies beyond the mask has no say.
    spoilt = 5.0 * picture
    spoilt[:, :20] = rng.random((200, 20, 3)) * 1e4
    assert sharpness(spoilt, told)[inside] == pytest.approx(sharp[inside], rel=1e-3)


def test_weights_come_to_nothing_at_every_border():
    told = np.zeros((200, 300), bool)
    told[50:150, 50:250] = True
    told[100, 150] = False
    weights = feathered(told, 0.05)
    assert not weights[~told].any()
    assert weights[75, 75] == 1.0
    assert 0.0 < weights[100, 151] < 0.02
    assert 0.0 < weights[50, 100] < 0.02
    whole = feathered(np.ones((100, 100), bool), 0.1)
    assert whole[0, 50] < 0.02
    assert np.abs(np.diff(weights, axis=0)).max() < 0.15
    assert not feathered(np.zeros((9, 9), bool), 0.1).any()


def test_coarse_photographs_count_less():
    near, far = (
        looked(MESH, camera, *photographed(camera)).seen
        for camera in (camera_at(0.3, size=400), camera_at(0.3, size=100))
    )
    shared = np.intersect1d(near.index, far.index)
    ratio = (
        far.weights[np.searchsorted(far.index, shared)]
        / near.weights[np.searchsorted(near.index, shared)]
    )
    assert np.median(ratio) < 0.7


def test_exposures_are_found_where_photographs_overlap(albedos):
    gains = np.exp(np.random.default_rng(2).normal(0.0, 0.3, len(albedos)))
    uneven = [replace(p, colors=p.colors * g) for p, g in zip(albedos, gains, strict=True)]
    found = leveled_gains(uneven, len(MESH.vertices), rounds=60)
    expected = gains / np.exp(np.log(gains).mean())
    assert found == pytest.approx(expected, rel=5e-3)
    sums = BlendSums(len(MESH.vertices))
    for photo in albedos[:5]:
        sums.add(photo)
    assert gains_against(uneven, sums)[5:] == pytest.approx(gains[5:], rel=5e-3)
    nothing = Colored(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))
    assert leveled_gains([nothing], 4).tolist() == [1.0]


def test_the_rim_is_left_to_inpainting_when_asked(albedos):
    everything = blended(albedos, len(MESH.vertices))
    sure = blended(albedos, len(MESH.vertices), least_weight=0.2)
    assert 0 < (sure.weights > 0).sum() < (everything.weights > 0).sum()
    assert np.isnan(sure.colors[sure.weights == 0.0]).all()


def test_blocks_of_a_mesh_hold_every_vertex_and_its_spacing():
    blocks = blocks_of_mesh(MESH)
    assert sum(len(block.points) for block in blocks) == len(MESH.vertices)
    assert np.array_equal(blocks[0].normals, MESH.vertex_attributes["normal"])
    a, b = MESH.vertices[MESH.triangles[:, 0]], MESH.vertices[MESH.triangles[:, 1]]
    edge = np.linalg.norm(a - b, axis=1)
    assert np.median(vertex_spacing(MESH)) == pytest.approx(np.median(edge), rel=0.05)
    lonely = TriangleMesh(np.zeros((4, 3)), np.array([[0, 1, 2]], np.int32))
    assert vertex_spacing(lonely)[3] == 0.0


def test_colours_are_encoded_at_the_very_end():
    linear = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.21404114, 0.21404114, 0.21404114]])
    for space in ("rec709", "prophoto"):
        assert encoded_srgb(linear, space).tolist() == [[0] * 3, [255] * 3, [128] * 3] or (
            encoded_srgb(linear, space)[2].tolist() in ([127] * 3, [128] * 3)
        )
    red = encoded_srgb(np.array([[0.5, 0.1, 0.1]]), "rec709")[0]
    assert red[0] == 188
    # The same numbers in wider primaries are a stronger red.
    assert encoded_srgb(np.array([[0.5, 0.1, 0.1]]), "prophoto")[0, 0] > red[0]
