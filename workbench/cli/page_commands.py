"""Commands that show a page in the browser."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from workbench.cli.parameters import JsonOption, ProjectArgument
from workbench.cli.running import run_before
from workbench.console import Answer
from workbench.pipeline.planner import Pipeline
from workbench.pipeline.progress import Progress
from workbench.project.project import Project

ResolutionOption = Annotated[
    int, typer.Option(help="Voxels along the side of the cube around the surface, a power of two.")
]
SurfelsOption = Annotated[int, typer.Option(min=1, help="Surfels of each node, at most.")]
_TOLD = ("mode", "label", "items", "unit", "bytes")


def add_page_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    """``edit-masks``, ``view`` and ``publish``."""

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

    @app.command(rich_help_panel="Pages")
    def view(
        project: ProjectArgument,
        resolution: ResolutionOption = 1024,
        surfels: SurfelsOption = 50_000,
        port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 0,
        as_json: JsonOption = False,
    ) -> Answer:
        """The model in your browser, in every form there is of it; Ctrl-C ends it."""
        from workbench.viewer.representations import SiteOptions
        from workbench.viewer.server import site_server
        from workbench.viewer.site import build_site

        options = SiteOptions(resolution, surfels, os.cpu_count() or 1)
        server = site_server(build_site(Project(project), options, Progress()), port)
        return Answer(
            {"url": server.url}, f"{server.url}\nCtrl-C ends it.", afterwards=server.serve
        )

    @app.command(rich_help_panel="Pages")
    def publish(
        project: ProjectArgument,
        out: Annotated[Path, typer.Option(help="The folder of the site.")],
        resolution: ResolutionOption = 1024,
        surfels: SurfelsOption = 50_000,
        measure: Annotated[
            bool,
            typer.Option(
                "--measure",
                help="Open it in a browser without a window, along a path around the object; the "
                "next report tells what it costs. Needs playwright and Chromium.",
            ),
        ] = False,
        steps: Annotated[int, typer.Option(min=3, max=1000, help="Of that path.")] = 50,
        as_json: JsonOption = False,
    ) -> Answer:
        """The model as static files for any web server."""
        from workbench.viewer.representations import SiteOptions
        from workbench.viewer.site import build_site
        from workbench.viewer.site import publish as publish_site

        options = SiteOptions(resolution, surfels, os.cpu_count() or 1)
        opened, progress = Project(project), Progress()
        site = publish_site(build_site(opened, options, progress), out)
        if measure:
            from workbench.viewer.page_browser import browser
            from workbench.viewer.page_measures import MeasureOptions, page_measures

            with browser() as running:
                settings = MeasureOptions(steps=steps)
                told = page_measures(running, opened, site, settings, progress)
            opened.store.save("page_measures", told)
        modes = [{key: mode[key] for key in _TOLD} for mode in site.scene["modes"]]
        return Answer(
            {
                "site": str(site.folder),
                "bytes": site.bytes,
                "modes": modes,
                "left_out": site.scene["left_out"],
            },
            f"{site.folder}: {site.bytes / 1e6:,.1f} MB"
            + "".join(
                f"\n  {mode['label']:24s}{mode['items']:12,d} {mode['unit']:10s}"
                f"{mode['bytes'] / 1e6:10,.2f} MB"
                for mode in modes
            )
            + "".join(
                f"\n  {one['label']:24s}left out: {one['reason']}" for one in site.scene["left_out"]
            ),
        )
