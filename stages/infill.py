"""A closed surface through the samples, each vertex measured or infilled."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from workbench.metrics import Metric
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.project import Scene
from workbench.project.settings import StageOptions


class InfillOptions(StageOptions):
    """Options of ``infill``."""

    depth: int | Literal["auto"] = Field(
        "auto",
        description="Octree depth of screened Poisson, 5 to 12; auto makes the finest cell "
        "one sample distance (Kazhdan and Hoppe 2013).",
    )
    point_weight: float = Field(
        4.0,
        ge=0.0,
        le=100.0,
        description="Pull of the samples against smoothness (Kazhdan and Hoppe 2013: 4).",
    )
    samples_per_node: float = Field(
        1.5, ge=1.0, le=20.0, description="Samples per finest cell; more for noisy scans."
    )
    refine_rounds: int = Field(
        2,
        ge=0,
        le=10,
        description="Moves of the vertices onto the samples' own surface; 2 take a third off the "
        "error of the octree in about a second (Shen et al. 2004).",
    )
    reach_factor: float = Field(
        1.0,
        gt=0.0,
        le=20.0,
        description="A vertex within this many sample distances of a sample is measured.",
    )
    trim_distance_m: float | None = Field(
        None,
        gt=0.0,
        description="Take away infilled surface further than this from any sample; opens it.",
    )
    threads: int = Field(
        1,
        ge=1,
        le=64,
        description="Threads of the Poisson solver; more than one is faster and not reproducible.",
    )


def needed(scene: Scene, options: InfillOptions) -> Need:
    if scene.geometry:
        return Need(False, "the surface was made elsewhere")
    if not scene.scans:
        return Need(False, "no range scans")
    return Need(True, "a closed surface to make, in one block")


def estimate(scene: Scene, options: InfillOptions) -> Estimate:
    depth = 10 if options.depth == "auto" else options.depth
    # A surface meets about 4^depth · 1.5 finest cells at most; the solver keeps some 600 bytes
    # for each, and no more cells are opened than there are samples to fill them.
    cells = min(1.5 * 4**depth, 20.0 * scene.scan_bytes / 16)
    return Estimate(int(600 * cells) + 2**29, int(100 * cells) + 2**24)


def run(job: Job[InfillOptions]) -> StageResult:
    from workbench.geometry.mesh import edge_census, face_normals_and_areas, vertex_normals
    from workbench.geometry.samples import Samples
    from workbench.surface.closing import closed_at_box
    from workbench.surface.poisson import (
        PoissonSettings,
        cell_size_m,
        depth_for_spacing,
        reconstruct,
    )
    from workbench.surface.provenance import (
        area_by_provenance,
        near_samples,
        support_of,
        without_unmeasured_pieces,
    )
    from workbench.surface.refinement import moved_onto_samples

    products, options = job.products, job.options
    arrays = products.load("samples")
    samples = Samples(**arrays)
    depth = options.depth
    if depth == "auto":
        depth = depth_for_spacing(samples.points, float(np.median(samples.radius_m)))
    settings = PoissonSettings(
        depth, options.point_weight, options.samples_per_node, options.threads
    )
    with job.progress.step(f"screened Poisson at depth {depth}"):
        mesh = reconstruct(samples.points, samples.normals, settings)
    cell = cell_size_m(samples.points, depth)
    cut = not edge_census(mesh.triangles).watertight
    if cut:
        low, high = samples.points.min(axis=0) - cell, samples.points.max(axis=0) + cell
        mesh = closed_at_box(mesh, low, high)
    with job.progress.step("measured or infilled"):
        mesh = moved_onto_samples(mesh, samples, options.refine_rounds)
        mesh = mesh.with_attributes(normal=vertex_normals(mesh))
        support = support_of(
            mesh.vertices, mesh.vertex_attributes["normal"], samples, options.reach_factor
        )
        keep, pieces = without_unmeasured_pieces(mesh, support.provenance)
        color = None if samples.color is None else samples.color[support.nearest]
        mesh = mesh.with_attributes(
            provenance=support.provenance,
            distance_to_samples_m=support.distance_m,
        )
        if color is not None:
            mesh = mesh.with_attributes(color=color)
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
    products.save("surface", mesh)
    _, areas = face_normals_and_areas(mesh)
    provenance = mesh.vertex_attributes["provenance"]
    metrics = (
        Metric("depth", depth, "", "Octree depth of the reconstruction."),
        Metric("cell_size", cell, "m", "Edge of its finest cell."),
        Metric("cut_at_box", cut, "",
               "Whether the surface ran on beyond the samples' box and was cut and capped there."),
        Metric("vertices", len(mesh.vertices), "", "Vertices of the surface."),
        Metric("triangles", len(mesh.triangles), "", "Triangles of the surface."),
        Metric("watertight", census.watertight, "", "Whether every edge has exactly two faces.",
               ("==", 1) if options.trim_distance_m is None else None),
        Metric("measured_area", area_by_provenance(mesh, provenance, areas), "",
               "Share of the area that rests on samples."),
        Metric("unmeasured_pieces", pieces, "",
               "Separate pieces without any sample, taken away."),
    )  # fmt: skip
    return StageResult(metrics, tuple(warnings))


INFILL = Stage[Any](
    name="infill",
    version=1,
    summary="Screened Poisson closes the surface; every vertex says measured or infilled.",
    options=InfillOptions,
    reads=("samples",),
    writes=("surface",),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "pymeshlab"),
    estimate=estimate,
)
