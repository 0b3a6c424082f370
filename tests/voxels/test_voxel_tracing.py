"""Rays through graphs: against all voxels one by one, between encodings, and on real data."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.formats.surface_files import read_surface
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.morton import morton_cells
from workbench.voxels.dag_encoding import ENCODINGS, encoded
from workbench.voxels.dag_reduction import reduced_dag
from workbench.voxels.graph_export import reduced_for
from workbench.voxels.graph_pictures import PictureOptions, camera_around, traced_view
from workbench.voxels.tracing import VoxelTracer
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh
from workbench.voxels.voxelisation import voxelise


def tracers(codes, grid):
    dag = reduced_dag(codes, grid.level)
    return {e: VoxelTracer(encoded(reduced_for(dag, e), e), grid) for e in ENCODINGS}


def first_box_met(cells, origins, directions):
    """Distance to the first of all boxes, by the slab test; infinite for none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (cells[None] - origins[:, None]) / directions[:, None]
        b = (cells[None] + 1 - origins[:, None]) / directions[:, None]
    enters = np.minimum(a, b).max(axis=2)
    leaves = np.maximum(a, b).min(axis=2)
    met = (enters < leaves) & (leaves > 0)
    return np.where(met, np.maximum(enters, 0), np.inf).min(axis=1)


@pytest.mark.parametrize(("level", "count"), [(2, 5), (3, 100), (5, 300), (7, 400)])
def test_rays_meet_what_they_meet_among_all_voxels(level, count):
    rng = np.random.default_rng(level)
    side = 1 << level
    codes = np.unique(rng.integers(0, 8**level, count)).astype(np.uint64)
    grid = VoxelGrid(np.array([10.0, -4.0, 3.0]), 2.0 * side, level)
    # From inside and outside, and some along the axes.
    origins = rng.uniform(-0.5 * side, 1.5 * side, (1500, 3))
    directions = rng.uniform(0, side, (1500, 3)) - origins
    directions[:200] *= np.eye(3)[rng.integers(0, 3, 200)]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = first_box_met(morton_cells(codes), origins, directions)
    for tracer in tracers(codes, grid).values():
        hits = tracer.first_met(grid.origin + 2.0 * origins, directions)
        assert np.array_equal(hits.found, np.isfinite(expected))
        assert hits.found.sum() > 30
        np.testing.assert_allclose(
            hits.distance[hits.found], 2.0 * expected[hits.found], rtol=0, atol=1e-11 * side
        )
        inside = hits.cells[hits.found]
        assert np.isin(inside @ [1, side, side**2], morton_cells(codes) @ [1, side, side**2]).all()


def test_encodings_give_the_same_answers_to_the_last_bit():
    rng = np.random.default_rng(0)
    codes = np.unique(rng.integers(0, 8**6, 900)).astype(np.uint64)
    grid = VoxelGrid(np.zeros(3), 1.0, 6)
    camera = camera_around(grid, 96, 64)
    for options in (PictureOptions(detail_px=0.0), PictureOptions(detail_px=3.0)):
        answers = set()
        for tracer in tracers(codes, grid).values():
            for block in (0, 5, 8):
                options = PictureOptions(detail_px=options.detail_px, block_px=block)
                hits = traced_view(tracer, camera, options).hits
                answers.add((hits.distance.tobytes(), hits.sizes.tobytes()))
        assert len(answers) == 1


def test_detail_is_left_out_where_it_is_finer_than_asked():
    codes = np.arange(8**6, dtype=np.uint64)
    grid = VoxelGrid(np.zeros(3), 64.0, 6)
    tracer = tracers(codes, grid)["ssvdag"]
    origins = np.array([[-200.0, 20.3, 30.7]])
    direction = np.array([[1.0, 0.0, 0.0]])
    sizes = [
        int(tracer.first_met(origins, direction, slope=slope).sizes[0])
        for slope in (0.0, 2.01 / 200, 4.01 / 200, 16.01 / 200)
    ]
    assert sizes == [1, 2, 4, 16]


def test_cones_are_empty_up_to_where_they_say():
    rng = np.random.default_rng(1)
    codes = np.unique(rng.integers(0, 8**6, 700)).astype(np.uint64)
    grid = VoxelGrid(np.zeros(3), 64.0, 6)
    tracer = tracers(codes, grid)["ssvdag"]
    tip = np.array([-30.0, 20.0, 90.0])
    axes = rng.uniform(0, 64, (300, 3)) - tip
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    starts = tracer.empty_before(tip, axes, np.full(300, 0.05))
    assert np.isfinite(starts).mean() > 0.5
    useful = starts[np.isfinite(starts)] > 30.0
    assert useful.mean() > 0.5
    for _ in range(40):
        aside = rng.normal(size=(300, 3))
        aside -= (aside * axes).sum(axis=1, keepdims=True) * axes
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        angle = 0.05 * np.sqrt(rng.random((300, 1)))
        rays = np.cos(angle) * axes + np.sin(angle) * aside
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        assert (tracer.first_met(tip, rays).distance >= starts).all()


def test_stretches_of_rays():
    codes = np.array([0], np.uint64)
    grid = VoxelGrid(np.zeros(3), 8.0, 3)
    tracer = tracers(codes, grid)["ssvdag"]
    origin, direction = np.array([[-4.0, 0.5, 0.5]]), np.array([[1.0, 0.0, 0.0]])
    assert tracer.first_met(origin, direction).distance[0] == 4.0
    assert not tracer.first_met(origin, direction, farthest=3.9).found[0]
    assert not tracer.first_met(origin, direction, nearest=5.1).found[0]


def test_an_empty_cube_is_met_by_nothing():
    for tracer in tracers(np.empty(0, np.uint64), VoxelGrid(np.zeros(3), 1.0, 4)).values():
        assert not tracer.first_met(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])).found[0]
        assert np.isinf(tracer.empty_before(np.zeros(3), np.eye(3), np.full(3, 0.1))).all()


def test_what_is_seen_of_a_scanned_statue_lies_within_a_voxel_of_its_surface(shared_data):
    mesh = read_surface(shared_data("stanford-bunny", "reference", "bun_zipper.ply"))
    grid = grid_of_mesh(mesh.vertices, 8)
    tracer = tracers(voxelise(mesh, grid).codes, grid)["ssvdag"]
    surface = SurfaceRays(mesh)
    diagonal = np.sqrt(3.0) * grid.voxel_size
    for azimuth in (20.0, 200.0):
        camera = camera_around(grid, 320, 240, azimuth=azimuth)
        view = traced_view(tracer, camera, PictureOptions(detail_px=0.0))
        met = surface.first_met(camera.center, view.directions)
        beyond = np.linalg.norm(met.points - camera.center, axis=1)
        # No ray goes through the surface, and each ends next to it.
        assert (view.hits.distance[met.found] <= beyond[met.found] + 1e-4 * diagonal).all()
        found = view.hits.found
        ends = camera.center + view.hits.distance[found, None] * view.directions[found]
        away = np.linalg.norm(surface.nearest(ends).points - ends, axis=1)
        assert away.max() <= diagonal
        # Along the ray it is more where the surface slants, by as much as that makes of it.
        slant = np.abs((met.normals * view.directions).sum(axis=1))[met.found]
        ahead = (beyond - view.hits.distance)[met.found]
        assert np.mean(ahead * slant <= diagonal) > 0.98
        assert np.median(ahead) < diagonal
