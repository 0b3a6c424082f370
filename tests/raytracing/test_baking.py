"""Openness and accessible radii where both are known, with the surface in memory and on disk."""

from __future__ import annotations

import numpy as np
import pytest

from tests.raytracing.scenes import sheet
from workbench.errors import InputError
from workbench.formats.ply import read_ply
from workbench.formats.surface_files import read_surface, write_surface_ply
from workbench.geometry.mesh import TriangleMesh
from workbench.raytracing import baking
from workbench.raytracing.baking import ACCESSIBILITY, OCCLUSION, bake
from workbench.raytracing.opening import LEAST_MEMORY_BYTES
from workbench.raytracing.ray_light import LightOptions


def _baked(mesh, folder, **options):
    write_surface_ply(folder / "in.ply", mesh)
    memory = options.pop("memory_bytes", 1 << 30)
    done = bake(
        folder / "in.ply",
        folder / "out.ply",
        memory_bytes=memory,
        options=LightOptions(**{"samples": 256, **options}),
    )
    columns = read_ply(folder / "out.ply").elements["vertex"].columns
    return done, columns[OCCLUSION], columns[ACCESSIBILITY]


def _plane(corner, u, v, cells):
    s, t = np.meshgrid(*2 * [np.linspace(0.0, 1.0, cells + 1)])
    points = np.array(corner) + s[..., None] * np.array(u) + t[..., None] * np.array(v)
    first = np.arange(cells * (cells + 1)).reshape(cells, -1)[:, :-1].ravel()
    lower = np.stack([first, first + 1, first + cells + 1], axis=1)
    upper = np.stack([first + 1, first + cells + 2, first + cells + 1], axis=1)
    return TriangleMesh(points.reshape(-1, 3), np.concatenate([lower, upper]).astype(np.int32))


def _together(one, other):
    return TriangleMesh(
        np.concatenate([one.vertices, other.vertices]),
        np.concatenate([one.triangles, other.triangles + len(one.vertices)]),
    )


def test_a_wall_hides_what_its_form_factor_says_and_lets_a_ball_as_far_as_it_stands(tmp_path):
    floor = _plane((0, -1, 0), (2.0, 0, 0), (0, 2.0, 0), 20)
    wall = _plane((0, -40, 0), (0, 80.0, 0), (0, 0, 1.0), 4)
    _, openness, radius = _baked(_together(floor, wall), tmp_path, reach=1000.0, samples=1024)
    count = len(floor.vertices)
    x = floor.vertices[:, 0]
    inside = np.flatnonzero((x > 0.15) & (x < 0.9))
    # An infinite strip of height 1 at distance x: the classic (1 - sin φ) / 2.
    hidden = 0.5 * (1.0 - x / np.hypot(x, 1.0))
    assert np.abs(openness[:count] - (1.0 - hidden))[inside].max() < 0.01
    # A ball of radius x touches the wall, as long as the wall is that high.
    assert (radius[:count][inside] > 0.995 * x[inside]).all()
    assert (radius[:count][inside] < 1.05 * x[inside]).all()


def test_in_a_hollow_ball_nothing_is_open_and_its_own_radius_is_reached(tmp_path, sphere):
    ball = sphere(subdivisions=4)
    hollow = TriangleMesh(3.0 * ball.vertices, ball.triangles[:, ::-1])
    _, openness, radius = _baked(hollow, tmp_path, reach=100.0)
    assert openness.max() == 0.0
    assert np.quantile(radius, 0.1) > 2.9
    assert radius.max() < 3.0 * 1.001
    _, openness, radius = _baked(
        TriangleMesh(3.0 * ball.vertices, ball.triangles), tmp_path, reach=100.0
    )
    assert openness.min() == 1.0
    assert (radius == 50.0).all()


def test_a_surface_on_disk_is_baked_as_one_in_memory(tmp_path):
    mesh = sheet(150)
    inside, *expected = _baked(mesh, tmp_path, reach=0.4, samples=8)
    outside, *got = _baked(mesh, tmp_path, reach=0.4, samples=8, memory_bytes=LEAST_MEMORY_BYTES)
    assert inside.in_core
    assert not outside.in_core
    assert outside.counts.bytes_read > 0
    assert 0.1 < expected[0].mean() < 0.99
    # Rays from vertices run along edges, where which triangle is met is a matter of rounding.
    for one, other in zip(expected, got, strict=True):
        assert (one != other).mean() < 1e-3
        assert np.abs(one - other).max() <= 0.13
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.ply", "out.ply"]


def test_all_else_in_the_file_stays_and_few_vertices_at_a_time_give_the_same(tmp_path, monkeypatch):
    mesh = sheet(30)
    colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3)).astype(np.uint8)
    mesh = TriangleMesh(mesh.vertices, mesh.triangles, {"color": colors})
    _, *expected = _baked(mesh, tmp_path, reach=0.4, samples=8)
    back = read_surface(tmp_path / "out.ply")
    assert np.array_equal(back.vertices, read_surface(tmp_path / "in.ply").vertices)
    assert np.array_equal(back.triangles, mesh.triangles)
    assert np.array_equal(back.vertex_attributes["color"], colors)
    with pytest.raises(InputError, match="already"):
        bake(tmp_path / "out.ply", tmp_path / "x.ply", memory_bytes=1 << 30, options=LightOptions())
    monkeypatch.setattr(baking, "_VERTICES_AT_ONCE", 100)
    _, *got = _baked(mesh, tmp_path, reach=0.4, samples=8)
    assert np.abs(got[0] - expected[0]).mean() < 0.1


def test_vertices_without_a_side_have_no_values(tmp_path):
    mesh = sheet(5)
    mesh = TriangleMesh(np.concatenate([mesh.vertices, [[0.0, 0.0, 0.3]]]), mesh.triangles)
    done, openness, radius = _baked(mesh, tmp_path, reach=0.4)
    assert done.without_normal == 1
    assert np.isnan(openness[-1])
    assert np.isnan(radius[-1])
    assert np.isfinite(openness[:-1]).all()
