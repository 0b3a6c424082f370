"""A small pipeline with the names of the real artefacts, and a project it can work on.

``ingest`` reads the scan files, ``register`` is needed where there are poses, ``fuse`` maps
items, ``export`` writes a file and ``verify`` reads all records.
"""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from workbench.errors import InputError
from workbench.metrics import Metric
from workbench.pipeline.stage import Job, Need, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.creation import create_project
from workbench.project.project import Project, Scene
from workbench.project.settings import StageOptions


class Window(StageOptions):
    """A group of options."""

    rows: int = Field(3, ge=1, le=9, description="Rows.")
    cols: int = Field(3, ge=1, le=9, description="Columns.")


class IngestOptions(StageOptions):
    """Options of ``ingest``."""

    scan_unit: Literal["m", "mm"] = Field("m", description="Unit.")
    first_line_only: bool = Field(True, description="Pass over what follows the first line.")
    threads: int = Field(
        1, ge=1, description="Threads.", json_schema_extra={"changes_result": False}
    )


class FuseOptions(StageOptions):
    """Options of ``fuse``."""

    thinning: float = Field(0.5, ge=0.0, le=10.0, description="Thinning | or none.")
    depth: int | Literal["auto"] = Field("auto", description="Depth.")
    window: Window = Field(Window(), description="The window.")


class NoOptions(StageOptions):
    """No options."""


class ExportOptions(StageOptions):
    """Options of ``export``."""

    ply: bool = Field(True, description="Write the PLY.")
    obj: bool = Field(True, description="Write the OBJ.")


def ingest(job: Job[IngestOptions]) -> StageResult:
    paths = job.products.input_paths("scan_files")
    lines = {path.name: path.read_text().splitlines() for path in paths}
    if job.options.first_line_only:
        lines = {name: of[:1] for name, of in lines.items()}
    job.products.save("scan_inventory", {"unit": job.options.scan_unit, "lines": lines})
    return StageResult((Metric("scans", len(paths), "", "Scans."),), ("all is well",))


def register(job: Job[NoOptions]) -> StageResult:
    inventory = job.products.load("scan_inventory")
    job.products.save("scan_poses", {name: [0, 0, 0] for name in inventory["lines"]})
    return StageResult()


def fuse(job: Job[FuseOptions]) -> StageResult:
    inventory = job.products.load("scan_inventory")
    poses = job.products.load_if_there("scan_poses")
    thinning = job.options.thinning
    items = {
        name.partition(".")[0]: {"name": name, "lines": lines, "thinning": thinning}
        for name, lines in inventory["lines"].items()
    }
    job.tasks.map_items("normals", normals_of, items)
    job.products.remove_items_except("oriented_scans", set(items))
    total = sum(job.products.load("oriented_scans", item)["n"].sum() for item in items)
    job.products.save("samples", {"total": total, "posed": poses is not None})
    return StageResult((Metric("total", int(total), "", "Total."),))


def normals_of(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """An item; the log tells how often it was done, ``FAKE_ITEM_SECONDS`` how long it takes."""
    time.sleep(float(os.environ.get("FAKE_ITEM_SECONDS", "0")))
    log = os.environ.get("FAKE_ITEM_LOG")
    if log:
        with open(log, "a") as file:
            file.write(payload["name"] + "\n")
    content = "".join(payload["lines"]).encode() or b"\0"
    products.save(
        "oriented_scans",
        {"n": np.frombuffer(content, np.uint8).astype(np.int64)},
        payload["name"].partition(".")[0],
    )
    return {"bytes": len(content), "pair": (1, 2)}


def matrix_product(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """An item whose last bits depend on the number of threads of BLAS."""
    rng = np.random.default_rng(payload["seed"])
    a, b = rng.normal(size=(2, 500, 500))
    products.save("oriented_scans", {"product": a @ b}, f"m{payload['seed']}")
    return {"pid": os.getpid() if payload.get("tell") else 0}


def refuse(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """An item with an error of ours."""
    raise InputError(
        "The scan is bad", file=f"{payload['name']}.ply", expected="order", found="chaos"
    )


def die(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """An item that takes its process along, as one that runs out of memory does."""
    if os.environ.get("FAKE_MAIN_PID") == str(os.getpid()):
        time.sleep(1.0)
        return {}
    os._exit(9)


def die_at_first(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """An item whose first workers are killed in its middle; the log tells of every beginning."""
    log = Path(payload["log"])
    with open(log, "a") as file:
        file.write("begun\n")
    if len(log.read_text().split()) <= payload["deaths"]:
        os.kill(os.getpid(), signal.SIGKILL)
    products.save("oriented_scans", {"n": np.arange(payload["deaths"])}, payload["name"])
    return {"begun": len(log.read_text().split())}


def export(job: Job[ExportOptions]) -> StageResult:
    samples = job.products.load("samples")
    for name, wanted in (("surface_ply", job.options.ply), ("surface_obj", job.options.obj)):
        if wanted:
            with job.products.writing(name) as path:
                path.write_text(f"total {samples['total']}\n")
    return StageResult()


def verify(job: Job[NoOptions]) -> StageResult:
    names = [name for name in job.products.items("records") if name not in job.left_out]
    job.products.save("report_json", {"stages": names, "left_out": dict(job.left_out)})
    with job.products.writing("report_html") as path:
        path.write_text("<p>report</p>")
    return StageResult()


def _always(scene: Scene, options: Any) -> Need:
    return Need(True, "always needed")


def _with_poses(scene: Scene, options: Any) -> Need:
    return Need(True, "poses to refine") if scene.poses else Need(False, "no poses")


PIPELINE: tuple[Stage[Any], ...] = (
    Stage("ingest", 1, "Reads.", IngestOptions, ("scan_files", "pose_files"), ("scan_inventory",),
          _always, ingest, libraries=("numpy",)),
    Stage("register", 1, "Registers.", NoOptions, ("scan_inventory",), ("scan_poses",),
          _with_poses, register),
    Stage("fuse", 1, "Fuses.", FuseOptions, ("scan_inventory", "scan_poses"),
          ("oriented_scans", "samples"), _always, fuse),
    Stage("export", 1, "Exports.", ExportOptions, ("samples",), ("surface_ply", "surface_obj"),
          _always, export),
    Stage("verify", 1, "Verifies.", NoOptions, ("surface_ply", "records", "simulation"),
          ("report_json", "report_html"), _always, verify, reads_truth=True),
)  # fmt: skip


def with_stage(name: str, **changes: Any) -> tuple[Stage[Any], ...]:
    """The pipeline with one stage changed."""
    return tuple(replace(s, **changes) if s.name == name else s for s in PIPELINE)


def fake_project(folder: Path, scans: int = 2, poses: bool = False) -> Project:
    """A project ``folder/project`` beside its scans ``folder/scans``."""
    place = folder / "scans"
    place.mkdir(parents=True)
    for number in range(scans):
        (place / f"s{number}.xyz").write_text(f"{number} 0 0\n1 1 1\n")
    if poses:
        (place / "poses.conf").write_text("bmesh s0.xyz 0 0 0 0 0 0 1\n")
    return create_project(folder / "project", scans=[place])
