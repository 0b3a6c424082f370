"""Every setting tried, timed and judged, and which of them to take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.pipeline.freshness import fingerprint
from workbench.pipeline.planner import Pipeline, PlannedStage, make_plan
from workbench.pipeline.progress import Progress, Step
from workbench.pipeline.stage import Stage
from workbench.project.hashing import hash_of_value
from workbench.project.project import Project
from workbench.project.settings import StageSettings, merged
from workbench.sweeping.measuring import (
    Task,
    calibration_seconds,
    done_apart,
    spent_on,
    steadiness,
)
from workbench.sweeping.points import Tried, TriedPoints
from workbench.sweeping.recommendation import (
    Budget,
    Candidate,
    Choice,
    pareto_indices,
    recommended,
)
from workbench.sweeping.scratch import (
    SWEEP_FOLDER,
    emptied_for,
    restored,
    scratch_project,
    without_scan,
)
from workbench.sweeping.trials import GivenKnobs, Trial, chosen_stages, trials_of

_REGISTER = "register"


@dataclass(frozen=True)
class SweepRequest:
    """What the user asked for.

    Attributes
    ----------
    stages : names; all with knobs where none is named.
    knobs : stage → option → values, tried in all combinations.
    quick : fewer values of declared knobs; the setting in force is not run again, its time is
        that of the project's own record.
    repeats : how often each setting is timed.
    budget : time and error that may be spent.
    overrides : ``--set`` values.
    workers : processes for independent items; None for one per core.
    """

    stages: tuple[str, ...] = ()
    knobs: GivenKnobs = field(default_factory=dict)
    quick: bool = False
    repeats: int = 1
    budget: Budget = field(default_factory=Budget)
    overrides: StageSettings | None = None
    workers: int | None = None


@dataclass(frozen=True)
class _Asked:
    """A trial with the name its outcomes are kept under."""

    trial: Trial
    key: str


def sweep(
    pipeline: Pipeline, project: Project, request: SweepRequest, progress: Progress
) -> dict[str, Any]:
    """Turn the knobs of stages about the settings in force.

    Each setting runs in a process of its own on a scratch project that shares all else with the
    user's. Repeats go round all settings, so that a slow quarter of an hour is no one's alone.

    Returns
    -------
    Plain data: ``points``, dicts of ``stage, measure, knobs, error, error_unit, told, wall_s,
    wall_spread, cpu_s, peak_rss_bytes, repeats, default, pareto, recommended, reason``;
    ``recommended``, one for each stage and measure, of ``stage, measure, how, reason`` and the
    ``knobs`` (None where nothing keeps the budget); ``left_out``, stage → reason; ``noise``.
    The front and the recommendation go by `cost_of` the budget.

    Raises
    ------
    InputError
        The project is not up to date.
    SettingsError
        A knob is not understood.
    """
    plan = {
        planned.stage.name: planned for planned in make_plan(pipeline, project, request.overrides)
    }
    settings = project.settings(request.overrides)
    left_out: dict[str, str] = {}
    asked: dict[str, list[_Asked]] = {}
    for stage in chosen_stages(pipeline, request.stages, request.knobs):
        planned = plan[stage.name]
        if planned.action == "left out":
            left_out[stage.name] = planned.reason
            continue
        _check_done(project, planned)
        trials = trials_of(stage, settings, request.knobs, quick=request.quick)
        asked[stage.name] = [_Asked(one, _key(project, planned, one)) for one in trials]
    store = TriedPoints(project.root / SWEEP_FOLDER / "points")
    driver = _Driver(pipeline, project, request, settings, store)
    total = request.repeats * sum(map(len, asked.values()))
    calibration_seconds()  # the first time, libraries start their threads
    with scratch_project(project) as root, progress.step("trying settings", total) as step:
        for name, of_stage in asked.items():
            driver.try_all(root, plan[name], of_stage, step)
    points, choices = [], []
    for of_stage in asked.values():
        for measure in dict.fromkeys(one.trial.measure for one in of_stage):
            group = [one for one in of_stage if one.trial.measure == measure]
            tried = [store.read(one.key) for one in group]
            own, choice = _judged([one.trial for one in group], tried, request.budget)
            points += own
            choices.append(choice)
    return {
        "points": points,
        "recommended": choices,
        "left_out": left_out,
        "noise": steadiness(driver.calibrations),
        "budget": {"error": request.budget.error, "seconds": request.budget.seconds},
    }


@dataclass
class _Driver:
    """Runs trials that were not run before."""

    pipeline: Pipeline
    project: Project
    request: SweepRequest
    settings: StageSettings
    store: TriedPoints
    calibrations: list[float] = field(default_factory=list)

    def try_all(
        self, root: Path, planned: PlannedStage, asked: Sequence[_Asked], step: Step
    ) -> None:
        """All trials of a stage, one repeat after the other."""
        stage = planned.stage
        apart = self._leaves_out(asked)
        behind: list[Stage[Any]] = []
        if apart and any(len(self.store.read(one.key).outcomes) < 1 for one in asked):
            behind = self._without_scan(root, stage)
        for repeat in range(self.request.repeats):
            for one in asked:
                tried = self.store.read(one.key)
                if len(tried.outcomes) <= repeat and not tried.failed:
                    in_force = self.request.quick and not apart and _same(one.trial, planned)
                    if in_force and not tried.outcomes:
                        self._look_up(root, stage, one, tried)
                    else:
                        self._try(root, stage, one, tried)
                step.advance()
        restored(root, self.project.root, [*behind, stage])

    def _try(self, root: Path, stage: Stage[Any], one: _Asked, tried: Tried) -> None:
        emptied_for(root, stage)
        task = Task(
            str(root),
            (stage.name,),
            None if tried.outcomes else one.trial.measure,
            self._overrides(stage.name, one.trial.table),
            self.request.workers,
        )
        self.calibrations.append(calibration_seconds())
        tried.outcomes.append(done_apart(self.pipeline, task))
        self.store.write(one.key, tried)

    def _look_up(self, root: Path, stage: Stage[Any], one: _Asked, tried: Tried) -> None:
        """What the project's own run of the stage took, and how wrong its products are."""
        task = Task(str(root), (), one.trial.measure, self._overrides(stage.name, {}))
        found = done_apart(self.pipeline, task)
        spent = spent_on(self.project, stage.name)
        tried.outcomes.append(
            replace(
                found,
                wall_s=spent.wall_s,
                cpu_s=spent.cpu_s,
                peak_rss_bytes=spent.peak_rss_bytes,
            )
        )
        self.store.write(one.key, tried)

    def _overrides(self, name: str, table: Mapping[str, Any]) -> StageSettings:
        return merged([self.settings, {name: table}])

    def _leaves_out(self, asked: Sequence[_Asked]) -> bool:
        """Whether the error of these is told by a scan that no stage has seen."""
        scene = self.project.scene(self.settings)
        if scene.truth or not scene.scans:
            return False
        measures = {one.trial.measure for one in asked}
        judges = [stage.errors for stage in self.pipeline]
        return any(errors[m].leaves_out_scan for errors in judges for m in measures & set(errors))

    def _without_scan(self, root: Path, stage: Stage[Any]) -> list[Stage[Any]]:
        """Bring the scratch project to where the stage begins, one scan less; what that moved."""
        names = [one.name for one in self.pipeline]
        register = self.pipeline[names.index(_REGISTER)]
        if without_scan(root, self.project, register) is None:
            return [register]
        planned = make_plan(self.pipeline, self.project, self.request.overrides)
        between = [
            one.stage
            for one in planned[names.index(_REGISTER) + 1 : names.index(stage.name)]
            if one.action != "left out" and set(one.stage.writes) & set(stage.reads)
        ]
        for one in between:
            emptied_for(root, one)
            task = Task(str(root), (one.name,), None, self.settings, self.request.workers)
            done_apart(self.pipeline, task)
        return [register, *between]


def _same(trial: Trial, planned: PlannedStage) -> bool:
    return trial.options.result_options() == planned.options.result_options()


def _check_done(project: Project, planned: PlannedStage) -> None:
    if planned.action != "fresh":
        raise InputError(
            f"{planned.stage.name} is not up to date: {planned.reason}",
            file=project.root,
            fix=f"workbench run {project.root}, then sweep",
        )


def _key(project: Project, planned: PlannedStage, trial: Trial) -> str:
    told = fingerprint(project, planned.stage, trial.options, planned.absent)
    return hash_of_value([planned.stage.name, trial.measure, told]).rpartition(":")[2]


def _judged(
    trials: Sequence[Trial], tried: Sequence[Tried], budget: Budget
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The points of one measure, and the recommendation among them."""
    points = [_point(trial, one) for trial, one in zip(trials, tried, strict=True)]
    measured = [k for k, point in enumerate(points) if point["error"] is not None]
    cost = cost_of(budget)
    candidates = [
        Candidate(points[k]["error"], max(points[k][cost], 1e-6), points[k]["default"])
        for k in measured
    ]
    for k in pareto_indices(candidates):
        points[measured[k]]["pareto"] = True
    noise = max((tried[k].spread(cost) for k in measured), default=0.0)
    choice = recommended(candidates, budget, noise)
    chosen = measured[choice.index] if isinstance(choice, Choice) else None
    if chosen is not None:
        points[chosen]["recommended"] = True
    return points, {
        "stage": trials[0].stage.name,
        "measure": trials[0].measure,
        "how": choice.how,
        "reason": choice.reason,
        "knobs": None if chosen is None else points[chosen]["knobs"],
    }


def cost_of(budget: Budget) -> str:
    """What time means: a budget is of the user's time, else the processor's, which is steadier."""
    return "cpu_s" if budget.seconds is None else "wall_s"


def _point(trial: Trial, tried: Tried) -> dict[str, Any]:
    first = tried.first
    return {
        "stage": trial.stage.name,
        "measure": trial.measure,
        "knobs": dict(trial.knobs),
        "error": None if tried.failed else first.error,
        "error_unit": first.unit,
        "told": first.told,
        "wall_s": tried.median("wall_s"),
        "wall_spread": tried.spread("wall_s"),
        "cpu_s": tried.median("cpu_s"),
        "peak_rss_bytes": round(tried.median("peak_rss_bytes")),
        "repeats": len(tried.outcomes),
        "default": trial.default,
        "pareto": False,
        "recommended": False,
        "reason": next((o.reason for o in tried.outcomes if o.failed), first.reason),
    }
