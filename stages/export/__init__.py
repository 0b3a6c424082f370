"""The surface in the formats other tools open, back in the user's own coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.export.clouds import write_clouds
from stages.export.levels import write_levels
from stages.export.options import ExportOptions
from stages.export.textured import write_textured
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.project import NO_SURFACE, Scene

# Voxels of a surface for each of a face of the cube around it, measured on a mask and a bunny;
# bytes of each: of a file of levels, of a graph in memory and in its file, coloured.
_VOXELS_OF_SQUARE = 4
_LEVEL_BYTES, _GRAPH_MEMORY, _GRAPH_BYTES = 16, 60, 5
# Of a surfel in each of the levels of its tree; of a coded cell in memory and in its file.
_SURFEL_BYTES, _CELL_MEMORY, _CELL_BYTES = 100, 120, 8

# All else is left out while one kind of levels is swept.
_ALONE = {
    **dict.fromkeys(("ply", "obj", "glb", "textured_glb", "textured_obj"), False),
    "voxels": "none",
    "surfels": 0,
    "cells": "none",
    "clouds": (),
}
_VOXELS, _SURFELS = _ALONE | {"voxels": "voxels"}, _ALONE | {"surfels": 30_000}


def needed(scene: Scene, options: ExportOptions) -> Need:
    formats = (options.ply, options.obj, options.glb, options.textured_glb, options.textured_obj)
    levels = (options.voxels != "none", options.surfels, options.cells != "none", options.clouds)
    if not any(formats) and not any(levels):
        return Need(False, "no format asked for")
    if scene.has_surface:
        return Need(True, "a surface to hand on")
    return Need(False, f"no surface: {NO_SURFACE}")


def estimate(scene: Scene, options: ExportOptions) -> Estimate:
    memory, disk = 6 * scene.shape_bytes + 2**28, 6 * scene.shape_bytes + 2**24
    # The pages of the atlas, as pictures and as they are packed.
    memory += 2**31 if scene.photos else 0
    if options.voxels != "none":
        voxels = _VOXELS_OF_SQUARE * options.voxel_resolution**2
        memory += 0 if options.voxels == "voxels" else _GRAPH_MEMORY * voxels
        disk += (_LEVEL_BYTES if options.voxels == "voxels" else _GRAPH_BYTES) * voxels
    if options.surfels:
        memory, disk = memory + 2**31, disk + _SURFEL_BYTES * options.surfels
    if options.cells != "none":
        cells = _VOXELS_OF_SQUARE * options.cell_resolution**2
        memory, disk = memory + _CELL_MEMORY * cells, disk + _CELL_BYTES * cells
    return Estimate(memory, disk)


def run(job: Job[ExportOptions]) -> StageResult:
    from workbench.formats.surface_files import (
        write_surface_glb,
        write_surface_obj,
        write_surface_ply,
    )

    products, options = job.products, job.options
    mesh = products.load_if_there("surface")
    inventory = products.load_if_there("scan_inventory")
    origin = np.array(inventory["origin_m"]) if inventory else np.zeros(3)
    if mesh is None:
        mesh = _geometry(job)
    color = products.load_if_there("surface_color")
    colored = color is not None or "color" in mesh.vertex_attributes
    mesh = _with_color(mesh, color)
    moved = replace(mesh, vertices=mesh.vertices + origin)
    with job.progress.step("writing exports"):
        if options.ply:
            with products.writing("surface_ply") as path:
                write_surface_ply(path, moved)
        if options.obj:
            with products.writing("surface_obj") as path:
                write_surface_obj(path, moved)
        if options.glb:
            with products.writing("surface_glb") as path:
                write_surface_glb(path, mesh, world_from_local_origin=tuple(origin))
    formats = options.ply + options.obj + options.glb + write_textured(job, origin)
    files, levels = write_levels(job, moved, colored)
    clouds = write_clouds(job, origin)
    return StageResult(
        (
            Metric("formats", formats + files + len(clouds), "", "Files written."),
            Metric("triangles", len(mesh.triangles), "", "Triangles in each."),
            *levels,
            *clouds,
        )
    )


def _with_color(mesh: TriangleMesh, told: Mapping[str, NDArray[Any]] | None) -> TriangleMesh:
    """The mesh with the colour attributes every export carries; grey where there is none.

    Parameters
    ----------
    told : linear colour of each vertex and where it is from, as ``color`` found it.
    """
    from workbench.surface.provenance import UNCOLORED

    n, has = len(mesh.vertices), mesh.vertex_attributes
    color = has.get("color", np.full((n, 3), 200, np.uint8))
    provenance = has.get("color_provenance", np.full(n, UNCOLORED, np.uint8))
    if told is not None:
        from workbench.color.blending_display import encoded_srgb

        provenance = told["color_provenance"]
        known = provenance != UNCOLORED
        color = np.array(color, np.uint8)
        color[known] = encoded_srgb(told["color"][known], str(told["space"]))  # type: ignore[arg-type]
    return mesh.with_attributes(color=color, color_provenance=provenance)


def _geometry(job: Job[ExportOptions]) -> Any:
    """The surface made elsewhere, nothing of it known to be measured here."""
    from workbench.formats.surface_files import read_surface
    from workbench.geometry.mesh import vertex_normals

    paths = job.products.input_paths("geometry_file")
    if not paths:
        raise InputError("There is no surface to export", fix="run infill, or give --geometry")
    mesh = read_surface(paths[0])
    if "normal" not in mesh.vertex_attributes:
        mesh = mesh.with_attributes(normal=vertex_normals(mesh))
    return mesh


EXPORT = Stage(
    name="export",
    version=4,
    summary="PLY, OBJ, GLB with all that is known; texture; voxels, surfels, points; "
    "in your coordinates.",
    options=ExportOptions,
    reads=(
        *("surface", "surface_color", "scan_inventory", "geometry_file"),
        *("texture_atlas", "texture_pages", "samples", "sample_cloud", "colored_cloud", "flash"),
    ),
    writes=(
        *("surface_ply", "surface_obj", "surface_glb"),
        *("textured_glb", "textured_obj", "textured_mtl", "textured_pages"),
        *("voxel_lod", "voxel_graph", "surfels", "point_cubes"),
        *("points_laz", "points_las", "points_copc", "points_e57", "points_ply"),
        *("potree_metadata", "potree_hierarchy", "potree_octree"),
    ),
    needed=needed,
    run=run,
    libraries=("numpy", "colour-science", "opencv-contrib-python-headless"),
    estimate=estimate,
    knobs=(
        Knob("voxel_resolution", (128, 256, 512, 1024, 2048), (128, 256, 512), _VOXELS, "voxels"),
        Knob("surfels", (3000, 10_000, 30_000, 100_000), (3000, 10_000), _SURFELS, "surfels"),
        Knob("surfel_candidates_px", (128, 256, 512, 1024), (), _SURFELS, "surfels"),
    ),
)
