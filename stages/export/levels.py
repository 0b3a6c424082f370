"""Levels of detail and coded points of the surface, where the export asks for them."""

from __future__ import annotations

from dataclasses import replace

from stages.export.options import ExportOptions
from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.pipeline.stage import Job


def write_levels(
    job: Job[ExportOptions], mesh: TriangleMesh, colored: bool
) -> tuple[int, list[Metric]]:
    """Voxels, surfels and coded points that are wanted; how many files, and what is told of them.

    Parameters
    ----------
    mesh : the surface in the user's coordinates.
    colored : whether its colours are known anywhere.
    """
    # Of all attributes they have the colour alone, and grey for all would say nothing.
    shown = {"color": mesh.vertex_attributes["color"]} if colored else {}
    bare = replace(mesh, vertex_attributes=shown)
    metrics: list[Metric] = []
    files = 0
    for write in (_voxels, _surfels, _cells):
        told = write(job, bare)
        files += bool(told)
        metrics += told
    return files, metrics


def _voxels(job: Job[ExportOptions], mesh: TriangleMesh) -> list[Metric]:
    from workbench.voxels.lod_export import LodOptions
    from workbench.voxels.surface_export import write_surface_voxels

    products, options = job.products, job.options
    if options.voxels == "none":
        return []
    thin = options.voxels == "voxels"
    given = LodOptions(
        resolution=options.voxel_resolution,
        subset="thin" if thin else "conservative",
        workers=job.tasks.workers,
    )
    with (
        job.progress.step(f"cutting the surface into {options.voxel_resolution}³ voxels"),
        products.writing("voxel_lod" if thin else "voxel_graph") as path,
    ):
        told = write_surface_voxels(mesh, path, options.voxels, given)
    return [
        Metric("voxels", told["voxels"], "", "Voxels of the finest level."),
        Metric("voxel_size", told["voxel_size"], "m", "Side of a voxel."),
        Metric("voxel_file", told["bytes"] / 1e6, "MB", "The file of voxels."),
        Metric("voxel_bits", 8.0 * told["bytes"] / told["voxels"], "bits",
               "Size of that file for each voxel, colours included."),
    ]  # fmt: skip


def _surfels(job: Job[ExportOptions], mesh: TriangleMesh) -> list[Metric]:
    from workbench.surfels.surfel_export import export_surfels
    from workbench.surfels.surfel_options import SurfelOptions

    products, options = job.products, job.options
    if not options.surfels:
        return []
    given = SurfelOptions(
        count=options.surfels,
        candidates_resolution=options.surfel_candidates_px,
        workers=job.tasks.workers,
    )
    with job.progress.step("choosing surfels"), products.writing("surfels") as path:
        told = export_surfels(mesh, path, given)
    return [
        Metric("surfels", told["items"], "", "Surfels of all nodes."),
        Metric("surfel_nodes", told["nodes"], "", "Nodes of their tree."),
        Metric("surfel_distance", told["median_distance"], "m",
               "Median distance of the whole object's surfels to their nearest."),
        Metric("surfel_file", told["bytes"] / 1e6, "MB", "The file of surfels."),
    ]  # fmt: skip


def _cells(job: Job[ExportOptions], mesh: TriangleMesh) -> list[Metric]:
    from workbench.pipeline.surface_cells import surface_cells
    from workbench.pointcodecs.cube_file import write_point_cubes

    products, options = job.products, job.options
    if options.cells == "none":
        return []
    with (
        job.progress.step(f"coding the surface as points of {options.cell_resolution}³ cells"),
        products.writing("point_cubes") as path,
    ):
        cells = surface_cells(mesh, options.cell_resolution, workers=job.tasks.workers)
        told = write_point_cubes(path, cells, options.cells)
    return [
        Metric("cells", told["points"], "", "Cells that the surface fills."),
        Metric("cell_size", cells.frame.cell_size, "m", "Side of a cell."),
        Metric("cell_bits", told["bits_per_point"], "bits", "Size of the places for each cell."),
        Metric("cell_file", told["bytes"] / 1e6, "MB", "Their file, with colours and normals."),
    ]  # fmt: skip
