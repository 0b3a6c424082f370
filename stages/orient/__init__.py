"""Find where the photographs were taken from, and bring them onto the scans' surface."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.orient.options import OrientOptions
from stages.orient.scaling import before_the_surface, in_own_scale
from stages.orient.telling import (
    alignment_metrics,
    doubts,
    silhouette_agreement,
    told_poses,
)
from workbench.errors import InputError
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.mask_subjects import photos_by_name
from workbench.project.project import Scene

if TYPE_CHECKING:
    from workbench.formats.colmap import ColmapModel
    from workbench.geometry.mesh import TriangleMesh
    from workbench.orientation.structure_from_motion import OrientationSettings


def needed(scene: Scene, options: OrientOptions) -> Need:
    if not scene.photos:
        return Need(False, "no photographs")
    surface = scene.scans or scene.geometry
    source = "as they were oriented elsewhere" if scene.cameras else "to be oriented"
    onto = "" if surface and options.align == "auto" else ", in a frame of their own"
    if scene.photos_fill:
        onto = f", {'onto places picked' if scene.picks else 'in the frame of their cameras'}"
    # A surface that is made of the photographs, too, is made once they are oriented.
    without = frozenset(("surface",)) if onto else frozenset()
    return Need(True, f"{scene.photos} photographs {source}{onto}", without)


def estimate(scene: Scene, options: OrientOptions) -> Estimate:
    from workbench.orientation.alignment import AlignmentOptions
    from workbench.orientation.surface_patches import MOST_TRACKS

    # A patch is seen by a sixth of the photographs at most; the adjustment takes some of them.
    seen_by = min(max(3, scene.photos // 6), options.patch_photos + 1)
    tracks = min(MOST_TRACKS, scene.photos * options.patches_per_photo)
    adjusted = min(AlignmentOptions.most_patches, tracks)
    memory = 6 * options.memory_pixels + seen_by * (160 * tracks + 800 * adjusted)
    return Estimate(memory + 2**30, 2**26)


def run(job: Job[OrientOptions]) -> StageResult:
    from workbench.orientation.alignment import NotAligned, transformed

    products = job.products
    photos = _photos_of_the_object(job)
    inventory = products.load_if_there("scan_inventory")
    origin = np.array(inventory["origin_m"]) if inventory else np.zeros(3)
    picks = _picks(job, photos, origin)
    model, unplaced, metrics = _oriented(job, photos)
    if job.scene.cameras:
        from workbench.geometry.similarity import Similarity

        model = transformed(model, Similarity(1.0, np.eye(3), -origin))
    surface = _surface(job) if job.options.align == "auto" else None
    warnings = [f"{name}: {reason}" for name, reason in unplaced.items()]
    told: dict[str, Any] = {
        "origin": origin.tolist(),
        "frame": "own",
        "way": None,
        "unplaced": unplaced,
    }
    alignment = None
    if job.scene.shape_from_photos:
        model, scale = in_own_scale(job, model, photos, picks)
        told |= {"frame": "world", "way": "photographs", "scale": scale.told}
        warnings += scale.warnings
        metrics += scale.metrics
    if job.scene.photos_fill:
        model, way, found_by = before_the_surface(model, picks)
        told |= {"frame": "world", "way": way}
        metrics += found_by
    if surface is not None:
        found = _aligned(job, model, surface, photos, picks)
        if isinstance(found, NotAligned):
            warnings.append(
                f"the photographs stay in a frame of their own: {found.reason}; pick three to "
                "five places on the scans and in photographs in alignment.toml"
            )
        else:
            alignment, model = found, found.model
            told |= {"frame": "world", "way": found.way}
            warnings += doubts(found)
            metrics += alignment_metrics(found)
            agreement = silhouette_agreement(products, model, surface)
            told["silhouettes"] = agreement
            if agreement:
                beside = [one["beside"] for one in agreement.values()]
                metrics.append(
                    Metric("mask_beside_surface", float(np.mean(beside)), "",
                           "Share of the masks where the cameras see no surface, mean.")
                )  # fmt: skip
    told["photos"] = told_poses(model, alignment)
    products.save("photo_poses", told)
    _write_colmap(job, model)
    return StageResult(tuple(metrics), tuple(warnings))


def _photos_of_the_object(job: Job[OrientOptions]) -> dict[str, Path]:
    """All photographs but those of charts."""
    photos = photos_by_name(job.products.input_paths("photo_files"))
    inventory = job.products.load_if_there("photo_inventory")
    charts = {e["name"] for e in inventory["photos"] if e["is_chart"]} if inventory else set()
    kept = {name: path for name, path in photos.items() if name not in charts}
    for path in kept.values():
        if path.name.split() != [path.name]:
            raise InputError(
                "COLMAP's files have no room for this name",
                file=path,
                expected="a name without spaces",
                fix="rename the photograph",
            )
    return kept


def _picks(
    job: Job[OrientOptions], photos: Mapping[str, Path], origin: NDArray[np.float64]
) -> tuple[Any, ...]:
    from workbench.orientation.picks import read_picks

    paths = job.products.input_paths("alignment_file")
    if not paths:
        return ()
    return tuple(replace(p, world=p.world - origin) for p in read_picks(paths[0], photos))


def _oriented(
    job: Job[OrientOptions], photos: Mapping[str, Path]
) -> tuple[ColmapModel, dict[str, str], list[Metric]]:
    """Cameras by structure from motion, or as they were brought."""
    from workbench.formats.photo_orientations import read_orientations
    from workbench.orientation.photographs import PhotoToOrient
    from workbench.orientation.structure_from_motion import oriented

    products = job.products
    files = list(photos.values())
    if job.scene.cameras:
        given = products.input_paths("camera_files")
        source = given[0] if len(given) == 1 else given[0].parent
        model = read_orientations(source, files)
        there = {image.name for image in model.images.values()}
        unplaced = {p.name: "not in the given orientation" for p in files if p.name not in there}
        return model, unplaced, [_placed_metric(model, files)]
    inventory = products.load_if_there("photo_inventory")
    known = {e["name"]: e for e in inventory["photos"]} if inventory else {}
    masked = set(products.items("photo_masks"))
    asked = [
        PhotoToOrient(
            path.name,
            path,
            camera_key=" ".join(
                str(known.get(name, {}).get(key)) for key in ("camera", "lens", "focal_length_mm")
            ),
            focal_px=_focal_px(known.get(name, {})),
            mask=products.path("photo_masks", name) if name in masked else None,
        )
        for name, path in photos.items()
    ]
    with job.progress.shares() as told:
        found = oriented(asked, _settings(job.options), told)
    if not found:
        raise InputError(
            f"The photographs cannot be oriented: {found.reason}",
            fix="photograph with more overlap, or bring an orientation with --cameras",
        )
    metrics = [
        _placed_metric(found.model, files),
        Metric("points", len(found.model.points), "", "Points that photographs share."),
        Metric("reprojection", found.reprojection_px, "px", "RMS of observations to points."),
        Metric("mean_track", found.mean_track, "", "Photographs that see a point, on average."),
    ]
    return found.model, found.unplaced, metrics


def _settings(options: OrientOptions) -> OrientationSettings:
    from workbench.orientation.features import FeatureSettings
    from workbench.orientation.mapping import MappingSettings
    from workbench.orientation.structure_from_motion import OrientationSettings

    return OrientationSettings(
        features=FeatureSettings(max_image_px=options.image_px, max_features=options.features),
        mapping=MappingSettings(mapper=options.mapper),
        seed=options.seed,
    )


def _focal_px(entry: Mapping[str, Any]) -> float | None:
    from workbench.photos.exif import PhotoFacts

    if not entry:
        return None
    facts = PhotoFacts(**{k: entry[k] for k in PhotoFacts.__dataclass_fields__ if k in entry})
    return facts.focal_length_px(max(entry["size"]))


def _placed_metric(model: ColmapModel, files: Sequence[Path]) -> Metric:
    return Metric("placed", len(model.images), "", f"Photographs placed, of {len(files)}.")


def _surface(job: Job[OrientOptions]) -> TriangleMesh | None:
    """The scans' surface around the project origin, or the one that was brought."""
    from workbench.formats.surface_files import read_surface

    made = job.products.load_if_there("surface")
    if made is not None:
        return made  # type: ignore[no-any-return]
    paths = job.products.input_paths("geometry_file")
    return read_surface(paths[0]) if paths else None


def _aligned(
    job: Job[OrientOptions],
    model: ColmapModel,
    surface: TriangleMesh,
    photos: Mapping[str, Path],
    picks: tuple[Any, ...],
) -> Any:
    from workbench.orientation.alignment import AlignmentOptions, aligned
    from workbench.orientation.surface_patches import PatchOptions
    from workbench.surface.provenance import MEASURED

    options = job.options
    refine = options.refine == "always" or (options.refine == "auto" and not job.scene.cameras)
    provenance = surface.vertex_attributes.get("provenance")
    if provenance is not None:
        # What was filled in is a guess: no camera is held by it.
        measured = (provenance == MEASURED)[surface.triangles].all(axis=1)
        surface = surface.keep_triangles(measured) if measured.any() else surface
    rounds = options.patch_rounds if refine else 0
    pictures, masks = _pictures(job, model, photos) if rounds else ({}, {})
    patches = PatchOptions(options.patches_per_photo, most_photos=options.patch_photos)
    with job.progress.step("bringing photographs onto the surface"):
        return aligned(
            model,
            surface,
            pictures,
            masks,
            picks,
            AlignmentOptions(refine, rounds, patches),
            job.progress.line,
        )


def _pictures(
    job: Job[OrientOptions], model: ColmapModel, photos: Mapping[str, Path]
) -> tuple[dict[int, NDArray[np.uint8]], dict[int, NDArray[np.uint8]]]:
    """Grey pictures and masks by image id, reduced alike where they are too many to hold."""
    import cv2

    from workbench.formats.photo_reading import read_photo

    total = sum(
        model.cameras[image.camera_id].width * model.cameras[image.camera_id].height
        for image in model.images.values()
    )
    share = min(1.0, (job.options.memory_pixels / max(total, 1)) ** 0.5)
    masked = set(job.products.items("photo_masks"))
    pictures, masks = {}, {}
    for number, image in sorted(model.images.items()):
        name = Path(image.name).stem
        grey = cv2.cvtColor(read_photo(photos[name]), cv2.COLOR_RGB2GRAY)
        size = tuple(max(1, round(share * side)) for side in grey.shape[::-1])
        pictures[number] = np.asarray(
            cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8
        )
        if name in masked:
            mask = job.products.load("photo_masks", name)
            masks[number] = np.asarray(
                cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8
            )
    return pictures, masks


def _write_colmap(job: Job[OrientOptions], model: ColmapModel) -> None:
    from workbench.formats.colmap import write_colmap_text

    with tempfile.TemporaryDirectory() as folder:
        write_colmap_text(Path(folder), model)
        for name, file in (
            ("oriented_cameras", "cameras.txt"),
            ("oriented_images", "images.txt"),
            ("oriented_points", "points3D.txt"),
        ):
            with job.products.writing(name) as path:
                copyfile(Path(folder) / file, path)


ORIENT = Stage(
    name="orient",
    version=4,
    summary="Finds where photographs were taken from, and adjusts them to the surface.",
    options=OrientOptions,
    reads=(
        *("photo_files", "camera_files", "alignment_file", "geometry_file", "photo_inventory"),
        *("photo_masks", "scan_inventory", "surface"),
    ),
    writes=("photo_poses", "oriented_cameras", "oriented_images", "oriented_points"),
    needed=needed,
    run=run,
    libraries=(
        *("numpy", "scipy", "numba", "open3d", "pycolmap", "opencv-contrib-python-headless"),
        "rawpy",
    ),
    estimate=estimate,
    knobs=(
        Knob("image_px", (800, 1600, 3200), quick=()),
        Knob("features", (1500, 3000, 6000), quick=()),
        Knob("patch_rounds", (0, 1, 2), quick=(0,)),
        Knob("patches_per_photo", (2000, 4000, 8000), quick=()),
        Knob("patch_photos", (8, 16, 32), quick=()),
    ),
)
