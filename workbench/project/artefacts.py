"""The one table from artefact name to place, format and schema version.

Stages name what they read and write; nothing but this table spells a path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Format = Literal[
    "json", "arrays", "range-map", "mesh", "mask", "linear-picture", "picture", "file", "input"
]


@dataclass(frozen=True)
class Artefact:
    """One kind of file in the project folder.

    Attributes
    ----------
    name : what stages call it.
    path : relative to the project; ``{item}`` stands for the item's name where there is
        one file per scan, photograph or chunk. Empty for what the user brings (``input``).
    format : how it is stored, see ``workbench.project.store``.
    schema : version of the content; raised when its meaning changes.
    description : one line for people.
    truth : known only of simulated scenes; open to verification alone.
    """

    name: str
    path: str
    format: Format
    description: str
    schema: int = 1
    truth: bool = False

    @property
    def per_item(self) -> bool:
        """Whether there is one file per scan, photograph or chunk."""
        return "{item}" in self.path


_TABLE = (
    Artefact("scan_files", "", "input", "the range scans the user brought"),
    Artefact("pose_files", "", "input", "coarse scan poses beside the scans"),
    Artefact("photo_files", "", "input", "the photographs the user brought"),
    Artefact("photo_sidecars", "", "input", "what cameras wrote beside photographs"),
    Artefact("calibration_files", "", "input", "frames of charts and even targets, and notes"),
    Artefact("camera_files", "", "input", "ready-made photograph orientations"),
    Artefact("alignment_file", "", "input", "places picked on the scans and in photographs"),
    Artefact("geometry_file", "", "input", "a surface made elsewhere"),
    Artefact("reference_file", "", "input", "a surface to compare with"),
    Artefact("training_masks", "", "input", "the masks the user drew to learn from"),
    Artefact("corrected_masks", "", "input", "the masks the user corrected"),
    Artefact("scan_inventory", "work/ingest/scans.json", "json", "every scan and what it holds"),
    Artefact(
        "range_maps", "work/ingest/range_maps/{item}.npz", "range-map", "scans in metres, checked"
    ),
    Artefact(
        "photo_inventory", "work/develop/photos.json", "json", "every photograph and its exposure"
    ),
    Artefact(
        "color_calibration", "work/develop/color.json", "json", "from the camera's colours to ours"
    ),
    Artefact(
        "developed_photos",
        "work/develop/photos/{item}.tif",
        "linear-picture",
        "photographs in linear colour",
    ),
    Artefact(
        "unclipped_masks",
        "work/develop/unclipped/{item}.png",
        "mask",
        "where the sensor was not full",
    ),
    Artefact("scan_masker", "work/mask/scan_masker.npz", "arrays", "what clutter in scans is like"),
    Artefact(
        "photo_masker",
        "work/mask/photo_masker.npz",
        "arrays",
        "what clutter in photographs is like",
    ),
    Artefact(
        "automatic_scan_masks",
        "work/mask/automatic/scans/{item}.png",
        "mask",
        "masks of scans as found",
    ),
    Artefact(
        "automatic_photo_masks",
        "work/mask/automatic/photos/{item}.png",
        "mask",
        "masks of photographs as found",
    ),
    Artefact("scan_masks", "work/mask/scans/{item}.png", "mask", "what of each scan is kept"),
    Artefact(
        "photo_masks", "work/mask/photos/{item}.png", "mask", "what of each photograph is kept"
    ),
    Artefact(
        "scan_poses", "work/register/scan_poses.json", "json", "world_from_scan of every scan"
    ),
    Artefact(
        "registration", "work/register/registration.npz", "arrays", "residuals, overlap, covariance"
    ),
    Artefact(
        "oriented_scans", "work/fuse/scans/{item}.npz", "arrays", "samples with normals per scan"
    ),
    Artefact("samples", "work/fuse/samples.npz", "arrays", "the consolidated samples in the world"),
    Artefact("sample_cloud", "work/fuse/samples.cloud", "file", "more samples than memory holds"),
    Artefact("coarse_surface", "work/infill/coarse.npz", "mesh", "one solution of the whole"),
    Artefact("block_plan", "work/infill/blocks.json", "json", "how the surface is cut in blocks"),
    Artefact("block_surfaces", "work/infill/blocks/{item}.npz", "mesh", "each block's solution"),
    Artefact("surface_parts", "work/infill/parts/{item}.npz", "arrays", "surface of each block"),
    Artefact("surface", "work/infill/surface.npz", "mesh", "closed surface with provenance"),
    Artefact(
        "photo_poses", "work/orient/photo_poses.json", "json", "where photographs were taken from"
    ),
    Artefact("oriented_cameras", "work/orient/colmap/cameras.txt", "file", "COLMAP: the lenses"),
    Artefact("oriented_images", "work/orient/colmap/images.txt", "file", "COLMAP: photographs"),
    Artefact("oriented_points", "work/orient/colmap/points3D.txt", "file", "COLMAP: the points"),
    Artefact(
        "stereo_views", "work/densify/views/{item}.npz", "arrays", "photographs without distortion"
    ),
    Artefact(
        "depth_estimates",
        "work/densify/estimates/{item}.npz",
        "arrays",
        "planes that each photograph's pixels show",
    ),
    Artefact(
        "better_estimates",
        "work/densify/better/{item}.npz",
        "arrays",
        "the same once they know of each other",
    ),
    Artefact(
        "photo_range_maps",
        "work/densify/range_maps/{item}.npz",
        "range-map",
        "depth maps that photographs agree on",
    ),
    Artefact(
        "photo_range_inventory",
        "work/densify/range_maps.json",
        "json",
        "every depth map and what it holds",
    ),
    Artefact(
        "photo_observations",
        "work/color/seen/{item}.npz",
        "arrays",
        "what each photograph says of the surface",
    ),
    Artefact("photo_lighting", "work/color/lit/{item}.npz", "arrays", "where each flash reaches"),
    Artefact(
        "cloud_observations",
        "work/color/seen_of_cloud/{item}.npz",
        "arrays",
        "what each photograph says of the cloud",
    ),
    Artefact("colored_cloud", "work/color/samples.cloud", "file", "the cloud with its colours"),
    Artefact("flash", "work/color/flash.json", "json", "the flash and its strength"),
    Artefact(
        "surface_color", "work/color/surface_color.npz", "arrays", "linear colour of the surface"
    ),
    Artefact(
        "texture_photos",
        "work/texture/photos/{item}.png",
        "picture",
        "photographs free of their flash",
    ),
    Artefact("depth_maps", "work/texture/depth/{item}.npz", "arrays", "what each camera sees"),
    Artefact(
        "depth_meshes",
        "work/texture/meshes/{item}.npz",
        "arrays",
        "mesh of each camera and its photographs",
    ),
    Artefact("texturing", "work/texture/texturing.json", "json", "order and place of photographs"),
    Artefact("labelled_surface", "work/texture/surface.npz", "arrays", "photographs of a mesh"),
    Artefact("texture_atlas", "work/texture/atlas.npz", "arrays", "the surface cut for its atlas"),
    Artefact("texture_pages", "work/texture/pages/{item}.png", "picture", "the atlas"),
    Artefact("textured_glb", "exports/textured.glb", "file", "the textured surface for the web"),
    Artefact("textured_obj", "exports/textured/textured.obj", "file", "for general tools"),
    Artefact("textured_mtl", "exports/textured/textured.mtl", "file", "its materials"),
    Artefact("textured_pages", "exports/textured/{item}.png", "file", "its pictures"),
    Artefact("surface_ply", "exports/surface.ply", "file", "the surface with all attributes"),
    Artefact("surface_obj", "exports/surface.obj", "file", "the surface for general tools"),
    Artefact("surface_glb", "exports/surface.glb", "file", "the surface for the web"),
    Artefact("voxel_lod", "exports/voxels.vlod", "file", "voxels of the surface, level by level"),
    Artefact("voxel_graph", "exports/voxels.voxgraph", "file", "voxels of the surface as a graph"),
    Artefact(
        "surfels", "exports/surfels.surfels", "file", "surfels of the surface, coarse to fine"
    ),
    Artefact("points_laz", "exports/points.laz", "file", "samples for programs of clouds"),
    Artefact("points_las", "exports/points.las", "file", "samples for programs of clouds"),
    Artefact("points_copc", "exports/points.copc.laz", "file", "samples, level by level"),
    Artefact("points_e57", "exports/points.e57", "file", "samples for programs of scans"),
    Artefact("points_ply", "exports/points.ply", "file", "samples with every bit"),
    Artefact("potree_metadata", "exports/potree/metadata.json", "file", "samples for Potree"),
    Artefact("potree_hierarchy", "exports/potree/hierarchy.bin", "file", "their octree"),
    Artefact("potree_octree", "exports/potree/octree.bin", "file", "their points"),
    Artefact("point_cubes", "exports/points.pcube", "file", "cells of the surface, coded"),
    Artefact("sweep_points", "work/sweep/sweep.json", "json", "error against run time"),
    Artefact("page_measures", "work/page/measures.json", "json", "what the page costs"),
    Artefact("stability_table", "work/stability/table.json", "json", "stiff and extreme cases"),
    Artefact("fault_table", "work/faults/table.json", "json", "kills and other faults"),
    Artefact("records", "work/{item}/record.json", "json", "what each stage did"),
    Artefact("report_html", "report/report.html", "file", "the report for people"),
    Artefact("report_json", "report/report.json", "json", "the report's numbers"),
    Artefact("provenance", "provenance.json", "json", "W3C PROV-JSON of the whole project"),
    Artefact("truth_surface", "truth/surface.npz", "arrays", "the simulated scene", truth=True),
    Artefact("truth_samples", "truth/scans/{item}.npz", "arrays", "noise-free hits", truth=True),
    Artefact("simulation", "truth/simulation.json", "json", "the simulation's options", truth=True),
    Artefact("truth_scan_masks", "truth/masks/{item}.png", "mask", "true masks", truth=True),
    Artefact("truth_albedo", "truth/photos/albedo/{item}.png", "file", "true albedo", truth=True),
    Artefact(
        "truth_surface_albedo",
        "truth/photos/surface_albedo.npz",
        "arrays",
        "true albedo of the simulated scene",
        truth=True,
    ),
    Artefact("truth_cameras", "truth/photos/images.txt", "file", "true cameras", truth=True),
    Artefact("truth_object", "truth/photos/object/{item}.png", "file", "true masks", truth=True),
    Artefact("truth_support", "truth/photos/support/{item}.png", "file", "supports", truth=True),
    Artefact("truth_shadow", "truth/photos/shadow/{item}.png", "file", "flash shadow", truth=True),
    Artefact("truth_poses", "truth/scan_poses.json", "json", "the simulated poses", truth=True),
)

ARTEFACTS: dict[str, Artefact] = {artefact.name: artefact for artefact in _TABLE}
