"""Commands that show a page in the browser."""

from __future__ import annotations

from typing import Annotated

import typer

from workbench.cli.parameters import JsonOption, ProjectArgument
from workbench.cli.running import run_before
from workbench.console import Answer
from workbench.pipeline.planner import Pipeline
from workbench.project.project import Project


def add_page_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    """``edit-masks``."""

    @app.command(name="edit-masks", rich_help_panel="Pages")
    def edit_masks(
        project: ProjectArgument,
        port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 0,
        as_json: JsonOption = False,
    ) -> Answer:
        """A page to draw and correct masks of scans and photographs; Ctrl-C ends it."""
        from workbench.pages.mask_editor import mask_editor_server

        run_before(pipeline, project, "mask")
        server = mask_editor_server(Project(project), port)
        return Answer(
            {"url": server.url},
            f"{server.url}\nCtrl-C ends it; what is drawn is saved.",
            afterwards=server.serve,
        )
