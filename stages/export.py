"""The surface in the formats other tools open, back in the user's own coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.pipeline.stage import Estimate, Job, Need, Products, Stage, StageResult
from workbench.project.project import Scene
from workbench.project.settings import StageOptions

# Voxels of a surface for each of a face of the cube around it, measured on a mask and a bunny;
# bytes of each: of a file of levels, of a graph in memory and in its file, coloured.
_VOXELS_OF_SQUARE = 4
_LEVEL_BYTES, _GRAPH_MEMORY, _GRAPH_BYTES = 16, 60, 5


class ExportOptions(StageOptions):
    """Options of ``export``."""

    ply: bool = Field(True, description="Write exports/surface.ply with every attribute.")
    obj: bool = Field(True, description="Write exports/surface.obj.")
    glb: bool = Field(True, description="Write exports/surface.glb.")
    textured_glb: bool = Field(
        True, description="Write exports/textured.glb, where photographs texture the surface."
    )
    textured_obj: bool = Field(
        True, description="Write exports/textured/textured.obj with its materials and pictures."
    )
    pictures: Literal["jpeg", "png"] = Field(
        "jpeg", description="Pictures inside textured.glb; those of the OBJ are PNG, without loss."
    )
    picture_quality: int = Field(95, ge=1, le=100, description="Quality of JPEG.")
    voxels: Literal["none", "voxels", "svdag", "ssvdag", "osvdag"] = Field(
        "none",
        description="Write exports/voxels.vlod, levels of detail, or a sparse voxel graph, "
        "exports/voxels.voxgraph.",
    )
    voxel_resolution: Literal[64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384] = Field(
        1024, description="Voxels along the side of the cube around the surface."
    )


def needed(scene: Scene, options: ExportOptions) -> Need:
    formats = (options.ply, options.obj, options.glb, options.textured_glb, options.textured_obj)
    if not any(formats) and options.voxels == "none":
        return Need(False, "no format asked for")
    if scene.scans or scene.geometry:
        return Need(True, "a surface to hand on")
    return Need(False, "no surface: neither scans nor geometry")


def estimate(scene: Scene, options: ExportOptions) -> Estimate:
    memory, disk = 6 * scene.scan_bytes + 2**28, 6 * scene.scan_bytes + 2**24
    if options.voxels == "none":
        return Estimate(memory, disk)
    voxels = _VOXELS_OF_SQUARE * options.voxel_resolution**2
    if options.voxels == "voxels":
        return Estimate(memory, disk + _LEVEL_BYTES * voxels)
    return Estimate(memory + _GRAPH_MEMORY * voxels, disk + _GRAPH_BYTES * voxels)


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
    formats = options.ply + options.obj + options.glb + _textured(job, mesh, origin)
    voxels = _voxels(job, moved, colored)
    return StageResult(
        (
            Metric("formats", formats + bool(voxels), "", "Files written."),
            Metric("triangles", len(mesh.triangles), "", "Triangles in each."),
            *voxels,
        )
    )


def _voxels(job: Job[ExportOptions], mesh: TriangleMesh, colored: bool) -> list[Metric]:
    """Write the voxels of the surface where they are asked for; what they came to.

    Parameters
    ----------
    mesh : the surface in the user's coordinates.
    colored : whether its colours are known anywhere.
    """
    from workbench.voxels.lod_export import LodOptions, write_voxel_lod
    from workbench.voxels.surface_export import write_surface_graph

    products, options = job.products, job.options
    if options.voxels == "none":
        return []
    # Of all attributes voxels have the colour alone, and grey for all would say nothing.
    shown = {"color": mesh.vertex_attributes["color"]} if colored else {}
    bare = replace(mesh, vertex_attributes=shown)
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
        if options.voxels == "voxels":
            told = write_voxel_lod(bare, path, given)
        else:
            told = write_surface_graph(bare, path, options.voxels, given)
    return [
        Metric("voxels", told["voxels"], "", "Voxels of the finest level."),
        Metric("voxel_size", told["voxel_size"], "m", "Side of a voxel."),
        Metric("voxel_file", told["bytes"] / 1e6, "MB", "The file of voxels."),
        Metric("voxel_bits", 8.0 * told["bytes"] / told["voxels"], "bits",
               "Size of that file for each voxel, colours included."),
    ]  # fmt: skip


def _textured(job: Job[ExportOptions], mesh: TriangleMesh, origin: NDArray[np.float64]) -> int:
    """Write the textured surface where there is one; how many formats.

    Parameters
    ----------
    mesh : the surface, as the textured one was cut from it.
    origin : (3,) of the project, in the user's coordinates.
    """
    from workbench.formats.textured_gltf import write_textured_glb
    from workbench.formats.textured_obj import write_textured_obj
    from workbench.geometry.textured_mesh import TexturedMesh

    products, options = job.products, job.options
    atlas = products.load_if_there("texture_atlas")
    wanted = options.textured_glb or options.textured_obj
    if atlas is None or not wanted:
        products.remove_items_except("textured_pages", set())
        return 0
    pages = [products.load("texture_pages", item) for item in products.items("texture_pages")]
    pictures = tuple(np.ascontiguousarray(page[..., :3]) for page in pages)
    made = TriangleMesh.from_arrays(atlas)
    textured = TexturedMesh(made, atlas["texture_places"], atlas["pages"], pictures)
    with job.progress.step("writing the textured surface"):
        if options.textured_glb:
            with products.writing("textured_glb") as path:
                write_textured_glb(
                    path, textured, origin, pictures=options.pictures,
                    quality=options.picture_quality,
                )  # fmt: skip
        if options.textured_obj:
            moved = replace(textured, mesh=replace(made, vertices=made.vertices + origin))
            with TemporaryDirectory() as folder:
                # The files name each other: they are written under their own names.
                files = write_textured_obj(Path(folder) / "textured.obj", moved)
                _keep(products, files)
    if not options.textured_obj:
        products.remove_items_except("textured_pages", set())
    return options.textured_glb + options.textured_obj


def _keep(products: Products, files: Sequence[Path]) -> None:
    """Bring an OBJ (first) and what it names into the project, the OBJ last."""
    pages = set()
    for file in reversed(files):
        name = {".obj": "textured_obj", ".mtl": "textured_mtl"}.get(file.suffix, "textured_pages")
        item = file.stem if name == "textured_pages" else None
        pages |= {item} if item is not None else set()
        with products.writing(name, item) as path:
            copyfile(file, path)
    products.remove_items_except("textured_pages", pages)


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
    version=3,
    summary="PLY, OBJ, GLB with normals, colour, provenance, texture; voxels; in your coordinates.",
    options=ExportOptions,
    reads=(
        *("surface", "surface_color", "scan_inventory", "geometry_file"),
        *("texture_atlas", "texture_pages"),
    ),
    writes=(
        *("surface_ply", "surface_obj", "surface_glb"),
        *("textured_glb", "textured_obj", "textured_mtl", "textured_pages"),
        *("voxel_lod", "voxel_graph"),
    ),
    needed=needed,
    run=run,
    libraries=("numpy", "colour-science", "opencv-contrib-python-headless"),
    estimate=estimate,
)
