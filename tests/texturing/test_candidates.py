"""Candidates see their triangles, and cost what eq. 2–4 say."""

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, ring, sheet, together
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.candidates import Candidates, candidates_of
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.depth_map import DepthMap, depth_map_of_surface
from workbench.texturing.depth_mesh import depth_mesh


def maps_of(mesh, cameras):
    rays = SurfaceRays(mesh)
    return {
        k: depth_map_of_surface(rays, c, np.ones((c.height, c.width), bool), True)
        for k, c in cameras.items()
    }


def lists(found: Candidates):
    return [
        found.labels[a:b].tolist() for a, b in zip(found.starts[:-1], found.starts[1:], strict=True)
    ]


def test_as_rays_to_the_cameras_say(sphere):
    """Against rays from every triangle's corners: what is hidden is never a candidate."""
    mesh = together(sphere(0.7, (0, 0, 0), 4), sphere(0.4, (1.0, 0.7, 0.1), 4))
    cameras = ring(7) | {7: camera_at((0.3, 0.2, 3.0))}
    found = lists(candidates_of(mesh, maps_of(mesh, cameras), CostOptions(6.0)))
    rays = SurfaceRays(mesh)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    wrong, missed, right = 0, 0, 0
    for photo, camera in cameras.items():
        way = corners - camera.center
        distance = np.linalg.norm(way, axis=2)
        met = rays.first_met(camera.center, (way / distance[..., None]).reshape(-1, 3)).points
        reached = np.linalg.norm(met - camera.center, axis=1).reshape(distance.shape)
        open_ = (reached > distance - 0.03).all(axis=1)
        pixels = camera.project(corners.reshape(-1, 3))[0].reshape(-1, 3, 2)
        framed = ((pixels > 1) & (pixels < [239, 179])).all(axis=(1, 2))
        cosine = -(way.mean(axis=1) * normals).sum(axis=1) / distance.mean(axis=1)
        for t, own in enumerate(found):
            wrong += photo in own and not (open_[t] and cosine[t] > 0.09)
            missed += photo not in own and bool(framed[t] & open_[t] & (cosine[t] > 0.2))
            right += photo in own
    assert wrong == 0
    assert missed < 0.05 * right


def test_costs_are_those_of_the_paper():
    whole = sheet((-0.5, 0, -0.5), (1, 0, 0), (0, 0, 1), 1)
    mesh = sheet((-0.005, 0, -0.005), (0.01, 0, 0), (0, 0, 0.01), 1)
    a = np.radians(60.0)
    cameras = {
        2: camera_at((0, -2, 0), focal=9000.0),
        5: camera_at((3 * np.sin(a), -3 * np.cos(a), 0), focal=9000.0),
        9: camera_at((0, -8, 0), focal=9000.0),
    }
    options = CostOptions(far=4.0, distance=1.5, orientation=2.0)
    found = candidates_of(mesh, maps_of(whole, cameras), options)
    assert lists(found) == [[2, 5, 9]] * 2
    expected = [1.5 * 2 / 4, 1.5 * 3 / 4 + 2 * (1 - 0.5), 1.5]
    np.testing.assert_allclose(found.penalties.reshape(2, 3), [expected] * 2, atol=0.01)


def test_the_barred_the_masked_and_those_behind():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 10)
    cameras = {0: camera_at((0, -4, 0)), 1: camera_at((0, 4, 0)), 2: camera_at((0.5, -4, 0))}
    maps = maps_of(mesh, cameras)
    left = np.broadcast_to(np.arange(240) < 120, (180, 240))
    maps[2] = DepthMap(cameras[2], maps[2].depth, left, True)
    barred = np.zeros(200, bool)
    barred[:50] = True
    found = lists(candidates_of(mesh, maps, CostOptions(8.0), {0: barred}))
    right_of_middle = mesh.vertices[mesh.triangles][:, :, 0].max(axis=1) > -0.01
    for t, own in enumerate(found):
        assert 1 not in own
        assert not (0 in own and barred[t])
        assert not (2 in own and right_of_middle[t])
    # The outermost pixels' middles do not reach the sheet's edge; within them all see all.
    inside = np.abs(mesh.vertices[mesh.triangles]).max(axis=(1, 2)) < 0.95
    assert all(0 in own for own in np.array(found, object)[inside & ~barred])
    assert all(2 in own for own in np.array(found, object)[inside & ~right_of_middle])


def test_a_photograph_sees_its_own_mesh(sphere):
    """All of it that it does not see too flatly."""
    maps = maps_of(sphere(), ring(5))
    made = depth_mesh(maps[3])
    found = lists(candidates_of(made.mesh, maps, CostOptions(6.0, least_cosine=0.0)))
    assert np.mean([3 in own for own in found]) > 0.99
    assert {label for own in found for label in own} == {2, 3, 4}


def test_only_the_best_are_kept():
    starts, labels = np.array([0, 3, 3, 5]), np.array([1, 4, 6, 0, 2], np.int32)
    all_ = Candidates(starts, labels, np.array([3.0, 1.0, 1.0, 5.0, 4.0]))
    assert lists(all_.best(2)) == [[4, 6], [], [0, 2]]
    assert lists(all_.best(1)) == [[4], [], [2]]
    assert all_.best(1).penalties.tolist() == [1.0, 4.0]
    assert all_.best(0) is all_


def test_no_photographs_no_triangles_no_area():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 3)
    maps = maps_of(mesh, {0: camera_at((0, -4, 0))})
    assert lists(candidates_of(mesh, {}, CostOptions(1.0))) == [[]] * 18
    nothing = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert lists(candidates_of(nothing, maps, CostOptions(1.0))) == []
    sliver = TriangleMesh(
        np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.1, 0, 0.1]]),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    assert lists(candidates_of(sliver, maps, CostOptions(1.0))) == [[], [0]]
    # A camera within the surface divides by nothing.
    touching = {0: camera_at((0, 0, 0), (0, 1, 0))}
    assert np.isfinite(
        candidates_of(mesh, maps_of(mesh, touching), CostOptions(1.0)).penalties
    ).all()


def test_broken_vertices_are_refused():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 3)
    mesh.vertices[4, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        candidates_of(mesh, {}, CostOptions(1.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"far": 0.0},
        {"far": np.nan},
        {"far": 1.0, "smoothness": -1.0},
        {"far": 1.0, "orientation": np.inf},
        {"far": 1.0, "edge_samples": 0},
        {"far": 1.0, "least_cosine": 1.0},
    ],
)
def test_options_out_of_their_range_are_refused(wrong):
    with pytest.raises(InputError, match=list(wrong)[-1]):
        CostOptions(**wrong)


def test_the_size_of_a_scene():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 3)
    maps = maps_of(mesh, {k: camera_at((0, -d, 0)) for k, d in enumerate((3.1, 3.2, 3.4, 3.6))})
    # Twice the median, 6.4, is rounded to a quarter of an octave.
    assert far_of_scene([maps[0], maps[1], maps[2]]) == pytest.approx(2.0 ** (11 / 4))
    assert far_of_scene(maps.values()) == pytest.approx(2.0 ** (11 / 4))
    with pytest.raises(InputError, match="shows anything"):
        far_of_scene(maps_of(mesh, {0: camera_at((0, -4, 0), (0, -9, 0))}).values())
