"""One consolidated set of samples from all scans."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from workbench.errors import InputError
from workbench.geometry.transforms import rigid
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Products, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.project import Scene
from workbench.project.settings import StageOptions

if TYPE_CHECKING:
    from workbench.geometry.samples import Samples

_THINNING = {"range_maps": 0.5, "photo_range_maps": 2.0}


class FuseOptions(StageOptions):
    """Options of ``fuse``."""

    half_window: int = Field(
        2, ge=1, le=8, description="Half width of the window a normal is fitted in, grid cells."
    )
    step_factor: float = Field(
        4.0,
        gt=1.0,
        le=50.0,
        description="Neighbours further apart than this many sample distances are across a step.",
    )
    min_neighbours: int = Field(
        6, ge=3, le=200, description="Samples with fewer neighbours on their surface are dropped."
    )
    max_incidence_deg: float = Field(
        80.0, gt=0.0, lt=90.0, description="Samples seen more obliquely are dropped."
    )
    border_erosion: int = Field(
        1, ge=0, le=10, description="Rings dropped along depth steps, where pixels are mixed."
    )
    thinning: Annotated[float, Field(ge=0.0, le=10.0)] | Literal["auto"] = Field(
        "auto",
        description="Samples within this many sample distances become one; 0 keeps all. auto: "
        "0.5, and 2 of photographs, whose neighbouring depths come from the same patches.",
    )
    memory_samples: int = Field(
        5_000_000,
        ge=1_000,
        le=1_000_000_000,
        description="More samples than this are not held in memory but in a layered point cloud "
        "on disk (Jaspe 2018, 3.3.1).",
    )


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

    products, options = job.products, job.options
    inventory, poses, maps = _sources(products)
    judged = options.model_dump(exclude={"thinning", "memory_samples"})
    # A scan that register left out has no pose.
    entries = [entry for entry in inventory["scans"] if entry["name"] in poses]
    names = [entry["name"] for entry in entries]
    masked = products.items("scan_masks")
    items = {
        name: {
            "name": name,
            "maps": maps,
            "content": products.content_hash(maps, name),
            "mask": products.content_hash("scan_masks", name) if name in masked else None,
            "settings": judged,
        }
        for name in names
    }
    found = job.tasks.map_items("normals", orient_scan, items)
    products.remove_items_except("oriented_scans", set(names))
    total = sum(summary["samples"] for summary in found.values())
    if not total:
        raise InputError(
            "No sample of any scan can be trusted",
            fix="loosen fuse.max_incidence_deg or fuse.min_neighbours, or check the scans",
        )
    spacings = [products.load("oriented_scans", name, only=["spacing_m"]) for name in names]
    spacing = float(np.median(np.concatenate([of["spacing_m"] for of in spacings])))
    thinning = _THINNING[maps] if options.thinning == "auto" else options.thinning
    cell = thinning * spacing
    trusted = [entry for entry in entries if found[entry["name"]]["samples"]]
    # One scan without colour, and the samples have none.
    colored = all(entry["color"] for entry in trusted)
    placed = PlacedScans(products, inventory, poses, colored)
    if total <= options.memory_samples:
        samples = merged(joined(list(placed)), cell)
        products.save("samples", samples.arrays())
        kept = len(samples)
    else:
        kept = _merged_on_disk(job, placed, total, cell)
    return StageResult(_metrics(inventory, total, kept, spacing, total > options.memory_samples))


def _sources(products: Products) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Inventory and poses of the scans, or of the photographs' depth maps, and what holds them."""
    if products.is_there("photo_range_inventory"):
        inventory = products.load("photo_range_inventory")
        return inventory, {entry["name"]: entry for entry in inventory["scans"]}, "photo_range_maps"
    return products.load("scan_inventory"), products.load("scan_poses")["scans"], "range_maps"


class PlacedScans:
    """Every scan's trusted samples in the project frame, one scan in memory at a time."""

    def __init__(
        self, products: Any, inventory: dict[str, Any], poses: dict[str, Any], colored: bool
    ) -> None:
        self._products, self._inventory, self._poses = products, inventory, poses
        self.colored = colored

    def __iter__(self) -> Iterator[Samples]:
        from workbench.cloud.fusion import placed_samples
        from workbench.geometry.orientedscan import OrientedScan

        to_project = rigid(np.eye(3), -np.array(self._inventory["origin_m"]))
        for number, entry in enumerate(self._inventory["scans"]):
            if entry["name"] not in self._poses:
                continue
            arrays = self._products.load("oriented_scans", entry["name"])
            color, sigma = arrays.pop("color", None), arrays.pop("sigma_m", None)
            scan = OrientedScan(**arrays)
            world_from_scan = np.array(self._poses[entry["name"]]["world_from_scan"])
            pose = to_project @ world_from_scan @ rigid(np.eye(3), entry["scan_shift_m"])
            yield placed_samples(scan, pose, color if self.colored else None, number, sigma)


def _merged_on_disk(job: Job[FuseOptions], placed: PlacedScans, total: int, cell_m: float) -> int:
    """Merge part by part of space and store as a layered cloud; returns how many samples."""
    from workbench.cloud.building import build_cloud
    from workbench.cloud.sample_cloud import SampleBlocks, samples_schema
    from workbench.cloud.sample_merging import MergedParts

    schema = samples_schema(placed.colored)
    with (
        job.products.writing("sample_cloud") as path,
        TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder,
    ):
        unmerged, merged = Path(folder) / "unmerged", Path(folder) / "merged"
        with job.progress.step(f"sorting {total} samples by place"):
            build_cloud(unmerged, SampleBlocks(placed), schema)
        with job.progress.step("merging and storing them"):
            parts = MergedParts(unmerged, cell_m, job.options.memory_samples // 4)
            report = build_cloud(merged, SampleBlocks(parts), schema)
        os.replace(merged, path)
    return report.samples


def orient_scan(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One scan: its trusted samples with normals."""
    from workbench.geometry.orientedscan import OrientationSettings, orient

    scan = products.load(payload["maps"], payload["name"])
    if payload["mask"]:
        scan = scan.masked(products.load("scan_masks", payload["name"]))
    oriented = orient(scan, OrientationSettings(**payload["settings"]))
    arrays = {name: getattr(oriented, name) for name in oriented.__dataclass_fields__}
    for told in ("color", "sigma_m"):
        if getattr(scan, told) is not None:
            arrays[told] = getattr(scan, told)[oriented.source]
    products.save("oriented_scans", arrays, payload["name"])
    return {"samples": len(oriented)}


def _metrics(
    inventory: dict[str, Any], trusted: int, kept: int, spacing: float, on_disk: bool
) -> tuple[Metric, ...]:
    given = sum(entry["samples"] for entry in inventory["scans"])
    return (
        Metric("samples_trusted", trusted, "", "Samples not grazing, isolated or at a step."),
        Metric("share_trusted", trusted / given, "", "Their share of all samples."),
        Metric("samples", kept, "", "Samples after duplicates became one."),
        Metric("sample_spacing", spacing, "m", "Median distance between neighbouring samples."),
        Metric("on_disk", on_disk, "", "Whether a point cloud on disk was needed to hold them."),
    )


FUSE = Stage(
    name="fuse",
    version=3,
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
