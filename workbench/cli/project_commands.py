"""Commands about a project as a whole: make it, plan it, run it, ask how it stands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
from workbench.cli.running import run_answer
from workbench.console import Answer, table
from workbench.pipeline.planner import Pipeline, make_plan
from workbench.pipeline.runner import RunRequest
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.project.settings import presets


def add_project_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    """``new``, ``plan``, ``run`` and ``status``."""

    @app.command(rich_help_panel="Project")
    def new(
        project: ProjectArgument,
        scans: Annotated[list[Path] | None, typer.Option(help="Scan files or folders.")] = None,
        photos: Annotated[list[Path] | None, typer.Option(help="Photographs or folders.")] = None,
        geometry: Annotated[Path | None, typer.Option(help="A surface made elsewhere.")] = None,
        cameras: Annotated[Path | None, typer.Option(help="Ready-made orientations.")] = None,
        reference: Annotated[
            Path | None, typer.Option(help="A surface the report compares the model with.")
        ] = None,
        calibration: Annotated[
            list[Path] | None,
            typer.Option(help="Frames of a colour chart or an even target, or their folder."),
        ] = None,
        preset: Annotated[str, typer.Option(help=", ".join(presets()))] = "default",
        copy: Annotated[bool, typer.Option("--copy", help="Copy the inputs.")] = False,
        as_json: JsonOption = False,
    ) -> Answer:
        """Make a project folder that refers to inputs where they lie."""
        made = create_project(
            project,
            scans=scans or (),
            photos=photos or (),
            geometry=geometry,
            cameras=cameras,
            reference=reference,
            calibration=calibration or (),
            preset=preset,
            copy=copy,
        )
        scene = made.scene()
        return Answer(
            {"project": str(project), "scans": scene.scans, "photos": scene.photos},
            f"{project}: {scene.scans} scan files, {scene.photos} photographs. "
            f"Next: workbench plan {project}",
        )

    @app.command(rich_help_panel="Project")
    def plan(
        project: ProjectArgument, settings: SetOption = None, as_json: JsonOption = False
    ) -> Answer:
        """Every stage: run, fresh, stale or left out, and why."""
        opened = Project(project)
        rows = [p.as_dict() for p in make_plan(pipeline, opened, overrides(settings))]
        opened.hashes.save()
        return Answer({"stages": rows}, table(("stage", "action", "why"), rows))

    @app.command(rich_help_panel="Project")
    def run(
        project: ProjectArgument,
        first: Annotated[str | None, typer.Option("--from", help="First stage.")] = None,
        last: Annotated[str | None, typer.Option("--to", help="Last stage.")] = None,
        only: Annotated[str | None, typer.Option(help="This stage and no other.")] = None,
        force: ForceOption = False,
        settings: SetOption = None,
        workers: WorkersOption = None,
        cluster: ClusterOption = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Run what is needed; what is finished and unchanged stays."""
        request = RunRequest(
            first=first,
            last=last,
            only=only,
            force=force,
            overrides=overrides(settings),
            workers=workers,
            cluster=cluster,
        )
        return run_answer(pipeline, project, request)

    @app.command(rich_help_panel="Project")
    def status(project: ProjectArgument, as_json: JsonOption = False) -> Answer:
        """The state of each stage, with the reason."""
        opened = Project(project)
        rows = []
        for planned in make_plan(pipeline, opened):
            state, reason = planned.action, planned.reason
            if planned.state is not None:
                state, reason = planned.state.state, planned.state.reason
            rows.append({"name": planned.stage.name, "state": state, "reason": reason})
        opened.hashes.save()
        return Answer({"stages": rows}, table(("stage", "state", "why"), rows))
