"""Surfaces of fields on the lattice, whole and in parts."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import volume

from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.kernels.bcc_isosurface import edge_points, indexed_triangles
from workbench.surface.lattice import Lattice, Part, surface_part

RADIUS, SPACING = 0.3, 0.01
# A direction that leads to no corner of anything.
SOMEWHERE = np.array([0.60, 0.64, 0.48])


def ball(center: np.ndarray, radius: float = RADIUS):
    return lambda points: np.linalg.norm(points - center, axis=1) - radius


def lattice_over(center: np.ndarray, reach: float = RADIUS) -> Lattice:
    return Lattice.over(center - reach, center + reach, SPACING)


def mesh_of(lattice: Lattice, *parts: Part) -> TriangleMesh:
    keys = np.concatenate([part.keys for part in parts])
    fractions = np.concatenate([part.fractions for part in parts])
    _, vertices, triangles = indexed_triangles(keys, fractions, lattice.stride)
    return TriangleMesh(lattice.positions(vertices), triangles)


def seeds_of(lattice: Lattice, *points: np.ndarray) -> np.ndarray:
    return lattice.numbers_of(np.array(points))


@pytest.mark.parametrize("offset", [0.0, 5.2e6])
def test_a_ball_is_closed_round_and_faces_outwards(offset: float) -> None:
    center = np.array([offset, 1.0, -2.0])
    lattice = lattice_over(center)
    seed = seeds_of(lattice, center + RADIUS * SOMEWHERE)
    part = surface_part(ball(center), lattice, seed, np.zeros(3, int), lattice.bricks)
    mesh = mesh_of(lattice, part)
    assert edge_census(mesh.triangles).watertight
    # Interpolation along an edge of one cell: its square over eight radii at most.
    assert np.abs(ball(center)(mesh.vertices)).max() < SPACING**2 / (8 * RADIUS) * 1.01
    at_home = TriangleMesh(mesh.vertices - center, mesh.triangles)
    assert volume(at_home) == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=2e-3)
    assert not len(part.beyond)


def test_parts_made_apart_are_the_whole() -> None:
    center = np.array([0.01, 0.02, 0.03])
    lattice = lattice_over(center)
    seed = seeds_of(lattice, center + RADIUS * SOMEWHERE, center - RADIUS * SOMEWHERE)
    whole = surface_part(ball(center), lattice, seed, np.zeros(3, int), lattice.bricks)
    half = np.array([lattice.bricks[0] // 2, *lattice.bricks[1:]])
    left = surface_part(ball(center), lattice, seed, np.zeros(3, int), half)
    right = surface_part(ball(center), lattice, seed, np.array([half[0], 0, 0]), lattice.bricks)
    assert np.isin(left.beyond, right.visited).all()
    assert np.isin(right.beyond, left.visited).all()
    assert len(left.beyond)
    both = np.concatenate([left.keys, right.keys])
    assert sorted(map(tuple, both)) == sorted(map(tuple, whole.keys))
    assert edge_census(mesh_of(lattice, left, right).triangles).watertight


def test_only_what_hangs_together_with_a_seed_is_made() -> None:
    near, far = np.array([0.0, 0, 0]), np.array([0.5, 0, 0])

    def two_balls(points: np.ndarray) -> np.ndarray:
        return np.minimum(ball(near, 0.1)(points), ball(far, 0.1)(points))

    lattice = Lattice.over(near - 0.2, far + 0.2, SPACING)
    seed = seeds_of(lattice, near + 0.1 * SOMEWHERE)
    part = surface_part(two_balls, lattice, seed, np.zeros(3, int), lattice.bricks)
    mesh = mesh_of(lattice, part)
    assert edge_census(mesh.triangles).watertight
    assert mesh.vertices[:, 0].max() < 0.11


def test_the_field_is_asked_only_near_its_surface() -> None:
    asked = []
    center = np.zeros(3)
    lattice = lattice_over(center)

    def counted(points: np.ndarray) -> np.ndarray:
        asked.append(points)
        return ball(center)(points)

    seed = seeds_of(lattice, center + RADIUS * SOMEWHERE)
    surface_part(counted, lattice, seed, np.zeros(3, int), lattice.bricks)
    assert np.abs(ball(center)(np.concatenate(asked))).max() < 2.2 * lattice.brick_m


def test_values_of_zero_open_nothing() -> None:
    """A flat face that runs through nodes: signs decide, and zero counts as outside."""
    lattice = Lattice.over(np.full(3, -0.1), np.full(3, 0.1), SPACING)
    half = lattice.low + np.round(lattice.bricks / 2 - 1) * lattice.brick_m

    def box(points: np.ndarray) -> np.ndarray:
        return np.abs(points - half).max(axis=1) - 4 * SPACING

    seed = seeds_of(lattice, half + 4 * SPACING)
    part = surface_part(box, lattice, seed, np.zeros(3, int), lattice.bricks)
    assert edge_census(mesh_of(lattice, part).triangles).watertight


def test_bricks_and_names_belong_together() -> None:
    lattice = Lattice.over(np.zeros(3), np.array([0.5, 0.3, 0.2]), SPACING)
    bricks = np.array([[0, 0, 0], [3, 2, 1], lattice.bricks - 1])
    np.testing.assert_array_equal(lattice.unnumbered(lattice.numbered(bricks)), bricks)
    part = surface_part(
        ball(np.array([0.25, 0.15, 0.1]), 0.08),
        lattice,
        np.arange(int(lattice.bricks.prod())),
        np.zeros(3, int),
        lattice.bricks,
    )
    keys = np.unique(part.keys)
    home = lattice.bricks_of_edges(keys)
    near_lower = edge_points(keys, np.full(len(keys), 0.001), lattice.stride)
    places = lattice.positions(near_lower)
    expected = np.floor((places - lattice.low) / lattice.brick_m + 1e-4)
    # The lower node of an edge that leads back across a face lies beyond it.
    assert (np.abs(home - expected) <= 1).all()
    assert (home == expected).all(axis=1).mean() > 0.7


def test_a_lattice_too_large_to_name_is_refused() -> None:
    with pytest.raises(ValueError, match="64 bits"):
        Lattice.over(np.zeros(3), np.full(3, 1e6), 0.1)
