"""Running what the plan says: check everything, do the work, record last."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import psutil  # type: ignore[import-untyped]

from workbench.errors import InputError, WorkbenchError
from workbench.pipeline.freshness import (
    file_entries,
    fingerprint,
    output_hashes,
    settings_hash,
    state_of,
)
from workbench.pipeline.memory import give_back, keep_little
from workbench.pipeline.meter import Meter
from workbench.pipeline.planner import Pipeline, PlannedStage, make_plan, needed_for, selected
from workbench.pipeline.progress import Progress, format_seconds
from workbench.pipeline.records import RecordFolder, host_facts, library_versions, utc_now
from workbench.pipeline.stage import Estimate, Job, Products, StageResult
from workbench.pipeline.tasks import Tasks
from workbench.pipeline.threads import one_blas_thread
from workbench.project.lock import project_lock
from workbench.project.project import Project, Scene
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
    with project_lock(project.root), one_blas_thread():
        keep_little()
        try:
            project.hashes.remove_unfinished()
            plan = make_plan(pipeline, project, request.overrides)
            chosen = selected(plan, first=request.first, last=request.last, only=request.only)
            if request.target is not None:
                chosen = needed_for(plan, request.target)
            forced = frozenset(p.stage.name for p in chosen) if request.force else frozenset()
            if request.force and request.target is not None:
                forced = frozenset((request.target,))
            _check_what_is_not_run(project, plan, chosen, progress)
            _check_room(project, chosen, forced, request)
            run = _Run(
                project,
                request,
                progress,
                left_out={p.stage.name: p.reason for p in plan if p.action == "left out"},
                forced=forced,
            )
            return [run.outcome(planned) for planned in chosen]
        finally:
            project.hashes.save()


@dataclass(frozen=True)
class _Run:
    """What all stages of one run have in common."""

    project: Project
    request: RunRequest
    progress: Progress
    left_out: dict[str, str]
    forced: frozenset[str]

    def outcome(self, planned: PlannedStage) -> dict[str, Any]:
        """Do one stage where that is needed; what `run_pipeline` returns of it."""
        stage = planned.stage
        unmoved: dict[str, Any] = {
            "name": stage.name,
            "action": planned.action,
            "reason": planned.reason,
            "seconds": 0.0,
            "peak_rss_bytes": 0,
            "metrics": [],
            "warnings": [],
        }
        if planned.action == "left out":
            self.progress.line(f"{stage.name}: left out — {planned.reason}")
            return unmoved
        if stage.name in self.forced:
            return self._done(planned, "forced")
        # Asked again: a stage before this one may have given the same bytes as last time.
        state = state_of(self.project, stage, planned.options, planned.absent)
        if state.state != "fresh":
            return self._done(planned, planned.reason)
        self.progress.line(f"{stage.name}: fresh — {state.reason}")
        record = RecordFolder(self.project, stage.name).read() or {}
        kept = {key: record.get(key, []) for key in ("metrics", "warnings")}
        return unmoved | kept | {"action": "fresh", "reason": state.reason}

    def _done(self, planned: PlannedStage, reason: str) -> dict[str, Any]:
        project, stage, options = self.project, planned.stage, planned.options
        self.progress.line(f"{stage.name}: {reason}")
        give_back()
        folder = RecordFolder(project, stage.name)
        # Before the work, so that an input that changes meanwhile is found to have changed.
        read = [name for name in stage.reads if name not in planned.absent and name != "records"]
        record: dict[str, Any] = {
            "stage": stage.name,
            "version": stage.version,
            "state": "done",
            "reason": reason,
            "started": utc_now(),
            "options": options.model_dump(mode="json"),
            "libraries": library_versions(stage.libraries),
            "host": host_facts(),
            "fingerprint": fingerprint(project, stage, options, planned.absent),
            "inputs": file_entries(project, read),
        }
        scene = project.scene(self.request.overrides)
        estimate = _estimate(planned, scene)
        workers = self._workers(stage.name, estimate)
        if estimate is not None:
            at_once = min(workers, max(scene.scans, scene.photos, 1))
            record["announced_memory_bytes"] = estimate.announced(at_once)
        asked_by = record["run"] = folder.start()
        for name in stage.writes:
            project.store.remove_unfinished(name)
        if stage.name in self.forced:
            shutil.rmtree(folder.items_folder, ignore_errors=True)
        meter = Meter()
        try:
            with meter:
                result = self._result(planned, scene, estimate, workers, asked_by)
        except Exception as error:
            if isinstance(error, WorkbenchError):
                error.stage = error.stage or stage.name
                told = str(error)
            else:
                told = f"{type(error).__name__}: {error}"
            with suppress(OSError):  # a full disk, which the error itself tells
                folder.write(record | {"state": "failed", "reason": told, "ended": utc_now()})
            raise
        outcome = {
            "name": stage.name,
            "action": "run",
            "reason": reason,
            "seconds": round(meter.seconds, 3),
            "peak_rss_bytes": meter.peak_rss_bytes,
            "metrics": [metric.as_dict() for metric in result.metrics],
            "warnings": list(result.warnings),
        }
        kept = [name for name in stage.writes if name not in result.passing]
        ended = {
            "ended": utc_now(),
            "cpu_seconds": round(meter.cpu_seconds, 3),
            "outputs": file_entries(project, kept),
            "output_hashes": output_hashes(project, kept),
        }
        folder.write(record | outcome | ended)
        for name in result.passing:
            for path in project.store.paths(name):
                path.unlink()
        for warning in result.warnings:
            self.progress.warning(f"{stage.name}: {warning}")
        self.progress.line(
            f"{stage.name}: done in {format_seconds(meter.seconds)}, "
            f"peak {meter.peak_rss_bytes / 2**30:.2f} GiB"
        )
        return outcome

    def _result(
        self,
        planned: PlannedStage,
        scene: Scene,
        estimate: Estimate | None,
        workers: int,
        asked_by: str,
    ) -> StageResult:
        project, stage, options = self.project, planned.stage, planned.options
        products = Products(project, stage.reads, stage.writes, planned.absent)
        job = Job(
            products=products,
            options=options,
            scene=scene,
            progress=self.progress,
            tasks=Tasks(
                root=project.root,
                stage=stage.name,
                fingerprint=settings_hash(stage, options),
                hashes=project.hashes,
                progress=self.progress,
                reads=stage.reads,
                writes=stage.writes,
                libraries=stage.libraries,
                workers=workers,
                cluster=self.request.cluster,
                asked_by=asked_by,
                item_memory_bytes=estimate.worker_bytes if estimate else 0,
            ),
            left_out=self.left_out,
        )
        result = stage.run(job)
        products.remove_what_was_not_written()
        return result

    def _workers(self, stage: str, estimate: Estimate | None) -> int:
        """How many may be at work at once on this machine: as asked for, else as memory allows."""
        if self.request.cluster:
            return 1
        if self.request.workers or estimate is None:
            return self.request.workers or _cores()
        free = psutil.virtual_memory().available
        workers = estimate.workers_within(free, _cores())
        if workers < _cores():
            self.progress.warning(
                f"{stage}: {workers} at work and not {_cores()}, for each takes about "
                f"{estimate.worker_bytes / 2**30:.1f} GiB and {free / 2**30:.1f} GiB are free"
            )
        return workers


def _estimate(planned: PlannedStage, scene: Scene) -> Estimate | None:
    told = planned.stage.estimate
    return None if told is None else told(scene, planned.options)


def _cores() -> int:
    """Cores this process may use; a batch system often grants fewer than there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _check_what_is_not_run(
    project: Project, plan: list[PlannedStage], chosen: list[PlannedStage], progress: Progress
) -> None:
    """Products of stages outside this run must be there; old ones are told."""
    names = {planned.stage.name for planned in chosen}
    working = [planned for planned in chosen if planned.action != "left out"]
    for earlier in plan:
        if earlier.stage.name in names or earlier.action in ("left out", "fresh"):
            continue
        taken = [p for p in working if p.reads & set(earlier.stage.writes)]
        if not taken:
            continue
        stage, first = earlier.stage.name, taken[0].stage
        record = RecordFolder(project, stage).read() or {}
        wanted = set(first.reads) & set(record.get("output_hashes", {}))
        lost = [name for name in wanted if not project.store.paths(name)]
        if earlier.action == "run" or lost:
            raise InputError(
                f"{first.name} needs what {stage} makes",
                stage=first.name,
                found=f"{stage}: {earlier.reason}",
                fix=f"`workbench {first.name} PROJECT` runs what it needs as well",
            )
        progress.warning(f"{stage} is not part of this run though {earlier.reason}")


def _check_room(
    project: Project, chosen: list[PlannedStage], forced: frozenset[str], request: RunRequest
) -> None:
    """Memory and disk, before the first sample is touched."""
    scene = project.scene(request.overrides)
    memory = psutil.virtual_memory().available
    disk = shutil.disk_usage(project.root).free
    for planned in chosen:
        works = planned.runs or planned.stage.name in forced
        # What does not run is not asked: some stages load libraries to tell.
        if not works or planned.action == "left out":
            continue
        estimate = _estimate(planned, scene)
        if estimate is None:
            continue
        asked = 1 if request.cluster else request.workers or 1
        fits = estimate.workers_within(memory, asked)
        if estimate.memory_bytes <= memory and fits < asked:
            raise InputError(
                f"Not enough memory for {asked} workers of {planned.stage.name}",
                stage=planned.stage.name,
                expected=f"about {estimate.announced(asked) / 2**30:.1f} GiB",
                found=f"{memory / 2**30:.1f} GiB free",
                fix=f"--workers {fits}, or leave the number out",
            )
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
