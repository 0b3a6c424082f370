"""How wrong the products of each stage are, for sweeps of its knobs.

Against the simulated truth where there is one, else against what the stage had not seen: a
scan or photographs left out, masks that took no part, places that were not asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.verify.frames import compared_poses, true_hits, users_origin
from stages.verify.photo_errors import color_error, develop_error, mask_error, texture_error
from stages.verify.photographed import photographed_places
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.neighbours import nearest, tree_of
from workbench.geometry.transforms import Matrix4, apply, rigid
from workbench.pipeline.knobs import ErrorMeasure, MeasuredError, NotMeasured
from workbench.pipeline.shape_sources import kept_scan
from workbench.pipeline.stage import Products
from workbench.project.project import Scene

if TYPE_CHECKING:
    from workbench.geometry.orientedscan import OrientedScan

# More places change no digit that is shown.
_PLACES = 100_000
_PLACES_OF_SCAN = 4_000
# A sample speaks for the surface around it so many of its radii wide.
_REACH = 3.0
_VIEW_RAYS = 1024


def register_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """Of scans' places; without a truth how far apart overlapping scans lie."""
    inventory = products.load("scan_inventory")
    if scene.truth:
        poses = compared_poses(products, inventory)
        told = "median error of a scan's place at its centre, against the true poses"
        return MeasuredError(float(np.median(poses.translation_m)), "m", told)
    placed = _placed_scans(products, inventory, products.load("scan_poses")["scans"])
    apart = _apart(placed)
    if not len(apart):
        return NotMeasured("no two scans overlap")
    told = (
        "median distance of places of one scan, chosen without regard to those that were "
        "matched, from the tangent planes of the others"
    )
    return MeasuredError(float(np.median(apart)), "m", told)


def fuse_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """How far places lie from the surface that the nearest samples and their normals tell."""
    from workbench.cloud.sample_source import opened_samples

    places = _places(products, scene)
    if isinstance(places, NotMeasured):
        return places
    held, cloud = (products.load_if_there(name) for name in ("samples", "sample_cloud"))
    with opened_samples(held, cloud) as source:
        samples = source.thinned(len(source))
    apart = _from_planes(places, samples.points, samples.normals, samples.radius_m)
    if scene.truth:
        told = "mean distance of true places that a beam met from the plane of the nearest sample"
        return MeasuredError(float(apart.mean()), "m", told)
    told = "median distance of a left-out scan from the planes of the nearest samples of the others"
    return MeasuredError(float(np.median(apart)), "m", told)


def densify_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """How far places that photographs show lie from the nearest depth that they agree on."""
    places = photographed_places(products) if scene.truth else NotMeasured("no truth")
    if isinstance(places, NotMeasured):
        return places
    points = []
    for name in products.items("photo_range_maps"):
        scan = products.load("photo_range_maps", name)
        points.append(apply(scan.world_from_scan, scan.points_in_scan))
    apart, _ = nearest(tree_of(np.concatenate(points)), _some(places, _PLACES))
    told = "mean distance of true places that two photographs show from the nearest depth"
    return MeasuredError(float(apart.mean()), "m", told)


def infill_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """How far places lie from the surface."""
    from workbench.verification.distances import distance_to_surface

    places = _places(products, scene)
    if isinstance(places, NotMeasured):
        return places
    apart = distance_to_surface(places, products.load("surface")).distance_m
    if scene.truth:
        told = "mean distance of true places that a beam met from the surface"
        return MeasuredError(float(apart.mean()), "m", told)
    told = "median distance of a left-out scan from the surface made without it"
    return MeasuredError(float(np.median(apart)), "m", told)


def orient_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """Of cameras' places; without a truth how far masks reach beyond the surface."""
    from workbench.formats.colmap import read_colmap_text
    from workbench.verification.camera_truth import compare_cameras

    poses = products.load("photo_poses")
    if poses["frame"] != "world":
        return NotMeasured("the photographs were not brought onto the surface")
    if products.load_if_there("truth_cameras") is not None and products.is_there("scan_inventory"):
        found, known = (
            read_colmap_text(Path(products.load(name)).parent).photo_cameras()
            for name in ("oriented_images", "truth_cameras")
        )
        apart = compare_cameras(
            {name: camera.camera_from_world for name, camera in found.items()},
            {name: camera.camera_from_world for name, camera in known.items()},
            _model_from_local(products)[0],
        )
        told = "median distance of cameras from the true ones"
        return MeasuredError(float(np.median(apart.center_m)), "m", told)
    silhouettes = poses.get("silhouettes")
    if not silhouettes:
        return NotMeasured("neither true cameras nor masks of photographs to compare with")
    beside = [one["beside"] for one in silhouettes.values()]
    told = "mean share of the masks, which took no part, where the cameras see no surface"
    return MeasuredError(100.0 * float(np.mean(beside)), "%", told)


def voxels_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """How far pictures of the finest voxels are from pictures of the surface."""
    from workbench.verification.voxel_errors import MeshViews
    from workbench.voxels.lod_file import LodFile

    surface, path = products.load_if_there("surface"), products.load_if_there("voxel_lod")
    if surface is None or path is None:
        return NotMeasured("no surface made here, or no voxels of it")
    file = LodFile(Path(path))
    level = int(file.nodes["level"].max())
    moved = TriangleMesh(surface.vertices + users_origin(products), surface.triangles)
    views = MeshViews.of(moved, file.grid, max(_VIEW_RAYS, 1 << level))
    told = "mean difference between pictures of the voxels and of the surface, from six sides"
    return MeasuredError(views.error_of(file, level), "of 255", told)


def surfels_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """How far places of the surface are from the nearest surfel."""
    from workbench.geometry.surface_sampling import sample_surface
    from workbench.surfels.surfel_file import surfel_points

    surface, path = products.load_if_there("surface"), products.load_if_there("surfels")
    if surface is None or path is None:
        return NotMeasured("no surface made here, or no surfels of it")
    places = sample_surface(surface, _PLACES, 0)[0] + users_origin(products)
    apart, _ = nearest(tree_of(surfel_points(Path(path)).points), places)
    told = "mean distance of places of the surface from the nearest surfel"
    return MeasuredError(float(apart.mean()), "m", told)


def _model_from_local(products: Products) -> tuple[Matrix4, NDArray[np.float64]]:
    """From the simulation's local frame to the model's, and the origin (3,) of the model."""
    inventory = products.load("scan_inventory")
    origin = np.array(inventory["origin_m"])
    common = compared_poses(products, inventory).estimate_from_truth
    local = products.load("truth_surface", only=["origin"])["origin"]
    return common @ rigid(np.eye(3), local - origin), origin


def _places(products: Products, scene: Scene) -> NDArray[np.float64] | NotMeasured:
    """(k, 3) places of the object in the model's frame that the stage should come near."""
    if scene.shape_from_photos:
        return photographed_places(products) if scene.truth else NotMeasured("no truth")
    if scene.truth:
        hits = true_hits(products, bool(products.items("scan_masks")))
        return _some(apply(_model_from_local(products)[0], hits), _PLACES)
    held = products.load("scan_poses").get("held_out")
    if not held:
        return NotMeasured("neither a truth nor a scan to spare: three scans or more are needed")
    placed = _placed_scans(products, products.load("scan_inventory"), held)
    points = [points for points, _, _ in placed]
    return _some(np.concatenate(points), _PLACES) if points else NotMeasured("an empty scan")


Placed = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _placed_scans(
    products: Products, inventory: Mapping[str, Any], poses: Mapping[str, Any]
) -> list[Placed]:
    """Points, normals and sample distances of scans in the project frame."""
    from workbench.geometry.orientedscan import OrientationSettings, orient

    to_project = rigid(np.eye(3), -np.array(inventory["origin_m"]))
    placed = []
    for entry in inventory["scans"]:
        name = entry["name"]
        if name not in poses:
            continue
        found: OrientedScan = orient(kept_scan(products, name), OrientationSettings())
        pose = np.array(poses[name]["world_from_scan"])
        pose = to_project @ pose @ rigid(np.eye(3), entry["scan_shift_m"])
        if len(found):
            placed.append((apply(pose, found.points), found.normals @ pose[:3, :3].T,
                           found.spacing_m))  # fmt: skip
    return placed


def _apart(placed: list[Placed]) -> NDArray[np.float64]:
    """Distances of places of each scan from the planes of all others that reach there."""
    trees = [tree_of(points) for points, _, _ in placed]
    found = []
    for k, (points, _, _) in enumerate(placed):
        some = points[np.random.default_rng(k).permutation(len(points))[:_PLACES_OF_SCAN]]
        for other, (theirs, normals, spacing) in enumerate(placed):
            if other == k:
                continue
            apart, which = nearest(trees[other], some)
            near = apart < _REACH * spacing[which]
            at = which[near]
            offsets = some[near] - theirs[at]
            found.append(np.abs(np.einsum("ij,ij->i", offsets, normals[at])))
    return np.concatenate(found) if found else np.zeros(0)


def _from_planes(
    places: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    radius_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Distance of places from the plane of the nearest sample; from itself where it is far."""
    apart, which = nearest(tree_of(points), places)
    across = np.abs(np.einsum("ij,ij->i", places - points[which], normals[which]))
    return np.where(apart > _REACH * radius_m[which], apart, across)


def _some(points: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """At most so many of them, evenly chosen, the same each time."""
    return points[:: max(1, -(-len(points) // most))]


ERRORS: Mapping[str, ErrorMeasure] = {
    "develop": ErrorMeasure(develop_error),
    "mask": ErrorMeasure(mask_error),
    "register": ErrorMeasure(register_error),
    "densify": ErrorMeasure(densify_error),
    "fuse": ErrorMeasure(fuse_error, leaves_out_scan=True),
    "infill": ErrorMeasure(infill_error, leaves_out_scan=True),
    "orient": ErrorMeasure(orient_error),
    "color": ErrorMeasure(color_error),
    "texture": ErrorMeasure(texture_error),
    "voxels": ErrorMeasure(voxels_error),
    "surfels": ErrorMeasure(surfels_error),
}
