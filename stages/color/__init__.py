"""Colour of the surface from the photographs, free of their flash."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.color.anchoring import anchored_level
from stages.color.cloud import colored_cloud, see_cloud
from stages.color.flashing import FoundFlash, found_flash, with_leveled_gains
from stages.color.items import light_photo, see_photo
from stages.color.options import ColorOptions
from stages.color.photographs import Photographs, Together
from stages.color.telling import color_metrics, color_warnings, flash_document, flash_metrics
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.photo_surface import surface_mesh, told_photo, told_surface
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.project import NO_SURFACE, Scene

if TYPE_CHECKING:
    from workbench.color.blending import Blending
    from workbench.color.inpainting import Inpainting
    from workbench.geometry.mesh import TriangleMesh

# Shadows are looked for from a flash in steps of this share of the distance: a photograph that
# is added moves the flash by less, and the shadows of the others need not be found again.
_SHADOW_STEP = 0.005


def needed(scene: Scene, options: ColorOptions) -> Need:
    if not scene.photos:
        return Need(False, "no photographs")
    if not scene.has_surface:
        return Need(False, f"no surface to colour: {NO_SURFACE}")
    return Need(True, f"{scene.photos} photographs to colour the surface with")


def estimate(scene: Scene, options: ColorOptions) -> Estimate:
    # A photograph of 24 million pixels takes some 3 GiB of buffers, one per worker. Each
    # vertex is told by a quarter of the photographs at most, at 32 bytes each.
    vertices = scene.shape_bytes // 16 + 2**16
    photo = 3 * 2**30
    disk = 40 * vertices * max(1, scene.photos // 4)
    return Estimate(photo + 400 * vertices, disk, item_bytes=photo + 200 * vertices)


@dataclass(frozen=True)
class _Subject:
    """The surface, and what the photographs show of it.

    ``flashed`` and ``unlit`` are the photographs with and without flash, ``told`` whether a file
    says that one fired, ``payloads`` what is asked of each, ``seconds`` the time a photograph
    took, ``space`` the colours' space.
    """

    mesh: TriangleMesh
    flashed: Photographs
    unlit: Photographs
    told: bool
    payloads: Mapping[str, dict[str, Any]]
    seconds: float
    space: str


def run(job: Job[ColorOptions]) -> StageResult:
    from workbench.color.blending import blended
    from workbench.color.blending_colors import level_of
    from workbench.color.blending_seams import seam_steps

    products, options = job.products, job.options
    poses = products.load("photo_poses")
    if poses["frame"] != "world":
        return StageResult(
            warnings=("nothing was coloured: the photographs are not oriented onto the surface",)
        )
    subject = _subject(job, poses["photos"])
    everything = replace(subject.flashed, names=list(subject.payloads))
    count, sets = everything.told_twice()
    flash, flashed = _lit(job, subject, count)
    level = anchored_level(products, flash)
    flashed = replace(flashed, gains={n: level.gain * g for n, g in flash.gains.items()})
    unlit = _leveled_onto(subject.unlit, flashed)
    with job.progress.step("blending"):
        together = Together((flashed, unlit))
        blending = blended(together, len(count), options.robust, options.least_weight)
        levels = level_of(blending.colors)
        seams = seam_steps(together, levels, sets, subject.mesh.triangles)
    inpainting = _inpainted(job, subject.mesh, blending) if options.inpaint else None
    colors = blending.colors if inpainting is None else inpainting.colors
    _save(job, subject, blending, colors)
    products.save(
        "flash",
        flash_document(flash, {**flashed.gains, **unlit.gains}, unlit.names, level, subject.space),
    )
    of_the_cloud = _cloud(job, subject, flash, flashed, unlit)
    metrics = [
        Metric("photographs", len(subject.payloads), "", "Photographs blended."),
        Metric("without_flash", len(unlit.names), "", "Of them, taken without flash."),
        *flash_metrics(flash),
        *color_metrics(blending, inpainting, colors, seams),
        *of_the_cloud,
        Metric("photo_seconds", subject.seconds, "s", "Time per photograph, median."),
    ]
    warnings = color_warnings(flash, unlit.names, level, inpainting)
    return StageResult(tuple(metrics), warnings)


def _subject(job: Job[ColorOptions], poses: Mapping[str, Any]) -> _Subject:
    """Look through every photograph that is placed."""
    products = job.products
    surface = told_surface(products)
    mesh = surface_mesh(products, surface)
    inventory = products.load("photo_inventory")
    entries = {e["name"]: e for e in inventory["photos"] if not e["is_chart"]}
    payloads = _payloads(job, {n: poses[n] for n in entries if n in poses}, surface)
    seen = job.tasks.map_items("looking through photographs", see_photo, payloads)
    products.remove_items_except("photo_observations", set(seen))
    photos = Photographs(
        products,
        list(payloads),
        {name: np.array(told["camera"]["camera_from_world"]) for name, told in payloads.items()},
        mesh.vertices,
    )

    # A file that does not tell counts as taken with a flash: that is what this is made for.
    def fired(name: str) -> bool:
        return entries[name]["flash_fired"] is not False

    return _Subject(
        mesh,
        photos.of(fired),
        photos.of(lambda name: not fired(name)),
        any(entries[name]["flash_fired"] for name in payloads),
        payloads,
        float(np.median([item["seconds"] for item in seen.values()])) if seen else 0.0,
        str(inventory["space"]),
    )


def _payloads(
    job: Job[ColorOptions], poses: Mapping[str, Any], surface: dict[str, Any]
) -> dict[str, dict[str, Any]]:
    """What is asked of each photograph, with all that can change the answer."""
    products, options = job.products, job.options
    masked = set(products.items("photo_masks"))
    weights = {
        name: getattr(options, name) for name in ("feather", "angle_power", "sharpness_power")
    }
    return {
        name: told_photo(products, name, pose, name in masked)
        | {
            "surface": surface,
            "image_px": options.image_px,
            "normal_px": options.normal_px,
            "weights": weights,
        }
        for name, pose in poses.items()
    }


def _lit(
    job: Job[ColorOptions], subject: _Subject, count: NDArray[np.int64]
) -> tuple[FoundFlash, Photographs]:
    """The flash, and the photographs taken with it, clear of its shadows."""
    photos, products = subject.flashed, job.products
    flash = found_flash(job, photos, count, told=subject.told)
    if flash.light is None:
        products.remove_items_except("photo_lighting", set())
        return with_leveled_gains(flash, photos), photos
    asked = ("name", "surface", "image_px", "camera")
    items = {
        name: {key: subject.payloads[name][key] for key in asked}
        | {
            "flash": _shadow_place(flash),
            "feather": job.options.feather,
            "seen": products.content_hash("photo_observations", name),
        }
        for name in photos.names
    }
    job.tasks.map_items("looking for the flash's shadows", light_photo, items)
    products.remove_items_except("photo_lighting", set(items))
    photos = replace(photos, light=flash.light)
    flash = with_leveled_gains(flash, photos)
    return flash, photos


def _shadow_place(flash: FoundFlash) -> list[float] | None:
    """Where the flash is taken to be for its shadows, in the camera; None without a flash."""
    if flash.light is None:
        return None
    step = _SHADOW_STEP * flash.light.reference_distance
    place: list[float] = (np.rint(flash.light.position_in_camera / step) * step).tolist()
    return place


def _cloud(
    job: Job[ColorOptions],
    subject: _Subject,
    flash: FoundFlash,
    flashed: Photographs,
    unlit: Photographs,
) -> list[Metric]:
    """Colour the cloud too, where the samples are in one."""
    products = job.products
    if products.load_if_there("sample_cloud") is None:
        products.remove_items_except("cloud_observations", set())
        return []
    content = products.content_hash("sample_cloud")
    items = {
        name: payload
        | {"cloud": content, "flash": _shadow_place(flash) if name in flashed.names else None}
        for name, payload in subject.payloads.items()
    }
    job.tasks.map_items("looking at the cloud", see_cloud, items)
    products.remove_items_except("cloud_observations", set(items))
    with job.progress.step("blending onto the cloud"):
        return colored_cloud(job, (flashed, unlit))


def _leveled_onto(photos: Photographs, others: Photographs) -> Photographs:
    """Photographs in other light, brought to the level of what the others tell."""
    from workbench.color.blending import BlendSums
    from workbench.color.blending_levels import gains_against, leveled_gains

    if not photos.names:
        return photos
    if not others.names:
        gains = leveled_gains(photos, len(photos.points))
    else:
        sums = BlendSums(len(photos.points))
        for photo in others:
            sums.add(photo)
        gains = gains_against(photos, sums)
    return replace(photos, gains={n: float(g) for n, g in zip(photos.names, gains, strict=True)})


def _inpainted(job: Job[ColorOptions], mesh: TriangleMesh, blending: Blending) -> Inpainting:
    """Colour spread over the vertices that no photograph tells."""
    from workbench.color.diffusion_graph import edges_of_mesh, sample_graph
    from workbench.color.inpainting import InpaintingSettings, inpainted
    from workbench.geometry.mesh import vertex_normals

    with job.progress.step("inpainting"):
        edges = edges_of_mesh(mesh.triangles, len(mesh.vertices), blending.weights == 0.0)
        graph = sample_graph(edges, mesh.vertices, vertex_normals(mesh))
        settings = InpaintingSettings(max_cycles=job.options.inpaint_cycles)
        return inpainted(blending.colors, blending.weights, graph, settings)


def _save(
    job: Job[ColorOptions], subject: _Subject, blending: Blending, colors: NDArray[np.float64]
) -> None:
    from workbench.surface.provenance import INPAINTED, PHOTOGRAPHED, UNCOLORED

    known = np.isfinite(colors).all(axis=1)
    flags = np.where(blending.weights > 0.0, PHOTOGRAPHED, np.where(known, INPAINTED, UNCOLORED))
    job.products.save(
        "surface_color",
        {
            "color": colors.astype(np.float32),
            "color_provenance": flags.astype(np.uint8),
            "weight": blending.weights,
            "photos": blending.photos,
            "scatter": blending.scatter.astype(np.float32),
            "space": np.array(subject.space),
        },
    )


COLOR = Stage(
    name="color",
    version=2,
    summary="Blends the photographs onto the surface, free of their flash, and inpaints the rest.",
    options=ColorOptions,
    reads=(
        *(
            "geometry_file",
            "surface",
            "sample_cloud",
            "photo_poses",
            "photo_inventory",
            "color_calibration",
        ),
        *("developed_photos", "unclipped_masks", "photo_masks"),
    ),
    writes=(
        *("photo_observations", "photo_lighting", "cloud_observations"),
        *("flash", "surface_color", "colored_cloud"),
    ),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "numba", "open3d", "pycolmap", "opencv-contrib-python-headless"),
    estimate=estimate,
    knobs=(
        Knob("image_px", (400, 800, 1600, 3200, 6400), quick=(400,)),
        Knob("inpaint_cycles", (5, 10, 20, 60), quick=(10,)),
    ),
)
