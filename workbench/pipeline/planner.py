"""What this scene needs, stage by stage, with the reason in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from workbench.errors import InputError
from workbench.pipeline.freshness import State, state_of
from workbench.pipeline.stage import Need, Stage
from workbench.project.project import Project
from workbench.project.settings import (
    StageOptions,
    StageSettings,
    check_stage_names,
    options_for,
    suggestion,
)

Pipeline = Sequence[Stage[Any]]


@dataclass(frozen=True)
class PlannedStage:
    """One line of the plan.

    Attributes
    ----------
    stage, options : what would run, and how.
    action : ``run``, ``fresh``, ``stale`` or ``left out``.
    reason : why, in plain words.
    absent : artefacts that are not there for the stage: those of stages this scene leaves out,
        and those it has no place for.
    without : the latter alone.
    state : how the stage stands now; None for one that is left out.
    """

    stage: Stage[Any]
    options: StageOptions
    action: str
    reason: str
    absent: frozenset[str] = frozenset()
    state: State | None = None
    without: frozenset[str] = frozenset()

    @property
    def runs(self) -> bool:
        """Whether there is work to do."""
        return self.action in ("run", "stale")

    @property
    def reads(self) -> frozenset[str]:
        """The artefacts that the stage reads where there are any."""
        return frozenset(self.stage.reads) - self.without

    def as_dict(self) -> dict[str, str]:
        """The line as plain data."""
        return {"name": self.stage.name, "action": self.action, "reason": self.reason}


def checked_options(pipeline: Pipeline, settings: StageSettings) -> dict[str, StageOptions]:
    """Stage name → checked options; any mistake in any stage raises before anything runs."""
    check_stage_names(settings, [stage.name for stage in pipeline])
    return {stage.name: options_for(stage.name, stage.options, settings) for stage in pipeline}


def make_plan(
    pipeline: Pipeline, project: Project, overrides: StageSettings | None = None
) -> list[PlannedStage]:
    """The plan of all stages as things lie now.

    A stage behind one that will run is planned as stale; should the stage before it give
    the same bytes again, the run itself will find it fresh. Stages stand in the order of the
    pipeline, but behind those whose products this scene has them read.
    """
    options = checked_options(pipeline, project.settings(overrides))
    scene = project.scene(overrides)
    needs = {stage.name: stage.needed(scene, options[stage.name]) for stage in pipeline}
    absent = frozenset(
        name for stage in pipeline if not needs[stage.name].needed for name in stage.writes
    )
    plan: list[PlannedStage] = []
    rebuilt: dict[str, str] = {}
    for stage in in_working_order(pipeline, needs):
        own, need = options[stage.name], needs[stage.name]
        if not need.needed:
            plan.append(PlannedStage(stage, own, "left out", need.reason))
            continue
        missing = absent | need.without
        state = state_of(project, stage, own, missing)
        action, reason = _action(state, need.reason)
        read = [name for name in stage.reads if name not in missing]
        behind = next((rebuilt[name] for name in read if name in rebuilt), None)
        if action == "fresh" and behind:
            action, reason = "stale", f"waits for {behind}, which will run first"
        plan.append(PlannedStage(stage, own, action, reason, missing, state, need.without))
        if action != "fresh":
            rebuilt |= dict.fromkeys(stage.writes, stage.name) | {"records": stage.name}
    return plan


def in_working_order(pipeline: Pipeline, needs: Mapping[str, Need]) -> list[Stage[Any]]:
    """The stages so that each comes after those whose products it reads in this scene.

    Of those that could come next, the first of the pipeline does; one that is left out waits
    for none, and none for it.
    """
    waiting, ordered = list(pipeline), []
    while waiting:
        made = {n for stage in waiting if needs[stage.name].needed for n in stage.writes}
        ready = [
            stage
            for stage in waiting
            if not needs[stage.name].needed
            or made.isdisjoint(set(stage.reads) - needs[stage.name].without)
        ]
        if not ready:
            raise ValueError(f"stages wait for each other: {[stage.name for stage in waiting]}")
        waiting.remove(ready[0])
        ordered.append(ready[0])
    return ordered


def selected(
    plan: list[PlannedStage],
    *,
    first: str | None = None,
    last: str | None = None,
    only: str | None = None,
) -> list[PlannedStage]:
    """The stages between ``first`` and ``last`` inclusive, or ``only`` one."""
    names = [planned.stage.name for planned in plan]
    for name in (first, last, only):
        if name is not None and name not in names:
            raise InputError(
                f"There is no stage {name!r}",
                expected=", ".join(names),
                fix=suggestion(name, names) or "choose one of the expected names",
            )
    if only is not None and (first is not None or last is not None):
        raise InputError("--only leaves nothing for --from and --to", fix="give one or the other")
    begin = names.index(only or first or names[0])
    end = names.index(only or last or names[-1])
    if begin > end:
        raise InputError(
            f"--from {first} comes after --to {last}",
            expected=" → ".join(names),
            fix="exchange them",
        )
    return plan[begin : end + 1]


def needed_for(plan: list[PlannedStage], target: str) -> list[PlannedStage]:
    """The stage ``target`` and all whose products it needs, in the plan's order."""
    chosen = selected(plan, only=target)
    wanted = set(chosen[0].reads)
    for planned in reversed(plan[: plan.index(chosen[0])]):
        if wanted & set(planned.stage.writes):
            chosen.insert(0, planned)
            wanted |= planned.reads
    return chosen


def _action(state: State, need: str) -> tuple[str, str]:
    if state.state == "fresh":
        return "fresh", state.reason
    if state.state == "stale":
        return "stale", state.reason
    return "run", need if state.state == "missing" else f"{state.state}: {state.reason}"
