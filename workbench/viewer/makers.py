"""How each form of a model that a browser shows is made of what the project exported."""

from __future__ import annotations

import json
import math
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING

from workbench.viewer.representations import Exports, Made, Representation, SiteOptions

if TYPE_CHECKING:
    from workbench.voxels.lod_export import LodOptions

# Surfels are chosen from some twenty times as many: with 50,000, from pictures of 512 pixels.
_CANDIDATE_SHARE = 512**2 / 50_000
_FEWEST_SPLIT = 1000
# Smaller chunks are seen or hidden, near or far as a whole more often; larger ones are fewer.
_CHUNK_LEVEL = 6
_POTREE = ("potree_metadata", "potree_hierarchy", "potree_octree")


def _textured(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    del options
    copyfile(exports.store.path("textured_glb"), folder / "textured.glb")
    return Made(_triangles(folder / "textured.glb"), "triangles", "With its photographs.")


def _surface(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    del options
    copyfile(exports.store.path("surface_glb"), folder / "surface.glb")
    told = "Colours at its corners; says what was measured and what filled in."
    return Made(_triangles(folder / "surface.glb"), "triangles", told)


def _surfels(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    from workbench.surfels.surfel_export import export_surfels
    from workbench.surfels.surfel_options import SurfelOptions

    # A leaf has about as many surfels as triangles: nothing of the surface is lost.
    settings = SurfelOptions(
        count=options.surfels,
        candidates_resolution=max(64, round(math.sqrt(_CANDIDATE_SHARE * options.surfels))),
        split_above=max(_FEWEST_SPLIT, options.surfels),
        workers=options.workers,
    )
    told = export_surfels(exports.surface, folder / "surface.surfels", settings)
    return Made(told["items"], "surfels", "Discs, as many as the picture needs.")


def _voxels(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    from workbench.voxels.lod_export import write_voxel_lod

    told = write_voxel_lod(exports.surface, folder / "surface.vlod", _voxel_options(options))
    size = f"{told['voxels'] / 1e6:.1f} million voxels, {options.resolution} a side"
    return Made(told["voxels"], "voxels", f"{size}; levels of detail in {told['chunks']} chunks.")


def _graph(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    from workbench.voxels.surface_export import write_surface_graph

    told = write_surface_graph(
        exports.surface, folder / "surface.voxgraph", "ssvdag", _voxel_options(options)
    )
    bits = f"{told['bits_per_voxel']:.2g} bits each, colours apart"
    return Made(told["voxels"], "voxels", f"{told['voxels'] / 1e6:.1f} million voxels, {bits}.")


def _voxel_options(options: SiteOptions) -> LodOptions:
    from workbench.voxels.lod_export import LodOptions

    return LodOptions(
        resolution=options.resolution, chunk_level=_CHUNK_LEVEL, workers=options.workers
    )


def _cloud(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    del options
    for name in _POTREE:
        copyfile(exports.store.path(name), folder / exports.store.path(name).name)
    told = json.loads((folder / "metadata.json").read_text(encoding="utf-8"))
    return Made(int(told["points"]), "points", "The consolidated points of the scans.")


def _stitched(exports: Exports, folder: Path, options: SiteOptions) -> Made:
    from workbench.viewer.stitched_files import write_project

    del options
    told = write_project(exports.store, folder)
    triangles = sum(mesh["triangles"] for mesh in told["meshes"])
    photographs = sum(photo["picture"] is not None for photo in told["photos"])
    return Made(triangles, "triangles", f"Out of {photographs} photographs, each where it is best.")


def _triangles(path: Path) -> int:
    from workbench.formats.glb_container import read_glb_description

    told = read_glb_description(path)
    parts = [part for mesh in told["meshes"] for part in mesh["primitives"]]
    return sum(int(told["accessors"][part["indices"]]["count"]) // 3 for part in parts)


REPRESENTATIONS = (
    Representation(
        "textured", "mesh", "Textured surface", "textured.glb", ("textured_glb",),
        "photographs have not textured it: workbench texture, then export", _textured,
    ),
    Representation(
        "surface", "mesh", "Surface", "surface.glb", ("surface_glb",),
        "it was not exported: workbench export with export.glb", _surface,
    ),
    Representation(
        "surfels", "surfels", "Surfels", "surface.surfels", ("surface_ply",),
        "the surface was not exported: workbench export", _surfels,
        lambda options: options.surfels,
    ),
    Representation(
        "voxels", "voxels", "Voxels", "surface.vlod", ("surface_ply",),
        "the surface was not exported: workbench export", _voxels,
        lambda options: options.resolution,
    ),
    Representation(
        "graph", "ssvdag", "Voxel graph", "surface.voxgraph", ("surface_ply",),
        "the surface was not exported: workbench export", _graph,
        lambda options: options.resolution,
    ),
    Representation(
        "cloud", "cloud", "Points of the scans", "metadata.json", _POTREE,
        "it was not exported: workbench export --set export.clouds=potree", _cloud,
    ),
    Representation(
        "stitched", "stitched", "Stitched photographs", "stitched.json",
        ("texturing", "depth_meshes", "depth_maps", "texture_photos", "photo_poses"),
        "it has no textured depth meshes: workbench texture", _stitched,
    ),
)  # fmt: skip
"""All forms, the first that is there is shown first."""
