"""Take the scans in: read, check, convert to metres, choose the project origin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from workbench.errors import InputError
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import apply, rigid
from workbench.metrics import Metric
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.project import Scene
from workbench.project.settings import StageOptions

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}
# Beyond this the scan's own coordinates are shifted, so that no later step loses digits.
_FAR_FROM_ORIGIN_M = 1e4


class IngestOptions(StageOptions):
    """Options of ``ingest``."""

    scan_unit: Literal["m", "cm", "mm", "inch", "foot"] = Field(
        "m", description="Unit of the coordinates in the scan files and of the poses."
    )
    missing_pose: Literal["place", "refuse", "identity"] = Field(
        "place",
        description="Scans without poses: have `register` place them by their shape, refuse, or "
        "take their coordinates as world.",
    )
    min_samples: int = Field(
        50, ge=3, description="A scan with fewer samples is taken for damaged."
    )


def needed(scene: Scene, options: IngestOptions) -> Need:
    if scene.scans:
        return Need(True, f"{scene.scans} scan file{'s' if scene.scans > 1 else ''} to take in")
    return Need(False, "no range scans")


def estimate(scene: Scene, options: IngestOptions) -> Estimate:
    # A text file unfolds to about as many bytes of arrays; one file per worker is open.
    per_file = scene.scan_bytes / max(scene.scans, 1)
    one = int(6 * per_file)
    return Estimate(one + 2**28, int(1.5 * scene.scan_bytes) + 2**24, item_bytes=one)


def run(job: Job[IngestOptions]) -> StageResult:
    from workbench.formats.scans import ScanListing, read_pose_files, require_matching_poses

    products, options = job.products, job.options
    listing = ScanListing(products.input_paths("scan_files"), products.input_paths("pose_files"))
    poses = read_pose_files(listing.pose_files)
    require_matching_poses(listing, poses)
    items: dict[str, dict[str, Any]] = {
        name: {
            "path": str(path),
            "content": products.input_hash(path),
            "name": name,
            "poses": {key: pose.tolist() for key, pose in poses.items()},
            "unit_m": METRES_PER_UNIT[options.scan_unit],
            "min_samples": options.min_samples,
        }
        for name, path in zip(listing.names, listing.files, strict=True)
    }
    summaries = job.tasks.map_items("reading scans", read_scan_file, items)
    scans = [scan for summary in summaries.values() for scan in summary["scans"]]
    unplaced = [scan["name"] for scan in scans if scan["world_from_scan"] is None]
    if unplaced and len(scans) > 1 and options.missing_pose == "refuse":
        raise InputError(
            "Some scans have no pose",
            found=", ".join(unplaced),
            expected="a pose in the scan file or in a .conf, .aln or scan_poses.json beside it",
            fix="add the poses, or --set ingest.missing_pose=place to place them by their shape, "
            "or =identity where the scans' own coordinates are already in one frame",
        )
    if options.missing_pose == "identity" or len(scans) == 1:
        for scan in scans:
            # Its coordinates are the world's, and were moved by the shift.
            own = rigid(np.eye(3), scan["scan_shift_m"]).tolist()
            scan["world_from_scan"] = scan["world_from_scan"] or own
    origin = project_origin(scans)
    products.save("scan_inventory", {"origin_m": origin, "scans": scans})
    products.remove_items_except("range_maps", {scan["name"] for scan in scans})
    return _result(scans, origin)


def read_scan_file(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One scan file: every range map in it, in metres, and what there is to say of it."""
    from workbench.formats.scans import read_scans

    poses = {key: np.array(pose) for key, pose in payload["poses"].items()}
    path = Path(payload["path"])
    described = []
    for reading in read_scans(path, poses, payload["name"]):
        scan = _in_metres(reading.range_map, payload["unit_m"])
        if len(scan) < payload["min_samples"]:
            raise InputError(
                "The scan holds too few samples",
                file=path,
                expected=f"at least {payload['min_samples']}",
                found=f"{len(scan)} usable samples in {scan.name}",
                fix="scan it again, leave it out, or lower ingest.min_samples",
            )
        scan, shift = _near_its_origin(scan)
        products.save("range_maps", scan, scan.name)
        described.append(_described(scan, shift, path.name, reading))
    return {"scans": described}


def project_origin(scans: list[dict[str, Any]]) -> list[float]:
    """The point all computing is done around: the middle of the scans, in whole metres.

    Whole metres are exact in float64, so adding the origin back at export loses nothing that
    the input had. Scans without a pose do not count; where none has one, the world is that of
    the first scan by name, in the coordinates of its file, and so is the middle.
    """
    posed = [s for s in scans if s["world_from_scan"] is not None]
    centres = [apply(np.array(s["world_from_scan"]), s["centre_in_scan_m"]) for s in posed]
    if not posed:
        first = min(scans, key=lambda s: str(s["name"]))
        centres = [np.add(first["centre_in_scan_m"], first["scan_shift_m"])]
    return [float(v) for v in np.round(np.median(centres, axis=0))]


def _in_metres(scan: RangeMap, unit_m: float) -> RangeMap:
    if unit_m == 1.0:
        return scan
    pose, viewpoint = scan.world_from_scan, scan.viewpoint_in_scan
    return replace(
        scan,
        points_in_scan=scan.points_in_scan * unit_m,
        viewpoint_in_scan=None if viewpoint is None else viewpoint * unit_m,
        world_from_scan=None if pose is None else rigid(pose[:3, :3], pose[:3, 3] * unit_m),
    )


def _near_its_origin(scan: RangeMap) -> tuple[RangeMap, list[float]]:
    """A scan in far coordinates (georeferenced, say) moved to its own middle, in whole metres."""
    middle = np.round(np.median(scan.points_in_scan, axis=0))
    if np.abs(middle).max() < _FAR_FROM_ORIGIN_M:
        return scan, [0.0, 0.0, 0.0]
    pose, viewpoint = scan.world_from_scan, scan.viewpoint_in_scan
    moved = replace(
        scan,
        points_in_scan=scan.points_in_scan - middle,
        viewpoint_in_scan=None if viewpoint is None else viewpoint - middle,
        world_from_scan=None if pose is None else rigid(pose[:3, :3], apply(pose, middle)),
    )
    return moved, [float(v) for v in middle]


def _described(scan: RangeMap, shift: list[float], file: str, reading: Any) -> dict[str, Any]:
    low, high = scan.points_in_scan.min(axis=0), scan.points_in_scan.max(axis=0)
    pose = scan.world_from_scan
    return {
        "name": scan.name,
        "file": file,
        "samples": len(scan),
        "dropped_nonfinite": reading.dropped_nonfinite,
        "grid": None if scan.grid is None else list(scan.grid.shape),
        "reflectance": scan.reflectance is not None,
        "reflectance_populations": _populations(scan),
        "color": scan.color is not None,
        "viewpoint_known": scan.viewpoint_in_scan is not None,
        "centre_in_scan_m": (0.5 * (low + high)).tolist(),
        "extent_m": (high - low).tolist(),
        "scan_shift_m": shift,
        "world_from_scan": None if pose is None else pose.tolist(),
        "notes": list(reading.notes),
    }


def _populations(scan: RangeMap) -> int | None:
    """Whether the scan's reflectance is of one kind or of two, for clutter shows there."""
    from workbench.masking.histograms import is_unimodal
    from workbench.masking.quantisation import ReflectanceLevels

    if scan.reflectance is None or not len(scan):
        return None
    low, high = np.percentile(scan.reflectance, [1, 99])
    if not high > low:
        return 1
    levels = np.clip((scan.reflectance - low) / (high - low), 0, 1)
    return 1 if is_unimodal(ReflectanceLevels(), [levels[None]]) else 2


def _result(scans: list[dict[str, Any]], origin: list[float]) -> StageResult:
    samples = sum(scan["samples"] for scan in scans)
    dropped = sum(scan["dropped_nonfinite"] for scan in scans)
    warnings = [
        f"{scan['name']}: {note}"
        for scan in scans
        for note in scan["notes"]
        if "from the pose file" not in note  # what the user asked for is no warning
    ]
    for scan in scans:
        extent = max(scan["extent_m"])
        if not 1e-4 < extent < 1e5:
            warnings.append(f"{scan['name']} is {extent:.3g} m large; is ingest.scan_unit right?")
    metrics = (
        Metric("scans", len(scans), "", "Range maps taken in."),
        Metric("samples", samples, "", "Samples in all range maps."),
        Metric("samples_dropped", dropped, "", "Samples without finite coordinates, left out."),
        Metric(
            "scans_on_a_grid",
            sum(s["grid"] is not None for s in scans),
            "",
            "Range maps that keep the scanner's own grid.",
        ),
        Metric(
            "scans_without_pose",
            sum(s["world_from_scan"] is None for s in scans),
            "",
            "Range maps that have yet to be placed by their shape.",
        ),
        Metric(
            "origin_distance",
            float(np.linalg.norm(origin)),
            "m",
            "Distance of the project origin from the world's.",
        ),
    )
    return StageResult(metrics, tuple(warnings))


INGEST = Stage(
    name="ingest",
    version=3,
    summary="Reads and checks the range scans, converts to metres, chooses the project origin.",
    options=IngestOptions,
    reads=("scan_files", "pose_files"),
    writes=("scan_inventory", "range_maps"),
    needed=needed,
    run=run,
    libraries=("numpy", "pye57"),
    estimate=estimate,
)
