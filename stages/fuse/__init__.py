"""One consolidated set of samples from all scans."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.fuse.filling import Filled, filled_by
from stages.fuse.options import FuseOptions
from stages.fuse.placing import PlacedSources
from workbench.errors import InputError
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.shape_sources import PHOTOGRAPHED, SCANNED, ShapeSource, shape_sources
from workbench.pipeline.stage import Estimate, Job, Need, Products, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.project import Scene

if TYPE_CHECKING:
    from workbench.cloud.sample_source import SampleSource

_THINNING = {SCANNED: 0.5, PHOTOGRAPHED: 2.0}


def needed(scene: Scene, options: FuseOptions) -> Need:
    if scene.geometry:
        return Need(False, "the surface was made elsewhere")
    if not scene.has_surface:
        return Need(False, "neither range scans nor three photographs")
    return Need(True, "samples to consolidate")


def estimate(scene: Scene, options: FuseOptions) -> Estimate:
    one = 20 * scene.shape_bytes // scene.shape_parts
    memory, disk = 20 * scene.shape_bytes + 2**28, 8 * scene.shape_bytes + 2**24
    return Estimate(memory, disk, item_bytes=one)


def run(job: Job[FuseOptions]) -> StageResult:
    from workbench.cloud.fusion import joined, merged
    from workbench.cloud.sample_source import HeldSamples

    products, options = job.products, job.options
    # A scan that register left out has no pose.
    every = shape_sources(products)
    sources = [source for source in every if source.project_from_map is not None]
    found = _oriented(job, sources)
    scans = [source for source in sources if source.maps == SCANNED]
    # Photographs alone tell the shape, or fill what scans missed.
    filling = [source for source in sources if scans and source.maps == PHOTOGRAPHED]
    telling = scans or sources
    total = sum(found[source.name] for source in telling)
    if not total:
        raise InputError(
            "No sample of any scan can be trusted",
            fix="loosen fuse.max_incidence_deg or fuse.min_neighbours, or check the scans",
        )
    spacing = _spacing(products, telling)
    cell = _cell_factor(options, telling) * spacing
    used = [source for source in (*telling, *filling) if found[source.name]]
    # One scan without colour, and the samples have none.
    colored = all(source.entry["color"] for source in used)
    placed = PlacedSources(products, telling, colored)
    fill_cell = _cell_factor(options, filling) * _spacing(products, filling) if filling else 0.0
    fill = partial(filled_by, job, sources=filling, cell_m=fill_cell)
    on_disk = total > options.memory_samples
    if on_disk:
        kept, filled = _merged_on_disk(job, placed, total, cell, spacing, fill)
    else:
        samples = merged(joined(list(placed)), cell)
        filled = fill(HeldSamples(samples), max(cell, spacing))
        kept = len(samples) + len(filled)
        products.save("samples", joined([samples, *filled.samples]).arrays())
    given = sum(s.entry["samples"] for s in every if s.maps == telling[0].maps)
    metrics = (
        Metric("samples_trusted", total, "", "Samples not grazing, isolated or at a step."),
        Metric("share_trusted", total / given, "", "Their share of all samples."),
        Metric("samples", kept, "", "Samples after duplicates became one."),
        Metric("sample_spacing", spacing, "m", "Median distance between neighbouring samples."),
        Metric("on_disk", on_disk, "", "Whether a point cloud on disk was needed to hold them."),
        *filled.metrics,
    )  # fmt: skip
    warnings = list(filled.warnings)
    if filling and not colored and all(source.entry["color"] for source in scans):
        warnings.append("the scans' own colours are left out: photographed samples have none")
    return StageResult(metrics, tuple(warnings))


def _oriented(job: Job[FuseOptions], sources: Sequence[ShapeSource]) -> dict[str, int]:
    """Trusted samples with normals of all sources, stored; returns how many."""
    products = job.products
    masked = products.items("scan_masks")
    judged = job.options.model_dump(exclude={"thinning", "memory_samples"})
    items = {}
    for source in sources:
        of_scan = source.maps == SCANNED and source.item in masked
        items[source.name] = {
            "name": source.name,
            "item": source.item,
            "maps": source.maps,
            "content": products.content_hash(source.maps, source.item),
            "mask": products.content_hash("scan_masks", source.item) if of_scan else None,
            "settings": judged,
        }
    found = job.tasks.map_items("normals", orient_scan, items)
    products.remove_items_except("oriented_scans", set(items))
    return {name: summary["samples"] for name, summary in found.items()}


def _spacing(products: Products, sources: Sequence[ShapeSource]) -> float:
    """Median distance between neighbouring samples; 0 where there are none."""
    parts = [products.load("oriented_scans", s.name, only=["spacing_m"]) for s in sources]
    every = np.concatenate([part["spacing_m"] for part in parts])
    return float(np.median(every)) if len(every) else 0.0


def _cell_factor(options: FuseOptions, sources: Sequence[ShapeSource]) -> float:
    """Edge of the cells that samples are merged in, in distances between samples."""
    return _THINNING[sources[0].maps] if options.thinning == "auto" else options.thinning


def _merged_on_disk(
    job: Job[FuseOptions],
    placed: PlacedSources,
    total: int,
    cell_m: float,
    spacing_m: float,
    fill: Callable[[SampleSource, float], Filled],
) -> tuple[int, Filled]:
    """Merge part by part of space and store as a layered cloud; how many samples, and the fill."""
    from workbench.cloud.building import build_cloud
    from workbench.cloud.sample_cloud import SampleBlocks, samples_schema
    from workbench.cloud.sample_merging import MergedParts
    from workbench.cloud.sample_source import opened_samples

    schema = samples_schema(placed.colored)
    with (
        job.products.writing("sample_cloud") as path,
        TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder,
    ):
        unmerged, merged = Path(folder) / "unmerged", Path(folder) / "merged"
        with job.progress.step(f"sorting {total} samples by place"):
            build_cloud(unmerged, SampleBlocks(placed), schema)
        with opened_samples(None, unmerged) as source:
            filled = fill(source, spacing_m)
        with job.progress.step("merging and storing them"):
            most = job.options.memory_samples // 4
            parts = MergedParts(unmerged, cell_m, most, filled.samples)
            report = build_cloud(merged, SampleBlocks(parts), schema)
        os.replace(merged, path)
    return report.samples, filled


def orient_scan(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One scan: its trusted samples with normals."""
    from workbench.geometry.orientedscan import OrientationSettings, orient

    scan = products.load(payload["maps"], payload["item"])
    if payload["mask"]:
        scan = scan.masked(products.load("scan_masks", payload["item"]))
    oriented = orient(scan, OrientationSettings(**payload["settings"]))
    arrays = {name: getattr(oriented, name) for name in oriented.__dataclass_fields__}
    for told in ("color", "sigma_m"):
        if getattr(scan, told) is not None:
            arrays[told] = getattr(scan, told)[oriented.source]
    products.save("oriented_scans", arrays, payload["name"])
    return {"samples": len(oriented)}


FUSE = Stage(
    name="fuse",
    version=4,
    summary="Normals by range grid, mixed pixels out, duplicates merged, confidence kept.",
    options=FuseOptions,
    reads=(
        *("scan_inventory", "range_maps", "scan_masks", "scan_poses"),
        *("photo_range_inventory", "photo_range_maps"),
    ),
    writes=("oriented_scans", "samples", "sample_cloud"),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "open3d", "lmdb", "zstandard"),
    estimate=estimate,
    knobs=(
        Knob("thinning", (0.0, 0.5, 1.0, 2.0, 4.0), quick=(0.0, 2.0)),
        Knob("half_window", (1, 2, 3, 4), quick=(1,)),
    ),
)
