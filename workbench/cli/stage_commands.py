"""One command per stage: it and what it needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer

from workbench.cli.parameters import (
    ClusterOption,
    ForceOption,
    JsonOption,
    ProjectArgument,
    SetOption,
    WorkersOption,
    overrides,
)
from workbench.cli.running import run_answer, run_before
from workbench.console import Answer, table
from workbench.pipeline.planner import Pipeline
from workbench.pipeline.runner import RunRequest
from workbench.pipeline.stage import Stage
from workbench.project.project import Project


def add_stage_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    """A command for each stage, named like it."""
    for stage in pipeline:
        app.command(name=stage.name, help=stage.summary, rich_help_panel="Stages")(
            _stage_command(pipeline, stage)
        )


def _stage_command(pipeline: Pipeline, stage: Stage[Any]) -> Callable[..., Answer]:
    if stage.suggest is not None:
        return _suggesting_command(pipeline, stage, stage.suggest)

    def command(
        project: ProjectArgument,
        force: ForceOption = False,
        settings: SetOption = None,
        workers: WorkersOption = None,
        cluster: ClusterOption = None,
        as_json: JsonOption = False,
    ) -> Answer:
        extra = _report_keys if stage.name == "verify" else None
        request = _request(stage, force, settings, workers, cluster)
        return run_answer(pipeline, project, request, extra)

    return command


def _suggesting_command(
    pipeline: Pipeline,
    stage: Stage[Any],
    suggest: Callable[[Project, int], list[dict[str, str]]],
) -> Callable[..., Answer]:
    def command(
        project: ProjectArgument,
        suggested: Annotated[
            bool, typer.Option("--suggest", help="Only name what would help most, if you draw it.")
        ] = False,
        count: Annotated[
            int, typer.Option(min=1, help="With --suggest: so many scans and so many photographs.")
        ] = 3,
        force: ForceOption = False,
        settings: SetOption = None,
        workers: WorkersOption = None,
        cluster: ClusterOption = None,
        as_json: JsonOption = False,
    ) -> Answer:
        if not suggested:
            request = _request(stage, force, settings, workers, cluster)
            return run_answer(pipeline, project, request)
        run_before(pipeline, project, stage.name, overrides(settings))
        named = suggest(Project(project), count)
        return Answer({"suggestions": named}, table(("kind", "name", "file"), named))

    return command


def _request(
    stage: Stage[Any],
    force: bool,
    settings: list[str] | None,
    workers: int | None,
    cluster: str | None,
) -> RunRequest:
    return RunRequest(
        target=stage.name,
        force=force,
        overrides=overrides(settings),
        workers=workers,
        cluster=cluster,
    )


def _report_keys(project: Project, needed: list[str]) -> dict[str, Any]:
    """What ``verify --json`` adds: where the report is and the metrics of the needed stages."""
    metrics = []
    there = project.store.items("records")
    for name in needed:
        if name not in there:
            continue
        for metric in project.store.load("records", name).get("metrics", []):
            metrics.append({"stage": name, **metric})
    return {"report": str(project.store.path("report_html")), "metrics": metrics}
