"""A closed surface through the samples, each vertex measured or infilled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.infill.options import InfillOptions
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.hashing import hash_of_value
from workbench.project.project import Scene

if TYPE_CHECKING:
    from workbench.cloud.sample_source import SampleSource
    from workbench.geometry.mesh import TriangleMesh
    from workbench.geometry.samples import Samples
    from workbench.surface.block_plan import BlockPlan
    from workbench.surface.blocks import CoarseSolution, SurfacePart
    from workbench.surface.poisson import PoissonSettings

# The whole is solved from so many samples at most where it does not fit in one block.
_MOST_COARSE_SAMPLES = 500_000
_LEAST_COARSE_SHARE = 2
# Less is an open scene's; and how far from its samples, in their distances, it may go on.
_LEAST_MEASURED, _NEAR_SPACINGS = 0.5, 10.0


def needed(scene: Scene, options: InfillOptions) -> Need:
    if scene.geometry:
        return Need(False, "the surface was made elsewhere")
    if not scene.has_surface:
        return Need(False, "neither range scans nor three photographs")
    return Need(True, "a closed surface to make")


def estimate(scene: Scene, options: InfillOptions) -> Estimate:
    depth = 10 if options.depth == "auto" else options.depth
    # A surface meets about 4^depth · 1.5 finest cells at most; the solver keeps some 600 bytes
    # for each, and no more cells are opened than there are samples to fill them.
    samples = scene.shape_bytes / 16
    # Depths of photographs scatter by more than a cell and open several layers of them.
    layers = 4.5 if scene.shape_from_photos else 1.5
    cells = min(layers * 4**depth, 20.0 * samples)
    at_once = min(cells, 20.0 * options.block_samples)
    memory = int(600 * at_once + 60 * samples) + 2**29
    # Blocks are solved side by side, where there are any.
    block = int(600 * at_once) if samples > options.block_samples else 0
    return Estimate(memory, int(100 * cells) + 2**24, item_bytes=block)


def run(job: Job[InfillOptions]) -> StageResult:
    from workbench.geometry.mesh import edge_census
    from workbench.surface.poisson import (
        MAX_DEPTH,
        PoissonSettings,
        cell_size_m,
        depth_for_spacing,
    )
    from workbench.surface.provenance import (
        measured_area_share,
        near_samples,
        without_unmeasured_pieces,
    )

    products, options = job.products, job.options
    artefact = "samples" if products.load_if_there("sample_cloud") is None else "sample_cloud"
    with stored_samples(products, artefact) as source:
        count, (low, high) = len(source), source.bounds
        spacing = float(np.median(source.thinned(options.block_samples).radius_m))
        depth = options.depth
        if depth == "auto":
            depth = depth_for_spacing(low, high, spacing)
        in_one = count <= options.block_samples and depth <= MAX_DEPTH
        # Blocks have cubes of their own, which need not halve that of the whole.
        exact = options.depth == "auto" and not in_one
        cell = spacing if exact else cell_size_m(low, high, depth)
        settings = PoissonSettings(
            depth, options.point_weight, options.samples_per_node, options.threads
        )
        if in_one:
            samples = source.thinned(count)
        else:
            plan, coarse = planned(job, source, cell, spacing, settings)
    if in_one:
        mesh, metrics = in_one_block(job, samples, cell, settings)
    else:
        # The blocks open the samples themselves, each where it is worked at.
        mesh, metrics = in_blocks(job, artefact, plan, coarse, spacing, settings)
    keep, pieces = without_unmeasured_pieces(mesh, mesh.vertex_attributes["provenance"])
    if pieces:  # A large surface is not copied for nothing.
        mesh = mesh.keep_triangles(keep)
    if options.trim_distance_m is not None:
        distance = mesh.vertex_attributes["distance_to_samples_m"]
        mesh = mesh.keep_triangles(near_samples(mesh, distance, options.trim_distance_m))
    census = edge_census(mesh.triangles)
    warnings = []
    if not census.watertight and options.trim_distance_m is None:
        warnings.append(
            f"the surface is not closed: {census.boundary_edges} open, "
            f"{census.nonmanifold_edges} non-manifold edges; try another infill.depth"
        )
    measured = measured_area_share(mesh)
    if options.trim_distance_m is None:
        warnings += open_scene(measured, spacing)
    products.save("surface", mesh)
    metrics = (
        Metric("samples", count, "", "Samples the surface was made from."),
        Metric("depth", depth, "", "Octree depth of the reconstruction."),
        Metric("cell_size", cell, "m", "Edge of its finest cell."),
        *metrics,
        Metric("vertices", len(mesh.vertices), "", "Vertices of the surface."),
        Metric("triangles", len(mesh.triangles), "", "Triangles of the surface."),
        Metric("watertight", census.watertight, "", "Whether every edge has exactly two faces.",
               ("==", 1) if options.trim_distance_m is None else None),
        Metric("measured_area", measured, "",
               "Share of the area that rests on samples."),
        Metric("unmeasured_pieces", pieces, "",
               "Separate pieces without any sample, taken away."),
    )  # fmt: skip
    # What a next run could use again is the surface itself; blocks take more room than that.
    return StageResult(metrics, tuple(warnings), passing=("block_surfaces", "surface_parts"))


def open_scene(measured: float, spacing_m: float) -> list[str]:
    """What to do where a closed surface is mostly invented, as behind a façade.

    Parameters
    ----------
    measured : share of the area that rests on samples.
    spacing_m : between samples.
    """
    from workbench.verification.quantities import round_up_125

    if measured >= _LEAST_MEASURED:
        return []
    near = round_up_125(_NEAR_SPACINGS * spacing_m)
    return [
        f"only {100.0 * measured:.0f} % of the surface was measured, for it was closed: of a scene "
        f"that is open, as façades are, --set infill.trim_distance_m={near:g} keeps what is near "
        "samples"
    ]


def stored_samples(products: Any, artefact: str) -> AbstractContextManager[SampleSource]:
    """The consolidated samples, in memory or on disk."""
    from workbench.cloud.sample_source import opened_samples

    held = products.load(artefact)
    return opened_samples(held, None) if artefact == "samples" else opened_samples(None, held)


def in_one_block(
    job: Job[InfillOptions], samples: Samples, cell_m: float, settings: PoissonSettings
) -> tuple[TriangleMesh, tuple[Metric, ...]]:
    """One solution of all samples, with what the samples say about its vertices."""
    from workbench.geometry.mesh import edge_census, vertex_normals
    from workbench.surface.closing import closed_at_box
    from workbench.surface.poisson import reconstruct
    from workbench.surface.provenance import told_by_samples
    from workbench.surface.refinement import moved_onto_samples

    with job.progress.step(f"screened Poisson at depth {settings.depth}"):
        mesh = reconstruct(samples.points, samples.normals, settings)
    cut = not edge_census(mesh.triangles).watertight
    if cut:
        low, high = samples.bounds
        mesh = closed_at_box(mesh, low - cell_m, high + cell_m)
    with job.progress.step("measured or infilled"):
        mesh = moved_onto_samples(mesh, samples, job.options.refine_rounds)
        mesh = mesh.with_attributes(normal=vertex_normals(mesh))
        mesh = told_by_samples(mesh, samples, job.options.reach_factor)
    return mesh, _solution_metrics(1, cut)


def planned(
    job: Job[InfillOptions],
    source: SampleSource,
    cell_m: float,
    spacing_m: float,
    settings: PoissonSettings,
) -> tuple[BlockPlan, CoarseSolution]:
    """One coarse solution of the whole, and the blocks to solve finely; both are stored."""
    from workbench.surface.block_plan import bricks_held, lattice_for, plan_blocks
    from workbench.surface.blocks import coarse_solution

    count, (low, high) = len(source), source.bounds
    thinned = source.thinned(min(_MOST_COARSE_SAMPLES, count // _LEAST_COARSE_SHARE))
    apart = spacing_m * float(np.sqrt(count / len(thinned)))
    with job.progress.step("one coarse solution of the whole"):
        coarse = coarse_solution(thinned, apart, low, high, settings)
    vertices = coarse.mesh.vertices
    lattice = lattice_for(
        np.minimum(low, vertices.min(axis=0)), np.maximum(high, vertices.max(axis=0)), cell_m
    )
    bricks, held = bricks_held(lattice, source.places(), vertices)
    plan = plan_blocks(lattice, cell_m, bricks, held, job.options.block_samples)
    job.products.save("coarse_surface", coarse.mesh)
    job.products.save("block_plan", plan.as_dict())
    return plan, coarse


def in_blocks(
    job: Job[InfillOptions],
    artefact: str,
    plan: BlockPlan,
    coarse: CoarseSolution,
    spacing_m: float,
    settings: PoissonSettings,
) -> tuple[TriangleMesh, tuple[Metric, ...]]:
    """The same in blocks that overlap, blended into one surface."""
    from workbench.surface.blocks import bricks_missed, joined

    products, options = job.products, job.options
    names = {plan.name(block): block.tolist() for block in plan.blocks}
    shared = {
        "plan": hash_of_value(plan.as_dict()),
        "samples": artefact,
        "content": products.content_hash(artefact),
    }
    solving = shared | {"settings": asdict(settings)}
    products.remove_items_except("block_surfaces", set(names))
    found = job.tasks.map_items(
        "screened Poisson in blocks",
        solve_block,
        {name: solving | {"name": name, "block": block} for name, block in names.items()},
    )
    cutting = shared | {
        "coarse": products.content_hash("coarse_surface"),
        "coarse_cell_m": coarse.cell_m,
        "box": None if coarse.box is None else [corner.tolist() for corner in coarse.box],
        "spacing_m": spacing_m,
        "refine_rounds": options.refine_rounds,
        "reach_factor": options.reach_factor,
    }
    solved = {name for name, summary in found.items() if summary["solved"]}
    missed: dict[str, list[int]] = {}
    more: Any = None
    # Again where the surface runs on into bricks that nobody expected it in.
    while more is None or len(more):
        items = {
            name: cutting
            | {
                "name": name,
                "block": block,
                "seeds": missed.get(name, []),
                "solutions": {
                    beside: products.content_hash("block_surfaces", beside)
                    for beside in map(plan.name, plan.neighbours(np.array(block)))
                    if beside in solved
                },
            }
            for name, block in names.items()
        }
        products.remove_items_except("surface_parts", set(names))
        job.tasks.map_items("surface of each block", cut_block, items)
        parts = StoredParts(products, tuple(names))
        more = bricks_missed(parts)
        for block, numbers in plan.by_block(more):
            names[plan.name(block)] = block.tolist()
            missed[plan.name(block)] = sorted(
                {*missed.get(plan.name(block), []), *numbers.tolist()}
            )
    mesh = joined(parts)
    return mesh, _solution_metrics(len(names), coarse.box is not None, len(found) - len(solved))


class StoredParts:
    """The parts of all blocks, one in memory at a time."""

    def __init__(self, products: Any, names: tuple[str, ...]) -> None:
        self._products, self._names = products, names

    def __iter__(self) -> Iterator[SurfacePart]:
        from workbench.surface.blocks import SurfacePart

        for name in self._names:
            yield SurfacePart.from_arrays(self._products.load("surface_parts", name))


def solve_block(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One block's own solution, where its samples allow one."""
    from workbench.surface.block_plan import BlockPlan
    from workbench.surface.blocks import solved_block
    from workbench.surface.poisson import PoissonSettings

    plan = BlockPlan.from_dict(products.load("block_plan"))
    block = np.array(payload["block"])
    with stored_samples(products, payload["samples"]) as source:
        samples = source.within(*plan.solved(block))
    mesh = solved_block(plan, block, samples, PoissonSettings(**payload["settings"]))
    if mesh is not None:
        products.save("block_surfaces", mesh, payload["name"])
    return {"samples": len(samples), "solved": mesh is not None}


def cut_block(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """The part of the surface within one block."""
    from workbench.surface.block_field import BlendedField, BlockSolution, SurfaceDistance
    from workbench.surface.block_plan import BlockPlan
    from workbench.surface.blocks import part_of_block

    plan = BlockPlan.from_dict(products.load("block_plan"))
    block = np.array(payload["block"])
    solutions = []
    for beside in plan.neighbours(block):
        if plan.name(beside) in payload["solutions"]:
            mesh = products.load("block_surfaces", plan.name(beside))
            surface = SurfaceDistance(mesh, mesh.vertex_attributes["apart_m"])
            solutions.append(BlockSolution(beside, surface))
    coarse = products.load("coarse_surface")
    box = payload["box"]
    field = BlendedField(
        plan,
        payload["spacing_m"],
        solutions,
        SurfaceDistance(coarse),
        payload["coarse_cell_m"],
        None if box is None else (np.array(box[0]), np.array(box[1])),
    )
    with stored_samples(products, payload["samples"]) as source:
        samples = source.within(*plan.solved(block))
    seeds = np.concatenate(
        [
            plan.lattice.numbers_of(samples.points),
            plan.lattice.numbers_of(coarse.vertices),
            np.array(payload["seeds"], np.int64),
        ]
    )
    part = part_of_block(
        plan,
        block,
        field,
        samples,
        np.unique(seeds),
        payload["refine_rounds"],
        payload["reach_factor"],
    )
    products.save("surface_parts", part.arrays(), payload["name"])
    return {"triangles": len(part.mesh.triangles)}


def _solution_metrics(blocks: int, cut: bool, unsolved: int = 0) -> tuple[Metric, ...]:
    return (
        Metric("blocks", blocks, "", "Solved one by one and blended; 1: all fits at once."),
        Metric("blocks_on_coarse_solution", unsolved, "",
               "Blocks with too few samples for a solution of their own."),
        Metric("cut_at_box", cut, "",
               "Whether the surface ran on beyond the samples' box and was cut and capped there."),
    )  # fmt: skip


INFILL = Stage[Any](
    name="infill",
    version=3,
    summary="Screened Poisson closes the surface; every vertex says measured or infilled.",
    options=InfillOptions,
    reads=("samples", "sample_cloud"),
    writes=("coarse_surface", "block_plan", "block_surfaces", "surface_parts", "surface"),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "pymeshlab"),
    estimate=estimate,
    knobs=(
        Knob("depth", (6, 7, 8, 9, 10), quick=(6, 7)),
        Knob("refine_rounds", (0, 1, 2, 4), quick=(0,)),
    ),
)
