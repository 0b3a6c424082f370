from __future__ import annotations

import numpy as np
import pytest
from bodies import divided_box, joined, volume

from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.surface.closing import boundary_loops, capped, clipped, closed_at_box
from workbench.synthetic import solids

UP = np.array([0.0, 0.0, 1.0])


def test_a_plane_beside_the_mesh_changes_nothing() -> None:
    cube = divided_box(0, 1, 3)
    assert clipped(cube, UP, 1.5) is cube
    assert clipped(cube, UP, 1.0) is cube
    assert len(clipped(cube, UP, -0.5).triangles) == 0


@pytest.mark.parametrize("shift", [0.0, 1e3])
@pytest.mark.parametrize("height", [0.25, 0.37, 0.5, 0.75])
@pytest.mark.parametrize("n", [1, 2, 4, 8])
def test_a_cut_cube_has_the_volume_below_the_cut(n: int, height: float, shift: float) -> None:
    cube = divided_box(shift, shift + 1, n)
    cut = capped(clipped(cube, UP, shift + height))
    assert edge_census(cut.triangles).watertight
    # Vertices on the plane count as just below it.
    assert volume(cut) == pytest.approx(height, abs=3e-9 * max(1.0, shift))
    assert cut.vertices[:, 2].max() <= shift + height + 3e-9


@pytest.mark.parametrize("n", [1, 2, 3, 5, 12])
@pytest.mark.parametrize("height", [0.37, 0.5, 0.75])
def test_rings_within_rings_are_capped_with_their_holes(n: int, height: float) -> None:
    """A box with a hollow in which another box floats."""
    body = joined(
        divided_box(0, 1, n), divided_box(0.2, 0.8, n, inward=True), divided_box(0.3, 0.7, n + 1)
    )
    cut = capped(clipped(body, UP, height))
    assert edge_census(cut.triangles).watertight

    def below(low: float, high: float) -> float:
        return (high - low) ** 2 * (min(height, high) - low)

    expected = below(0, 1) - below(0.2, 0.8) + below(0.3, 0.7)
    assert volume(cut) == pytest.approx(expected, abs=1e-8)


def test_a_ring_of_a_tube_cut_at_both_ends() -> None:
    sides = 64
    outer = solids.lathed([(1.0, -3.0), (1.0, 3.0)], sides)
    inner = solids.lathed([(0.5, -4.0), (0.5, 4.0)], sides)
    inner = TriangleMesh(inner.vertices, inner.triangles[:, ::-1])
    pipe = closed_at_box(joined(outer, inner), np.array([-2, -2, -1.0]), np.array([2, 2, 1.5]))
    assert edge_census(pipe.triangles).watertight
    polygon = 0.5 * sides * np.sin(2 * np.pi / sides)
    assert volume(pipe) == pytest.approx(2.5 * polygon * (1 - 0.25), rel=1e-9)


@pytest.mark.parametrize("centre", [(0, 0, 0.7), (0.7, 0.7, 0.1), (0.7, 0.7, 0.7)])
def test_openings_round_edges_and_corners_of_the_box_are_closed(
    centre: tuple[float, float, float],
) -> None:
    ball = solids.geodesic_sphere(centre, 0.5, 4)
    closed = closed_at_box(ball, -np.ones(3), np.ones(3))
    assert edge_census(closed.triangles).watertight
    assert np.abs(closed.vertices).max() <= 1 + 1e-6
    assert 0 < volume(closed) < volume(ball)


def test_an_open_sheet_gets_one_cap() -> None:
    cube = divided_box(0, 1, 4)
    lid = (cube.vertices[cube.triangles][:, :, 2] == 1).all(axis=1)
    closed = capped(cube.keep_triangles(~lid))
    assert edge_census(closed.triangles).watertight
    assert volume(closed) == pytest.approx(1.0, abs=1e-12)
    sheet = capped(cube.keep_triangles(lid))
    assert edge_census(sheet.triangles).watertight
    assert volume(sheet) == pytest.approx(0.0, abs=1e-12)


def test_every_loop_runs_with_its_faces() -> None:
    ball = solids.geodesic_sphere((0, 0, 0), 1, 3)
    keep = np.abs(ball.vertices[ball.triangles].mean(axis=1)[:, 2]) < 0.8
    open_ball = ball.keep_triangles(keep)
    loops = boundary_loops(open_ball.triangles)
    edges = {
        (a, b) for t in open_ball.triangles.tolist() for a, b in zip(t, t[1:] + t[:1], strict=True)
    }
    boundary = {(a, b) for a, b in edges if (b, a) not in edges}
    found = [
        e for loop in loops for e in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)
    ]
    assert len(loops) == 2
    assert len(found) == len(set(found))
    assert set(found) == boundary


def test_openings_that_touch_are_told_apart_and_closed() -> None:
    """Two squares missing from the top that share a corner, and two that remain."""
    cube = divided_box(0, 1, 4)
    middle = cube.vertices[cube.triangles].mean(axis=1)
    x, y, top = middle[:, 0], middle[:, 1], middle[:, 2] > 0.999
    gone = top & (x > 0.25) & (x < 0.75) & (y > 0.25) & (y < 0.75) & ((x > 0.5) == (y > 0.5))
    loops = boundary_loops(cube.triangles[~gone])
    assert sorted(len(loop) for loop in loops) == [4, 4]
    closed = capped(TriangleMesh(cube.vertices, cube.triangles[~gone]))
    assert edge_census(closed.triangles).watertight
    assert volume(closed) == pytest.approx(1.0, abs=1e-12)


def test_a_closed_mesh_has_no_loops() -> None:
    assert boundary_loops(divided_box(0, 1, 2).triangles) == []
    assert boundary_loops(np.zeros((0, 3), np.int32)) == []
