from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.mesh import edge_census, face_normals_and_areas
from workbench.kernels import implicit_solids as kernels
from workbench.kernels.gradient_noise import noise_at
from workbench.synthetic.carving import Solid, carved_mesh
from workbench.synthetic.primitives import GROUP_BLEND_M, Group, PrimitiveTable
from workbench.synthetic.statue import statue_solid


def solid_of(table: PrimitiveTable, detail: float = 0.0, seed: int = 1) -> Solid:
    return Solid(
        table.array(),
        GROUP_BLEND_M,
        np.full((kernels.GROUPS, 3), detail),
        np.zeros((0, 9)),
        seed,
        low=np.full(3, -0.15),
        high=np.full(3, 0.15),
        interior=np.zeros(3),
    )


def distances(table: PrimitiveTable, points: np.ndarray) -> np.ndarray:
    return solid_of(table).smooth_distances(np.asarray(points, float), 0.001)


def test_a_ball_is_carved_closed_with_its_radius_and_volume() -> None:
    table = PrimitiveTable()
    table.ball(Group.BODY, (0.0, 0.0, 0.0), 0.1)
    mesh = carved_mesh(solid_of(table), 0.006)
    assert edge_census(mesh.triangles).watertight
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.1).max() < 0.006**2 / 0.1
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(4 / 3 * np.pi * 1e-3, rel=2e-3)


def test_weathering_leaves_one_closed_surface_with_area_everywhere() -> None:
    table = PrimitiveTable()
    table.ellipsoid(Group.BODY, (0.0, 0.0, 0.0), (0.1, 0.06, 0.08))
    table.box(Group.BASE, (0.0, 0.0, -0.06), (0.07, 0.07, 0.02), 0.004)
    table.ball(Group.CUT, (0.09, 0.0, 0.0), 0.04)
    solid = solid_of(table, detail=1.5)
    mesh = carved_mesh(solid, 0.003)
    assert edge_census(mesh.triangles).watertight
    assert face_normals_and_areas(mesh)[1].min() > 0
    depth = -solid.smooth_distances(mesh.vertices, 0.003)
    uncut = np.linalg.norm(mesh.vertices - [0.09, 0.0, 0.0], axis=1) > 0.05
    assert 0.0003 < depth[uncut].std() < 0.003
    assert np.abs(depth[uncut]).max() < kernels.WEATHERING_M + 0.0005
    assert depth[~uncut].max() > 0.01


def test_distances_to_single_primitives_are_those_of_geometry() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.14, 0.14, (300, 3))
    cone = PrimitiveTable()
    cone.cone(Group.BODY, (-0.05, 0, 0), (0.05, 0.02, 0), (0.03, 0.01))
    along = np.linspace(0, 1, 20001)
    centers = np.array([-0.05, 0, 0]) + along[:, None] * np.array([0.1, 0.02, 0])
    brute = [(np.linalg.norm(centers - p, axis=1) - (0.03 - 0.02 * along)).min() for p in points]
    far = np.array(brute) > 0
    assert np.allclose(
        kernels.solid_distances(
            cone.array(), np.arange(1), GROUP_BLEND_M, np.zeros((7, 3)), np.zeros((0, 9)),
            points, 0.001, -1.0, 0,
        )[far],
        np.array(brute)[far],
        atol=1e-8,
    )  # fmt: skip
    box = PrimitiveTable()
    box.box(Group.BODY, (0, 0, 0), (0.05, 0.04, 0.03), 0.01)
    assert distances(box, [[0.06, 0, 0], [0, 0, 0.05]]) == pytest.approx([0.01, 0.02])


def test_a_chain_has_no_beads_and_separate_cones_swell() -> None:
    path = np.column_stack([np.linspace(-0.1, 0.1, 11), np.zeros(11), np.zeros(11)])
    chain, single = PrimitiveTable(), PrimitiveTable()
    chain.chain(Group.BODY, path, 0.02, 0.01)
    for n in range(10):
        single.cone(Group.BODY, path[n], path[n + 1], (0.02, 0.02), 0.01)
    line = np.column_stack([np.linspace(-0.08, 0.08, 33), np.full(33, 0.02), np.zeros(33)])
    assert np.abs(distances(chain, line)).max() < 1e-12
    assert distances(single, line).min() < -0.002


def test_leaving_out_far_primitives_changes_nothing_at_the_surface() -> None:
    solid = statue_solid(np.random.default_rng(5))
    mesh = carved_mesh(solid, 0.012)
    rng = np.random.default_rng(1)
    points = mesh.vertices[rng.integers(0, len(mesh.vertices), 60)]
    radius = 0.02
    every = np.arange(len(solid.table))
    for center in points:
        around = center + rng.uniform(-1, 1, (20, 3)) * radius / np.sqrt(3)
        rows = kernels.relevant_rows(solid.table, center, radius)
        assert len(rows) < 0.3 * len(every)
        full, culled = (
            kernels.solid_distances(
                solid.table, chosen, GROUP_BLEND_M, solid.detail, solid.cracks, around, 0.003,
                1.5 * kernels.WEATHERING_M, solid.seed,
            )
            for chosen in (every, rows)
        )  # fmt: skip
        surface = np.abs(full) < 0.004
        assert np.array_equal(full[surface], culled[surface])


def test_gradient_noise_is_zero_on_its_lattice_bounded_and_smooth() -> None:
    lattice = np.array([[i, j, k] for i in range(-3, 4) for j in range(4) for k in range(4)], float)
    assert np.array_equal(noise_at(lattice * 0.25, 0.25, 9), np.zeros(len(lattice)))
    points = np.random.default_rng(0).uniform(-5, 5, (20000, 3))
    values = noise_at(points, 1.0, 9)
    assert np.abs(values).max() < 1.1
    assert 0.2 < values.std() < 0.35
    assert abs(values.mean()) < 0.02
    step = np.abs(noise_at(points + np.array([1e-4, 0, 0]), 1.0, 9) - values)
    assert step.max() < 4e-4
    assert abs(np.corrcoef(values, noise_at(points, 1.0, 10))[0, 1]) < 0.05
