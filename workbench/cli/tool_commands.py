"""Commands that need no project: simulate one, check the machine, list the options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workbench import doctor as doctor_module
from workbench.cli.parameters import ClusterOption, JsonOption, WorkersOption
from workbench.console import Answer, table
from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.pipeline.planner import Pipeline
from workbench.pipeline.progress import Progress
from workbench.pipeline.reference import option_rows, with_generated_blocks
from workbench.project.settings import suggestion


def add_tool_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    """``simulate``, ``doctor`` and ``options``."""

    @app.command(rich_help_panel="Tools")
    def simulate(
        out: Annotated[Path, typer.Argument(help="The project folder to make.")],
        scene: Annotated[str, typer.Option(help="What is simulated.")] = "statue",
        seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
        scans: Annotated[int | None, typer.Option(min=1, help="How many scans.")] = None,
        photos: Annotated[
            int | None, typer.Option(min=0, help="How many RAW flash photographs; else none.")
        ] = None,
        size: Annotated[str, typer.Option(help="small, medium or large.")] = "small",
        preset: Annotated[str | None, typer.Option(help="Preset of the project.")] = None,
        settings: Annotated[
            list[str] | None,
            typer.Option("--set", metavar="OPTION=VALUE", help="Such as photos.flash.mode=ttl."),
        ] = None,
        workers: WorkersOption = None,
        cluster: ClusterOption = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """A project whose truth is known: scans, coarse poses, photographs and ``truth/``."""
        from workbench.pipeline.cluster import mapper_at
        from workbench.project.simulated import simulate_project

        progress = Progress()
        made = simulate_project(
            out,
            given={"scene": scene, "seed": seed, "scans": scans, "size": size, "photos": photos},
            settings=settings or (),
            preset=preset,
            progress=progress,
            workers=workers,
            elsewhere=mapper_at(cluster, ("numpy", "open3d"), progress) if cluster else None,
        )
        found = made.scene()
        pictures = f", {photos} photographs and the charts" if photos else ""
        return Answer(
            {
                "project": str(out),
                "truth": str(out / "truth"),
                "scans": found.scans,
                "photos": photos or 0,
            },
            f"{out}: {found.scans} simulated scans{pictures}. Next: workbench run {out}",
        )

    @app.command(rich_help_panel="Tools")
    def doctor(as_json: JsonOption = False) -> Answer:
        """What is installed, what is missing, and the line that installs it."""
        found = doctor_module.report()
        rows = [
            {"name": p["name"], "state": "ok" if p["ok"] else "MISSING", "reason": p["version"]}
            | ({"reason": f"{p['version']}: {p['fix']}"} if p["fix"] else {})
            for p in found["parts"]
        ]
        return Answer(found, table(("part", "state", "version"), rows), 0 if found["ok"] else 3)

    @app.command(rich_help_panel="Tools")
    def options(
        stage: Annotated[str | None, typer.Argument(help="A stage; all without.")] = None,
        readme: Annotated[
            Path | None, typer.Option(help="Rewrite the generated tables of this file.")
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Every option with its default, its bounds and its source."""
        names = [s.name for s in pipeline]
        if stage is not None and stage not in names:
            raise InputError(
                f"There is no stage {stage!r}",
                expected=", ".join(names),
                fix=suggestion(stage, names) or "choose one of the expected names",
            )
        if readme is not None:
            _rewrite(readme, pipeline)
        rows = [
            {"name": f"{s.name}.{name}", "default": default, "allowed": allowed, "meaning": meaning}
            for s in pipeline
            if stage in (None, s.name)
            for name, default, allowed, meaning in option_rows(s.options)
        ]
        return Answer({"options": rows}, table(("option", "default", "allowed", "meaning"), rows))


def _rewrite(readme: Path, pipeline: Pipeline) -> None:
    try:
        text = with_generated_blocks(readme.read_text(encoding="utf-8"), pipeline)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            "The file cannot be read", file=readme, found=str(error), fix="check the path"
        ) from error
    with replacing(readme) as temporary:
        temporary.write_text(text, encoding="utf-8")
