"""One stage with one setting, in a process of its own: what it takes and how wrong it is."""

from __future__ import annotations

import io
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from workbench.errors import WorkbenchError
from workbench.pipeline.knobs import MeasuredError
from workbench.pipeline.planner import Pipeline, make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.records import RecordFolder
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.pipeline.stage import Products
from workbench.project.project import Project
from workbench.project.settings import StageSettings

_SORTED, _SIDE = 400_000, 400


@dataclass(frozen=True)
class Task:
    """What a process is to do in a scratch project.

    Attributes
    ----------
    root : of the scratch project.
    runs : stages to run, one after the other; the last is the one that is tried. None looks
        at what is there.
    measure : of the error; None where it is known already.
    overrides : settings of all stages.
    workers : processes for independent items; None for one per core.
    """

    root: str
    runs: tuple[str, ...]
    measure: str | None
    overrides: StageSettings
    workers: int | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of a task.

    Attributes
    ----------
    wall_s, cpu_s, peak_rss_bytes : of the last stage alone; 0 where none was run.
    error, unit, told : None and empty where it was not asked for or could not be measured.
    reason : why it could not, or why the stage failed.
    failed : whether the stage did.
    """

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_rss_bytes: int = 0
    error: float | None = None
    unit: str = ""
    told: str = ""
    reason: str = ""
    failed: bool = False


def done_apart(pipeline: Pipeline, task: Task) -> Outcome:
    """Do a task in a new process, so that nothing earlier counts towards its memory or time."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
        try:
            return pool.submit(done, tuple(pipeline), task).result()
        except BrokenProcessPool:
            return Outcome(reason="its process was killed, for memory perhaps", failed=True)


def done(pipeline: Pipeline, task: Task) -> Outcome:
    """Do a task in this process; a stage that refuses its input is an outcome, too."""
    project = Project(task.root)
    for name in task.runs:
        request = RunRequest(only=name, force=True, overrides=task.overrides, workers=task.workers)
        try:
            run_pipeline(pipeline, project, request, Progress(io.StringIO()))
        except WorkbenchError as error:
            return Outcome(reason=str(error), failed=True)
    spent = spent_on(project, task.runs[-1]) if task.runs else Outcome()
    return spent if task.measure is None else _with_error(pipeline, task, spent)


def spent_on(project: Project, stage: str) -> Outcome:
    """What the last run of a stage took, by its record."""
    taken = RecordFolder(project, stage).read() or {}
    return Outcome(
        float(taken.get("seconds", 0.0)),
        float(taken.get("cpu_seconds", 0.0)),
        int(taken.get("peak_rss_bytes", 0)),
    )


def _with_error(pipeline: Pipeline, task: Task, spent: Outcome) -> Outcome:
    """The outcome with the error; the one thing here that sees a simulation's truth."""
    assert task.measure is not None
    project = Project(task.root)
    judge = next(stage for stage in pipeline if task.measure in stage.errors)
    plan = make_plan(pipeline, project, task.overrides)
    absent = frozenset(
        name for planned in plan if planned.action == "left out" for name in planned.stage.writes
    )
    products = Products(project, judge.reads, (), absent)
    try:
        found = judge.errors[task.measure].of(products, project.scene(task.overrides))
    except WorkbenchError as error:
        return replace(spent, reason=str(error))
    if not isinstance(found, MeasuredError):
        return replace(spent, reason=found.reason)
    if not np.isfinite(found.value):
        return replace(spent, reason="nothing to compare", unit=found.unit, told=found.told)
    return replace(spent, error=float(found.value), unit=found.unit, told=found.told)


def calibration_seconds() -> float:
    """Wall time of a fixed piece of work: how fast the machine is just now."""
    rng = np.random.default_rng(0)
    numbers, matrix = rng.random(_SORTED), rng.random((_SIDE, _SIDE))
    start = perf_counter()
    np.sort(numbers)
    np.linalg.svd(matrix[: _SIDE // 2, : _SIDE // 2])
    np.sort(numbers[::-1])
    return perf_counter() - start


def steadiness(seconds: Sequence[float]) -> dict[str, Any]:
    """How much the machine's speed moved, from times of the fixed piece of work.

    Returns
    -------
    ``median_s``, ``least_s``, ``most_s``, the relative ``spread`` (most − least, over the
    median) and ``told`` in words.
    """
    if not seconds:
        return {"median_s": None, "least_s": None, "most_s": None, "spread": None,
                "told": "Nothing was timed in this sweep: all was known already."}  # fmt: skip
    middle, least, most = float(np.median(seconds)), min(seconds), max(seconds)
    spread = (most - least) / middle
    words = "steady" if spread < 0.1 else "somewhat unsteady" if spread < 0.3 else "unsteady"
    share = f"from {100 * (least / middle - 1):+.0f} % to {100 * (most / middle - 1):+.0f} %"
    told = (
        f"The machine was {words}: the same small piece of work, timed {len(seconds)} times "
        f"between runs, took {1e3 * middle:.0f} ms in the middle and {share} of that. Times that "
        "differ by less say nothing."
    )
    return {"median_s": middle, "least_s": least, "most_s": most, "spread": spread,
            "told": told.replace("-", "−")}  # fmt: skip
