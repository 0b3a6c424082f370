"""A painted ball and its texture: what is drawn is what photographs show, seams are levelled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.texturing.scenes import paint, picture, ring, sheet
from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.patch_drawing import SUBTEXELS, read_between
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.mesh_texture import AtlasOptions, textured
from workbench.texturing.single_mesh import far_of_surface, labelled_surface

CAMERAS = ring(6, size=(320, 240), focal=340.0)
GAINS = (1.0, 0.92, 1.06, 0.97, 1.03, 0.9)


@pytest.fixture(scope="module")
def ball(sphere):
    mesh = sphere(0.9, subdivisions=4)
    colors = np.rint(255 * paint(mesh.vertices)).astype(np.uint8)
    return mesh.with_attributes(color=colors)


@pytest.fixture(scope="module")
def even(ball):
    rays = SurfaceRays(ball)
    return {k: picture(rays, camera) for k, camera in CAMERAS.items()}


@pytest.fixture(scope="module")
def labelled(ball, even):
    options = CostOptions(far_of_surface(ball, CAMERAS))
    mesh, labelling = labelled_surface(ball, CAMERAS, even.get, options)
    assert labelling.energy.total <= labelling.before.total
    return mesh


def read_at(texture, shares, triangles) -> np.ndarray:
    """(n, 3) colours the texture has at barycentric shares (n, 3) of its triangles (n,)."""
    found = np.empty((len(triangles), 3))
    corners = texture.texture_places[texture.mesh.triangles[triangles]]
    for page, pixels in enumerate(texture.pictures):
        there = texture.pages[triangles] == page
        size = np.array([pixels.shape[1], pixels.shape[0]])
        at = np.einsum("nk,nkc->nc", shares[there], corners[there]) * size
        found[there] = read_between(pixels, at)
    return found


def somewhere(count, triangles, seed=0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.dirichlet((1, 1, 1), count), rng.integers(0, triangles, count)


def test_without_levelling_the_texture_is_what_photographs_show(ball, labelled, even):
    texture, report = textured(labelled, CAMERAS, even.get, AtlasOptions(levels="none"))
    shares, triangles = somewhere(4000, len(ball.triangles))
    points = np.einsum("nk,nkc->nc", shares, ball.vertices[ball.triangles[triangles]])
    found = read_at(texture, shares, triangles)
    # The same triangles in the same places, whatever was done to the vertices.
    np.testing.assert_array_equal(
        texture.mesh.vertices[texture.mesh.triangles], ball.vertices[ball.triangles]
    )
    for label, camera in CAMERAS.items():
        there = labelled.labels[triangles] == label
        assert there.sum() > 100
        pixels, _ = camera.project(points[there])
        shown = read_between(even[label], pixels)
        # Positions are kept to 1 / 512 pixel; within a triangle the lens and the perspective
        # bend lines by less than a fiftieth.
        assert np.abs(found[there] - shown).max() < 1.0
    assert report.levelling is None
    assert report.before == pytest.approx(report.after, abs=0.01) or (
        abs(report.before.mean - report.after.mean) < 0.01
    )
    assert 0.2 < report.utilisation < 0.9


def test_bare_triangles_show_the_colours_of_their_vertices(ball, labelled, even):
    bare = LabelledMesh(
        ball, np.full_like(labelled.labels, NO_PHOTO), labelled.foreground, labelled.penalties
    )
    texture, report = textured(bare, {}, even.get)
    assert report.bare_patches == report.patches
    shares, triangles = somewhere(4000, len(ball.triangles), seed=1)
    points = np.einsum("nk,nkc->nc", shares, ball.vertices[ball.triangles[triangles]])
    error = np.abs(read_at(texture, shares, triangles) - 255 * paint(points))
    # Two texels to an edge of 0.07: paint turns by up to 5 a unit.
    assert error.mean() < 1.0
    assert error.max() < 15.0


def test_exposures_that_differ_are_levelled_and_the_mean_is_kept(ball, labelled):
    rays = SurfaceRays(ball)
    shot = {k: picture(rays, camera, GAINS[k]) for k, camera in CAMERAS.items()}
    shares, triangles = somewhere(20_000, len(ball.triangles), seed=2)
    points = np.einsum("nk,nkc->nc", shares, ball.vertices[ball.triangles[triangles]])
    seen = labelled.labels[triangles] != NO_PHOTO
    reports, colors = {}, {}
    for levels in ("none", "global", "global-and-local"):
        texture, reports[levels] = textured(
            labelled, CAMERAS, shot.get, AtlasOptions(levels=levels)
        )
        colors[levels] = read_at(texture, shares, triangles)[seen]
    before = reports["none"].after.mean
    assert before > 4.0
    assert reports["global"].before.mean == pytest.approx(before, abs=0.01)
    assert reports["global"].after.mean < 0.2 * before
    # Bytes are rounded on both sides: about 0.4 is the least there can be.
    assert reports["global-and-local"].after.mean < 0.7
    levelling = reports["global"].levelling
    np.testing.assert_allclose(levelling.mean_shift, 0.0, atol=1e-4)
    moved = np.square(colors["global"] - colors["none"]).mean(axis=1).mean() ** 0.5
    assert levelling.rms_shift == pytest.approx(moved, rel=0.1)
    # Brighter photographs go down, darker ones up.
    for label, shift in levelling.shifts.items():
        if abs(GAINS[label] - np.mean(GAINS)) > 0.05:
            assert np.sign(np.mean(shift)) == np.sign(np.mean(GAINS) - GAINS[label])
    truth = np.mean(GAINS) * 255 * paint(points[seen])
    spread = {k: np.std(np.log(np.maximum(c, 1) / truth).mean(axis=1)) for k, c in colors.items()}
    assert spread["global"] < 0.6 * spread["none"]


def test_a_small_page_makes_several_and_the_same_colours(ball, labelled, even):
    one, _ = textured(labelled, CAMERAS, even.get, AtlasOptions(levels="none"))
    options = AtlasOptions(levels="none", largest=128, sides="power-of-two")
    many, report = textured(labelled, CAMERAS, even.get, options)
    assert len(many.pictures) > 2
    assert all(max(size) <= 128 for size in report.page_sizes)
    shares, triangles = somewhere(3000, len(ball.triangles), seed=3)
    # Where a triangle was cut from others, another neighbour fills in beside it.
    error = np.abs(read_at(one, shares, triangles) - read_at(many, shares, triangles))
    assert error.max() < 1.0


def test_patches_go_on_beyond_their_borders(labelled, even):
    texture, _ = textured(labelled, CAMERAS, even.get, AtlasOptions(padding=4))
    # A mip level of 4 texels' squares must show nothing but paint: no black from between.
    page = texture.pictures[0]
    height, width = (side // 4 * 4 for side in page.shape[:2])
    coarse = page[:height, :width].reshape(height // 4, 4, width // 4, 4, 3).mean(axis=(1, 3))
    assert coarse.min() > 255 * 0.1 - 5
    assert page.min() > 255 * 0.1 - 8


def test_the_same_again(labelled, even):
    first, _ = textured(labelled, CAMERAS, even.get)
    again, _ = textured(labelled, CAMERAS, even.get)
    for one, other in zip(first.pictures, again.pictures, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(first.texture_places, again.texture_places)


def test_the_labelling_prefers_the_photograph_that_looks_straight(ball, labelled):
    middles = ball.vertices[ball.triangles].mean(axis=1)
    angle = np.arctan2(middles[:, 1], middles[:, 0])
    nearest = np.round(angle / (2 * np.pi / 6)).astype(int) % 6
    seen = labelled.labels != NO_PHOTO
    assert (labelled.labels[seen] == nearest[seen]).mean() > 0.9
    assert seen.mean() > 0.7
    assert labelled.foreground.all()


def test_what_cannot_be_textured_is_refused(ball, labelled, even):
    plain = replace(labelled, mesh=sheet((0, 0, 0), (1, 0, 0), (0, 0, 1), 1), labels=np.zeros(2),
                    foreground=np.ones(2, bool), penalties=np.zeros(2))  # fmt: skip
    with pytest.raises(InputError, match="colours"):
        textured(plain, CAMERAS, even.get)
    for wrong in ({"stiffness": 0.0}, {"strip": 0}, {"padding": -1}, {"largest": 10}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            AtlasOptions(**wrong)
    with pytest.raises(InputError, match="cameras"):
        far_of_surface(ball, {})
    assert SUBTEXELS == 256
