"""Running what the plan says: check everything, do the work, record last."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import psutil

from workbench.errors import InputError, WorkbenchError
from workbench.pipeline.freshness import fingerprint, output_hashes, settings_hash, state_of
from workbench.pipeline.meter import Meter
from workbench.pipeline.planner import Pipeline, PlannedStage, make_plan, needed_for, selected
from workbench.pipeline.progress import Progress, format_seconds
from workbench.pipeline.records import RecordFolder, host_facts, library_versions, utc_now
from workbench.pipeline.stage import Job, Products
from workbench.pipeline.tasks import Tasks
from workbench.project.artefacts import ARTEFACTS
from workbench.project.lock import project_lock
from workbench.project.project import Project
from workbench.project.settings import StageSettings


@dataclass(frozen=True)
class RunRequest:
    """What the user asked for.

    Attributes
    ----------
    first, last, only : stage names that bound the run.
    target : run this stage and what it needs.
    force : do the selected stages again even where they are fresh.
    overrides : ``--set`` values.
    workers : processes for independent items; None for one per core.
    cluster : address of a Dask scheduler.
    """

    first: str | None = None
    last: str | None = None
    only: str | None = None
    target: str | None = None
    force: bool = False
    overrides: StageSettings | None = None
    workers: int | None = None
    cluster: str | None = None


def run_pipeline(
    pipeline: Pipeline, project: Project, request: RunRequest, progress: Progress
) -> list[dict[str, Any]]:
    """Bring the requested stages up to date.

    Returns
    -------
    One dict per stage: ``name, action, reason, seconds, peak_rss_bytes, metrics, warnings``,
    where ``action`` is ``run`` (done now), ``fresh`` or ``left out``.

    Raises
    ------
    WorkbenchError
        The first error of a stage; what was finished before it stays finished.
    """
    with project_lock(project.root):
        try:
            plan = make_plan(pipeline, project, request.overrides)
            chosen = selected(plan, first=request.first, last=request.last, only=request.only)
            if request.target is not None:
                chosen = needed_for(plan, request.target)
            _check_inputs_of_first(project, plan, chosen)
            _check_room(project, chosen)
            left_out = {p.stage.name: p.reason for p in plan if p.action == "left out"}
            forced = {p.stage.name for p in chosen} if request.force else set()
            if request.force and request.target is not None:
                forced = {request.target}
            return [
                _run_stage(project, planned, request, progress, left_out, forced)
                for planned in chosen
            ]
        finally:
            project.hashes.save()


def _run_stage(
    project: Project,
    planned: PlannedStage,
    request: RunRequest,
    progress: Progress,
    left_out: Mapping[str, str],
    forced: set[str],
) -> dict[str, Any]:
    stage, options = planned.stage, planned.options
    outcome: dict[str, Any] = {
        "name": stage.name,
        "action": "left out",
        "reason": planned.reason,
        "seconds": 0.0,
        "peak_rss_bytes": 0,
        "metrics": [],
        "warnings": [],
    }
    if planned.action == "left out":
        progress.line(f"{stage.name}: left out — {planned.reason}")
        return outcome
    folder = RecordFolder(project, stage.name)
    # Asked again here: a stage before this one may have given the same bytes as last time.
    state = state_of(project, stage, options, planned.absent)
    if state.state == "fresh" and stage.name not in forced:
        record = folder.read() or {}
        progress.line(f"{stage.name}: fresh — {state.reason}")
        kept = {key: record.get(key, []) for key in ("metrics", "warnings")}
        return outcome | kept | {"action": "fresh", "reason": state.reason}

    reason = "forced" if stage.name in forced else planned.reason
    progress.line(f"{stage.name}: {reason}")
    started, inputs = utc_now(), fingerprint(project, stage, options, planned.absent)
    folder.start()
    if stage.name in forced:
        shutil.rmtree(folder.items_folder, ignore_errors=True)
    job = Job(
        products=Products(project, stage.reads, stage.writes, planned.absent),
        options=options,
        scene=project.scene(),
        progress=progress,
        tasks=Tasks(
            root=project.root,
            stage=stage.name,
            fingerprint=settings_hash(stage, options),
            hashes=project.hashes,
            progress=progress,
            workers=request.workers or os.cpu_count() or 1,
            cluster=request.cluster,
        ),
        left_out=left_out,
    )
    record: dict[str, Any] = {
        "stage": stage.name,
        "version": stage.version,
        "state": "done",
        "reason": reason,
        "started": started,
        "options": options.model_dump(mode="json"),
        "libraries": library_versions(stage.libraries),
        "host": host_facts(),
        "fingerprint": inputs,
    }
    meter = Meter()
    try:
        with meter:
            result = stage.run(job)
    except WorkbenchError as error:
        error.stage = error.stage or stage.name
        folder.write(record | {"state": "failed", "reason": str(error), "ended": utc_now()})
        raise
    outcome |= {
        "action": "run",
        "reason": reason,
        "seconds": round(meter.seconds, 3),
        "peak_rss_bytes": meter.peak_rss_bytes,
        "metrics": [metric.as_dict() for metric in result.metrics],
        "warnings": list(result.warnings),
    }
    record |= outcome | {
        "ended": utc_now(),
        "cpu_seconds": round(meter.cpu_seconds, 3),
        "inputs": _files(project, stage.reads, planned.absent),
        "outputs": _files(project, stage.writes, frozenset()),
        "output_hashes": output_hashes(project, stage),
    }
    folder.write(record)
    for warning in result.warnings:
        progress.warning(f"{stage.name}: {warning}")
    progress.line(
        f"{stage.name}: done in {format_seconds(meter.seconds)}, "
        f"peak {meter.peak_rss_bytes / 2**30:.2f} GiB"
    )
    return outcome


def _files(
    project: Project, names: tuple[str, ...], absent: frozenset[str]
) -> list[dict[str, Any]]:
    """Every file behind some artefacts with its hash and size, for the record."""
    found = []
    for name in names:
        if name in absent or name == "records":
            continue
        brought = ARTEFACTS[name].format == "input"
        paths = project.input_paths(name) if brought else project.store.paths(name)
        found += [
            {
                "artefact": name,
                "path": os.path.relpath(path, project.root),
                "hash": project.hashes.of_file(path),
                "bytes": path.stat().st_size,
            }
            for path in paths
        ]
    return found


def _check_inputs_of_first(
    project: Project, plan: list[PlannedStage], chosen: list[PlannedStage]
) -> None:
    """Products the chosen stages read must be there or be made by a chosen stage."""
    made = {name for planned in chosen for name in planned.stage.writes}
    for planned in chosen:
        if planned.action == "left out":
            continue
        for earlier in plan[: [p.stage.name for p in plan].index(planned.stage.name)]:
            needed = set(planned.stage.reads) & set(earlier.stage.writes) - made
            if needed and earlier.action != "left out":
                record = RecordFolder(project, earlier.stage.name).read()
                if record is None or record.get("state") != "done":
                    raise InputError(
                        f"{planned.stage.name} needs what {earlier.stage.name} makes",
                        stage=planned.stage.name,
                        found=f"{earlier.stage.name} has not run",
                        fix=f"workbench {planned.stage.name} runs what it needs as well",
                    )


def _check_room(project: Project, chosen: list[PlannedStage]) -> None:
    """Memory and disk, before the first sample is touched."""
    scene = project.scene()
    memory = psutil.virtual_memory().available
    disk = shutil.disk_usage(project.root).free
    for planned in chosen:
        if not planned.runs or planned.stage.estimate is None:
            continue
        estimate = planned.stage.estimate(scene, planned.options)
        for what, need, have in (
            ("memory", estimate.memory_bytes, memory),
            ("disk space", estimate.disk_bytes, disk),
        ):
            if need > have:
                raise InputError(
                    f"Not enough {what} for {planned.stage.name}",
                    stage=planned.stage.name,
                    expected=f"about {need / 2**30:.1f} GiB",
                    found=f"{have / 2**30:.1f} GiB free",
                    fix="free some, choose a coarser preset (draft), or leave scans out",
                )

