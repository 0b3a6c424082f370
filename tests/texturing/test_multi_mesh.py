"""Depth meshes of a painted ball, labelled."""

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, paint, picture, ring
from tests.texturing.test_candidates import maps_of
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.depth_mesh import depth_mesh
from workbench.texturing.multi_mesh import labelled_again, labelled_depth_mesh, which_see

SMALL = {"size": (96, 72), "focal": 104.0}


@pytest.fixture(scope="module")
def ball(sphere):
    """Depth maps, cameras and pictures of a ball from eight sides, exposures differing."""
    mesh = sphere(1.0, (0, 0, 0), 5)
    cameras = ring(8)
    rays = SurfaceRays(mesh)
    pictures = {k: picture(rays, c, 1.0 + 0.04 * (k % 3)) for k, c in cameras.items()}
    return maps_of(mesh, ring(8, **SMALL)), cameras, pictures


@pytest.fixture(scope="module")
def labelled(ball):
    maps, cameras, pictures = ball
    options = CostOptions(far_of_scene(maps.values()))
    return {
        k: labelled_depth_mesh(k, maps, cameras, pictures.__getitem__, options, 4) for k in maps
    }


def test_outer_borders_are_left_to_others(ball, labelled):
    maps, _, _ = ball
    for photo, made in labelled.items():
        outer = depth_mesh(maps[photo]).outer
        assert made.outer == outer.sum() > 50
        assert not made.labelled.foreground[outer].any()
        assert (made.labelled.foreground == (made.labelled.labels == photo)).all()


def test_foregrounds_face_their_photographs(ball, labelled):
    """Each photograph textures the middle of its mesh, and all that it does not is by others."""
    _, cameras, _ = ball
    for photo, made in labelled.items():
        mesh = made.labelled.mesh
        middles = mesh.vertices[mesh.triangles].mean(axis=1)
        middles /= np.linalg.norm(middles, axis=1, keepdims=True)
        away = cameras[photo].center / np.linalg.norm(cameras[photo].center)
        facing = middles @ away
        assert made.labelled.foreground[facing > 0.97].mean() > 0.9
        assert 0.2 < made.labelled.foreground.mean() < 0.8
        round_it = np.abs(middles[:, 2]) < 0.6
        assert (made.labelled.labels[round_it & (facing > 0.5)] >= 0).all()


def test_smoothness_moves_seams_to_where_they_cost_less(labelled):
    for made in labelled.values():
        labelling = made.labelling
        assert labelling.energy.total <= labelling.before.total
        assert labelling.gap < 0.2
    # Some of the seams were worth moving.
    assert sum(made.labelling.moves[1] for made in labelled.values()) > 0


def test_penalties_are_those_of_the_choice(ball, labelled):
    maps, cameras, _ = ball
    far = far_of_scene(maps.values())
    made = labelled[2].labelled
    mesh = made.mesh
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    some = np.flatnonzero(made.labels >= 0)
    centers = np.stack([cameras[k].center for k in made.labels[some].tolist()])
    way = corners[some].mean(axis=1) - centers
    away = np.linalg.norm(way, axis=1)
    cosine = np.abs((normals[some] * way).sum(axis=1)) / away
    expected = np.minimum(away, far) / far + 2.0 * (1.0 - cosine)
    np.testing.assert_allclose(made.penalties[some], expected, rtol=1e-5)
    assert np.isinf(made.penalties[made.labels < 0]).all()


def test_vertices_have_the_colors_of_the_surface(labelled):
    mesh = labelled[0].labelled.mesh
    color = mesh.vertex_attributes["color"]
    assert color.dtype == np.uint8
    truth = 255 * np.clip(paint(mesh.vertices), 0.0, 1.0)
    some = (color != 128).any(axis=1)
    assert some.mean() > 0.9
    # Exposures differ by up to 8 %.
    ratio = color[some] / np.maximum(truth[some], 20.0)
    assert 0.97 < np.median(ratio) < 1.09
    assert np.abs(color[some] - truth[some]).mean() < 0.06 * 255


def test_it_is_made_again_from_what_is_stored(ball, labelled):
    maps, _, _ = ball
    one = labelled[4]
    again = labelled_again(4, maps[4], one.arrays())
    for name, values in one.labelled.arrays().items():
        assert (again.arrays()[name] == values).all(), name


def test_only_those_that_see_a_mesh_matter(ball, labelled):
    maps, cameras, pictures = ball
    options = CostOptions(far_of_scene(maps.values()))
    seen_by = which_see(maps)
    assert seen_by[0] != tuple(range(8))
    for photo in (0, 5):
        few = {k: maps[k] for k in seen_by[photo]}
        assert set(labelled[photo].photos.tolist()) <= set(few)
        made = labelled_depth_mesh(photo, few, cameras, pictures.__getitem__, options, 4)
        assert (made.labelled.labels == labelled[photo].labelled.labels).all()
        color = made.labelled.mesh.vertex_attributes["color"]
        assert (color == labelled[photo].labelled.mesh.vertex_attributes["color"]).all()


def test_a_further_photograph_concerns_those_it_sees(ball, sphere):
    maps, _, _ = ball
    added = camera_at((3, 0, 0.5), **SMALL)
    more = maps | maps_of(sphere(1.0, (0, 0, 0), 5), {8: added})
    before, after = which_see(maps), which_see(more)
    touched = {photo for photo in maps if after[photo] != before[photo]}
    assert 0 in touched
    assert 4 not in touched
    assert all(8 in after[photo] for photo in touched)


def test_a_photograph_of_nothing(ball):
    maps, cameras, pictures = ball
    away = camera_at((3, 0, 0), (9, 0, 0), **SMALL)
    nothing = maps_of_nothing(maps, away)
    options = CostOptions(6.0)
    made = labelled_depth_mesh(
        8, maps | {8: nothing}, cameras | {8: away}, pictures.__getitem__, options
    )
    assert made.labelled.labels.shape == (0,)
    assert made.labelling.energy.total == 0.0
    assert which_see({0: maps[0], 8: nothing}) == {0: (0,), 8: (8,)}


def maps_of_nothing(maps, camera):
    depth = np.full_like(maps[0].depth, np.inf)
    return type(maps[0])(camera, depth, maps[0].usable, True)
