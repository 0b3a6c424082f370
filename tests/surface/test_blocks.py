"""Surfaces solved in blocks: closed, without seams, and as good as in one piece."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from bodies import sphere_samples, without

from workbench.cloud.sample_source import HeldSamples
from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.geometry.samples import Samples
from workbench.surface.block_field import BlendedField, BlockSolution, SurfaceDistance
from workbench.surface.block_plan import BlockPlan, bricks_held, lattice_for, plan_blocks
from workbench.surface.blocks import (
    SurfacePart,
    bricks_missed,
    coarse_solution,
    joined,
    part_of_block,
    solved_block,
)
from workbench.surface.poisson import PoissonSettings
from workbench.surface.provenance import MEASURED

COUNT, NOISE = 16_000, 0.003
SPACING = float(np.sqrt(4 * np.pi / COUNT))
SETTINGS = PoissonSettings(8)


def ball_with_a_hole() -> Samples:
    samples = sphere_samples(COUNT, noise=NOISE)
    return without(samples, samples.normals[:, 2] > 0.95)


def plan_for(samples: Samples, most: int) -> tuple[BlockPlan, TriangleMesh, float]:
    low, high = samples.bounds
    thinned = HeldSamples(samples).thinned(len(samples) // 2)
    coarse = coarse_solution(thinned, 1.4 * SPACING, low, high, SETTINGS)
    vertices = coarse.mesh.vertices
    lattice = lattice_for(
        np.minimum(low, vertices.min(axis=0)), np.maximum(high, vertices.max(axis=0)), SPACING
    )
    bricks, held = bricks_held(lattice, [samples.points], vertices)
    return plan_blocks(lattice, SPACING, bricks, held, most), coarse.mesh, coarse.cell_m


def parts_of(samples: Samples, plan: BlockPlan, coarse: TriangleMesh, coarse_cell_m: float):
    source = HeldSamples(samples)
    around = {plan.name(b): source.within(*plan.solved(b)) for b in plan.blocks}
    solutions = {}
    for block in plan.blocks:
        mesh = solved_block(plan, block, around[plan.name(block)], SETTINGS)
        if mesh is not None:
            surface = SurfaceDistance(mesh, mesh.vertex_attributes["apart_m"])
            solutions[plan.name(block)] = BlockSolution(block, surface)
    seeds = np.concatenate([samples.points, coarse.vertices])
    numbers = np.unique(plan.lattice.numbers_of(seeds))
    for block in plan.blocks:
        near = [plan.name(b) for b in plan.neighbours(block)]
        field = BlendedField(
            plan,
            SPACING,
            [solutions[n] for n in near if n in solutions],
            SurfaceDistance(coarse),
            coarse_cell_m,
            None,
        )
        yield part_of_block(plan, block, field, around[plan.name(block)], numbers, 2, 1.0)


Cut = tuple[BlockPlan, Sequence[SurfacePart]]


@pytest.fixture(scope="module")
def cut() -> Cut:
    samples = ball_with_a_hole()
    plan, coarse, cell = plan_for(samples, 7_000)
    return plan, list(parts_of(samples, plan, coarse, cell))


@pytest.fixture(scope="module")
def mesh(cut: Cut) -> TriangleMesh:
    return joined(cut[1])


def error_m(vertices: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.norm(vertices, axis=1) - 1.0)


def test_blocks_close_into_one_surface(cut: Cut, mesh: TriangleMesh) -> None:
    plan, parts = cut
    assert len(plan.blocks) >= 8
    assert not len(bricks_missed(parts))
    assert edge_census(mesh.triangles).watertight
    provenance = mesh.vertex_attributes["provenance"]
    assert (provenance[mesh.vertices[:, 2] < 0.93] == MEASURED).mean() > 0.995
    assert (provenance[mesh.vertices[:, 2] > 0.975] == MEASURED).sum() == 0


def test_no_seam_is_seen_where_blocks_meet(cut: Cut, mesh: TriangleMesh) -> None:
    """Near the faces between blocks the surface is as true, and as smooth, as elsewhere."""
    plan, _ = cut
    measured = mesh.vertex_attributes["provenance"] == MEASURED
    edge = plan.block_bricks * plan.lattice.brick_m
    place = (mesh.vertices - plan.lattice.low) / edge
    to_face = edge * np.abs(place - np.round(place)).min(axis=1)
    near = measured & (to_face < SPACING)
    far = measured & (to_face > 4 * SPACING)
    assert near.sum() > 500
    rms_near, rms_far = (np.sqrt(np.mean(error_m(mesh.vertices[k]) ** 2)) for k in (near, far))
    assert rms_near < 1.05 * rms_far
    normals = mesh.vertex_attributes["normal"]
    way = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    tilt = np.degrees(np.arccos(np.clip(np.einsum("nd,nd->n", normals, way), -1, 1)))
    assert np.percentile(tilt[near], 95) < 1.05 * np.percentile(tilt[far], 95)


def test_noise_is_averaged_as_in_one_piece(mesh: TriangleMesh) -> None:
    measured = mesh.vertices[mesh.vertex_attributes["provenance"] == MEASURED]
    assert np.sqrt(np.mean(error_m(measured) ** 2)) < 0.6 * NOISE


def test_vertices_on_faces_are_there_once(cut: Cut, mesh: TriangleMesh) -> None:
    _, parts = cut
    keys = np.concatenate([part.keys for part in parts])
    assert len(mesh.vertices) == len(np.unique(keys)) < len(keys)
    assert sum(len(part.mesh.triangles) for part in parts) == len(mesh.triangles)


def test_a_part_survives_storing(cut: Cut) -> None:
    part = cut[1][0]
    again = SurfacePart.from_arrays(part.arrays())
    assert joined([again]).vertex_attributes.keys() == part.mesh.vertex_attributes.keys()
    for name, values in part.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], values)


def test_bricks_entered_and_not_looked_at_are_told(cut: Cut) -> None:
    _, parts = cut
    missed = bricks_missed(parts[1:])
    assert len(missed)
    assert np.isin(missed, parts[0].looked_at).any()


def test_a_plan_survives_storing(cut: Cut) -> None:
    plan = cut[0]
    again = BlockPlan.from_dict(plan.as_dict())
    assert again.as_dict() == plan.as_dict()
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    np.testing.assert_array_equal(
        again.weight(again.blocks[1], points), plan.weight(plan.blocks[1], points)
    )


def test_somebody_has_a_say_everywhere_and_fades_out(cut: Cut) -> None:
    plan, _ = cut
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (2000, 3))
    say = np.array([plan.weight(block, points) for block in plan.blocks])
    assert say.sum(axis=0).min() > 0.1
    for block, weight in zip(plan.blocks, say, strict=True):
        low, high = plan.used(block)
        outside = ((points < low) | (points > high)).any(axis=1)
        assert (weight[outside] == 0).all()
        assert (weight[~outside] > 0).all()


def test_blocks_are_as_large_as_samples_allow() -> None:
    samples = sphere_samples(COUNT)
    sizes = []
    for most in (2_000, 7_000, 10**6):
        plan, _, _ = plan_for(samples, most)
        sizes.append(plan.block_bricks)
        source = HeldSamples(samples)
        fullest = max(len(source.within(*plan.solved(b))) for b in plan.blocks)
        assert fullest <= most or plan.block_bricks == 4
    assert sizes[0] < sizes[1] < sizes[2]


def test_too_few_samples_make_no_solution() -> None:
    samples = ball_with_a_hole()
    plan, _, _ = plan_for(samples, 7_000)
    few = samples.chosen(np.arange(50))
    assert solved_block(plan, plan.blocks[0], few, SETTINGS) is None
