"""Depth maps from photographs alone, as range maps that everything after takes for scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.densify.coverage import Coverage, measured_coverage
from stages.densify.items import better_estimate, estimate_depth, make_range_map, make_view
from stages.densify.options import DensifyOptions
from workbench.errors import InputError, SettingsError
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.mask_subjects import photos_by_name
from workbench.project.project import Scene

if TYPE_CHECKING:
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.stereo.choice import SeenPoints

# A view, its estimate and what the search holds, bytes a pixel; one per neighbour besides.
_OWN_BYTES, _NEIGHBOUR_BYTES, _STORED_BYTES = 120, 60, 60
# What is held of a scan to tell what it covers.
_SCAN_BYTES = 2**25


def needed(scene: Scene, options: DensifyOptions) -> Need:
    if scene.geometry:
        return Need(False, "the surface was made elsewhere")
    if options.fill == "missed" and scene.scans and scene.photos and not scene.photos_fill:
        raise SettingsError(
            "Photographs cannot fill what the scans missed: nothing places them before there is "
            "a surface",
            found=f"{scene.photos} photographs, "
            + (
                "placed" if scene.cameras or scene.picks else "neither --cameras nor alignment.toml"
            ),
            expected="three photographs or more, with cameras in the scans' frame or places picked",
            fix="pick three to five places on the scans and in photographs in alignment.toml, or "
            "take densify.fill away",
        )
    if scene.photos_fill:
        return Need(True, f"what the scans missed, from {scene.photos} photographs")
    if scene.scans:
        filled = "; densify.fill=missed fills what they missed" if scene.photos else ""
        return Need(False, f"the scans tell the surface{filled}")
    if not scene.has_surface:
        return Need(False, "fewer than three photographs")
    return Need(True, f"the shape from {scene.photos} photographs")


def estimate(scene: Scene, options: DensifyOptions) -> Estimate:
    pixels = options.image_px**2
    held = scene.scans * _SCAN_BYTES if scene.photos_fill else 0
    return Estimate(
        2**29 + held + pixels * (_OWN_BYTES + _NEIGHBOUR_BYTES * options.neighbours),
        2**24 + scene.photos * pixels * _STORED_BYTES,
    )


def run(job: Job[DensifyOptions]) -> StageResult:
    from workbench.formats.colmap import read_colmap_text
    from workbench.stereo.choice import seen_points

    products, options = job.products, job.options
    model = read_colmap_text(Path(products.load("oriented_images")).parent)
    cameras = model.photo_cameras()
    if len(cameras) < 2:
        raise InputError(
            "Depth maps need two oriented photographs",
            found=f"{len(cameras)}",
            fix="photograph with more overlap, or bring an orientation with --cameras",
        )
    names = sorted(cameras)
    views = _views(job, cameras, names)
    points = seen_points(model, {name: view["share"] for name, view in views.items()})
    pairs, spans = _chosen(points, cameras, options)
    if not any(pairs.values()):
        raise InputError(
            "No photograph looks where another does",
            found=f"{len(names)} oriented photographs without a neighbour",
            fix="bring their orientation with its points, or leave out --cameras",
        )
    # What is compared with nothing has no depth map.
    names = [name for name in names if pairs[name]]
    coverage = measured_coverage(job, points, pairs) if job.scene.photos_fill else None
    if coverage is not None:
        names = [name for name in names if name not in coverage.left_out]
    pairs = {name: [other for other in pairs[name] if other in names] for name in names}
    why_own = _why_own(options)
    if why_own or not names:
        source, seconds = _estimates(job, names, pairs, spans)
    else:
        source, seconds = _estimates_of_colmap(job, names, pairs, spans)
    maps = _range_maps(job, names, pairs, source)
    poses = products.load("photo_poses")
    told = {
        "origin_m": poses["origin"],
        "why_own_matcher": why_own,
        "coverage": None if coverage is None else dict(coverage.shares),
        "scans": [
            maps[name]
            | {
                "usable": views[name]["usable"],
                "neighbours": list(pairs[name]),
                "depths": list(spans[name]),
            }
            for name in names
        ],
    }
    products.save("photo_range_inventory", told)
    return _result(maps, views, seconds, sorted(cameras), coverage)


def _views(
    job: Job[DensifyOptions], cameras: Mapping[str, PhotoCamera], names: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Every photograph without distortion, stored; returns what each holds."""
    products = job.products
    photos = photos_by_name(products.input_paths("photo_files"))
    masked = set(products.items("photo_masks"))
    items = {}
    for name in names:
        camera = cameras[name]
        items[name] = {
            "name": name,
            "path": str(photos[name]),
            "content": products.input_hash(photos[name]),
            "mask": products.content_hash("photo_masks", name) if name in masked else None,
            "camera": {
                "model": camera.model,
                "size": [camera.width, camera.height],
                "params": list(camera.params),
                "camera_from_world": camera.camera_from_world.tolist(),
            },
            "image_px": job.options.image_px,
        }
    found = job.tasks.map_items("taking the lens out of photographs", make_view, items)
    products.remove_items_except("stereo_views", set(names))
    return found


def _chosen(
    points: SeenPoints, cameras: Mapping[str, PhotoCamera], options: DensifyOptions
) -> tuple[dict[str, Sequence[str]], dict[str, tuple[float, float]]]:
    """Neighbours and span of depths of every photograph."""
    from workbench.stereo.choice import chosen_neighbours, depth_span

    pairs = chosen_neighbours(points, cameras, options.neighbours)
    spans = {
        name: depth_span(points, number, cameras[name])
        for number, name in enumerate(points.names)
        if pairs[name]
    }
    return dict(pairs), spans


def _why_own(options: DensifyOptions) -> str | None:
    """Why COLMAP does not do the matching; None where it does."""
    from workbench.stereo.colmap_stereo import why_not_colmap

    if options.matcher == "own":
        return "densify.matcher is own"
    unable = why_not_colmap()
    if unable and options.matcher == "colmap":
        raise InputError(
            "COLMAP cannot match here",
            found=unable,
            fix="a machine with an NVIDIA card and pycolmap-cuda12, or --set densify.matcher=own",
        )
    return unable


def _matching(options: DensifyOptions) -> dict[str, Any]:
    """The settings of matching, as items are given them."""
    return {
        "levels": options.levels,
        "first_rounds": options.first_rounds,
        "rounds": options.rounds,
        "half_px": options.patch_px // 2,
    }


def _estimates_of_colmap(
    job: Job[DensifyOptions],
    names: Sequence[str],
    pairs: Mapping[str, Sequence[str]],
    spans: Mapping[str, tuple[float, float]],
) -> tuple[str, list[float]]:
    """Depth maps by COLMAP on a graphics card, judged as our own are; as `_estimates`."""
    from workbench.stereo.colmap_stereo import colmap_planes
    from workbench.stereo.matching import MatchingSettings, judged
    from workbench.stereo.views import StereoView

    products = job.products

    def view(name: str) -> StereoView:
        return StereoView.from_arrays(products.load("stereo_views", name))

    settings = MatchingSettings(**_matching(job.options))
    start = perf_counter()
    with TemporaryDirectory(prefix="workbench-colmap-") as folder:
        widest = (min(near for near, _ in spans.values()), max(far for _, far in spans.values()))
        with job.progress.step("COLMAP's PatchMatch stereo"):
            planes = colmap_planes(Path(folder), names, view, pairs, widest)
        with job.progress.step("depth maps", len(names)) as step:
            for name in names:
                one = view(name)
                others = [view(other) for other in pairs[name]]
                found = judged(one, others, planes(name), spans[name], settings)
                products.save("better_estimates", found.arrays(one.usable), name)
                step.advance()
    products.remove_items_except("depth_estimates", set())
    products.remove_items_except("better_estimates", set(names))
    return "better_estimates", [(perf_counter() - start) / len(names)] * len(names)


def _estimates(
    job: Job[DensifyOptions],
    names: Sequence[str],
    pairs: Mapping[str, Sequence[str]],
    spans: Mapping[str, tuple[float, float]],
) -> tuple[str, list[float]]:
    """Depth maps of all photographs; returns the artefact that holds them, and their seconds."""
    products, options = job.products, job.options
    settings = _matching(options)
    content = {name: products.content_hash("stereo_views", name) for name in names}
    common: dict[str, dict[str, Any]] = {
        name: {
            "name": name,
            "others": list(pairs[name]),
            "span": list(spans[name]),
            "settings": settings,
            "last": not options.geometric,
            "seed": number,
            "views": [content[one] for one in (name, *pairs[name])],
        }
        for number, name in enumerate(names)
    }
    found = job.tasks.map_items("depth maps", estimate_depth, common)
    seconds = [found[name]["seconds"] for name in names]
    products.remove_items_except("depth_estimates", set(names))
    products.remove_items_except("better_estimates", set(names) if options.geometric else set())
    if not options.geometric:
        return "depth_estimates", seconds
    known = {name: products.content_hash("depth_estimates", name) for name in names}
    items = {
        name: item
        | {
            "from": "depth_estimates",
            "estimates": [known[one] for one in (name, *pairs[name])],
            "seed": item["seed"] + len(names),
        }
        for name, item in common.items()
    }
    found = job.tasks.map_items("depth maps that know of each other", better_estimate, items)
    more = [found[name]["seconds"] for name in names]
    return "better_estimates", [one + two for one, two in zip(seconds, more, strict=True)]


def _range_maps(
    job: Job[DensifyOptions],
    names: Sequence[str],
    pairs: Mapping[str, Sequence[str]],
    source: str,
) -> dict[str, dict[str, Any]]:
    """What depth maps agree on, stored as range maps; returns what each holds."""
    products, options = job.products, job.options
    known = {name: products.content_hash(source, name) for name in names}
    items = {
        name: {
            "name": name,
            "others": list(pairs[name]),
            "from": source,
            "estimates": [known[one] for one in (name, *pairs[name])],
            "views": [products.content_hash("stereo_views", one) for one in (name, *pairs[name])],
            "settings": {
                "least_views": options.agreeing,
                "most_px": options.agreement_px,
                "most_cost": options.most_cost,
                "speckle_share": options.speckle_share,
            },
        }
        for name in names
    }
    found = job.tasks.map_items("where depth maps agree", make_range_map, items)
    products.remove_items_except("photo_range_maps", set(names))
    return found


def _result(
    maps: Mapping[str, Mapping[str, Any]],
    views: Mapping[str, Mapping[str, Any]],
    seconds: Sequence[float],
    oriented: Sequence[str],
    coverage: Coverage | None,
) -> StageResult:
    names = sorted(maps)
    told = coverage.metrics() if coverage else ()
    if not names:
        return StageResult(told)
    samples = sum(maps[name]["samples"] for name in names)
    usable = sum(views[name]["usable"] for name in names)
    if not samples:
        raise InputError(
            "No two photographs agree on any depth",
            fix="photograph with more overlap and texture, or loosen densify.agreeing",
        )
    held = [maps[name] for name in names if maps[name]["samples"]]
    needless = coverage.left_out if coverage else ()
    warnings = [
        f"{name}: compared with nothing"
        for name in oriented
        if name not in names and name not in needless
    ]
    warnings += [f"{n}: no depth was agreed on" for n in names if not maps[n]["samples"]]
    metrics = (
        Metric("depth_maps", len(held), "", f"Photographs with a depth map, of {len(oriented)}."),
        Metric("samples", samples, "", "Depths that photographs agree on."),
        Metric("agreed", 100.0 * samples / max(usable, 1), "%",
               "Their share of the pixels that show the object."),
        Metric("agreeing_views", float(np.mean([m["mean_views"] for m in held])), "",
               "Other photographs that agree on a depth, mean."),
        Metric("depth_sigma", float(np.median([m["sigma_m"] for m in held])), "m",
               "Standard deviation of a depth along its ray, median."),
        Metric("matching_seconds", float(np.median(seconds)), "s",
               "Time of one core, or of the card, per depth map, median."),
        *told,
    )  # fmt: skip
    return StageResult(metrics, tuple(warnings))


DENSIFY = Stage(
    name="densify",
    version=3,
    summary="Depth maps by PatchMatch stereo from photographs, as range maps.",
    options=DensifyOptions,
    reads=(
        *("photo_files", "photo_masks", "photo_poses", "oriented_images"),
        *("scan_inventory", "range_maps", "scan_masks", "scan_poses"),
    ),
    writes=(
        *("stereo_views", "depth_estimates", "better_estimates"),
        *("photo_range_maps", "photo_range_inventory"),
    ),
    needed=needed,
    run=run,
    libraries=("numpy", "numba", "opencv-contrib-python-headless", "pycolmap", "rawpy"),
    estimate=estimate,
    knobs=(
        Knob("image_px", (400, 800, 1600), quick=(400,)),
        Knob("neighbours", (2, 3, 5, 8), quick=(3,)),
        Knob("rounds", (0, 1, 2, 4), quick=(1,)),
        Knob("geometric", (False, True), quick=(False,)),
        Knob("patch_px", (5, 7, 9, 13), quick=()),
    ),
)
