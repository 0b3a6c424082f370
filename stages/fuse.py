"""One consolidated set of samples from all scans."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from workbench.errors import InputError
from workbench.geometry.transforms import rigid
from workbench.metrics import Metric
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.project import Scene
from workbench.project.settings import StageOptions


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
    thinning: float = Field(
        0.5,
        ge=0.0,
        le=10.0,
        description="Samples within this many sample distances become one; 0 keeps all.",
    )


def needed(scene: Scene, options: FuseOptions) -> Need:
    if scene.geometry:
        return Need(False, "the surface was made elsewhere")
    if not scene.scans:
        return Need(False, "no range scans")
    return Need(True, "samples to consolidate")


def estimate(scene: Scene, options: FuseOptions) -> Estimate:
    return Estimate(20 * scene.scan_bytes + 2**28, 8 * scene.scan_bytes + 2**24)


def run(job: Job[FuseOptions]) -> StageResult:
    from workbench.cloud.fusion import merge_scans
    from workbench.geometry.orientedscan import OrientedScan

    products, options = job.products, job.options
    inventory, poses = products.load("scan_inventory"), products.load("scan_poses")
    judged = options.model_dump(exclude={"thinning"})
    names = [entry["name"] for entry in inventory["scans"]]
    items = {
        name: {"name": name, "content": products.item_hash("range_maps", name)} | judged
        for name in names
    }
    job.tasks.map_items("normals", orient_scan, items)
    products.remove_items_except("oriented_scans", set(names))
    to_project = rigid(np.eye(3), -np.array(inventory["origin_m"]))
    scans, colors, placed = [], [], []
    for entry in inventory["scans"]:
        arrays = products.load("oriented_scans", entry["name"])
        colors.append(arrays.pop("color", None))
        scans.append(OrientedScan(**arrays))
        world_from_scan = np.array(poses["scans"][entry["name"]]["world_from_scan"])
        placed.append(to_project @ world_from_scan @ rigid(np.eye(3), entry["scan_shift_m"]))
    total = sum(len(scan) for scan in scans)
    if not total:
        raise InputError(
            "No sample of any scan can be trusted",
            fix="loosen fuse.max_incidence_deg or fuse.min_neighbours, or check the scans",
        )
    spacing = float(np.median(np.concatenate([scan.spacing_m for scan in scans])))
    samples = merge_scans(scans, placed, colors, options.thinning * spacing)
    products.save("samples", samples.arrays())
    return StageResult(_metrics(inventory, total, len(samples), spacing))


def orient_scan(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One scan: its trusted samples with normals."""
    from workbench.geometry.orientedscan import OrientationSettings, orient

    scan = products.load("range_maps", payload["name"])
    settings = {k: v for k, v in payload.items() if k not in ("name", "content")}
    oriented = orient(scan, OrientationSettings(**settings))
    arrays = {name: getattr(oriented, name) for name in oriented.__dataclass_fields__}
    if scan.color is not None:
        arrays["color"] = scan.color[oriented.source]
    products.save("oriented_scans", arrays, payload["name"])
    return {"samples": len(oriented)}


def _metrics(
    inventory: dict[str, Any], trusted: int, kept: int, spacing: float
) -> tuple[Metric, ...]:
    given = sum(entry["samples"] for entry in inventory["scans"])
    return (
        Metric("samples_trusted", trusted, "", "Samples not grazing, isolated or at a step."),
        Metric("share_trusted", trusted / given, "", "Their share of all samples."),
        Metric("samples", kept, "", "Samples after duplicates became one."),
        Metric("sample_spacing", spacing, "m", "Median distance between neighbouring samples."),
    )


FUSE = Stage(
    name="fuse",
    version=1,
    summary="Normals by range grid, mixed pixels out, duplicates merged, confidence kept.",
    options=FuseOptions,
    reads=("scan_inventory", "range_maps", "scan_poses"),
    writes=("oriented_scans", "samples"),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "open3d"),
    estimate=estimate,
)
