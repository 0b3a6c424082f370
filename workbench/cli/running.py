"""Running stages for a command, and the answer that tells of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from workbench.console import Answer
from workbench.pipeline.planner import Pipeline, make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.project import Project
from workbench.project.settings import StageSettings


def run_answer(
    pipeline: Pipeline,
    folder: Path,
    request: RunRequest,
    extra: Callable[[Project, list[str]], dict[str, Any]] | None = None,
) -> Answer:
    """Run what is asked for; ``extra`` adds keys, given the project and the needed stages."""
    project = Project(folder)
    stages = run_pipeline(pipeline, project, request, Progress())
    shown = [s for s in stages if s["action"] == "run"]
    summary = (
        f"{len(shown)} of {len(stages)} stages run in {sum(s['seconds'] for s in shown):.1f} s"
        if shown
        else "nothing to do: every stage is fresh or left out"
    )
    plan = make_plan(pipeline, project, request.overrides) if extra else []
    needed = [p.stage.name for p in plan if p.action != "left out"]
    more = extra(project, needed) if extra else {}
    report = project.store.path("report_html")
    if report.exists():
        summary += f"\nreport: {report}"
    return Answer({"stages": stages} | more, summary)


def run_before(
    pipeline: Pipeline, project: Path, stage: str, overrides: StageSettings | None = None
) -> None:
    """Bring up to date what a stage needs of those before it."""
    needs = next(s for s in pipeline if s.name == stage).reads
    before = [s.name for s in pipeline if set(s.writes) & set(needs)]
    if before:
        run_pipeline(
            pipeline,
            Project(project),
            RunRequest(target=before[-1], overrides=overrides),
            Progress(),
        )
