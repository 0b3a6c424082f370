"""The command line, built from a pipeline: every stage becomes a command of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from workbench import doctor as doctor_module
from workbench.console import (
    INTERRUPTED,
    Answer,
    answer_alone_on_stdout,
    give_failure,
    table,
    told,
)
from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.pipeline.planner import Pipeline, make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.reference import option_rows, with_generated_blocks
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.pipeline.stage import Stage
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.project.settings import (
    StageSettings,
    merged,
    parse_assignment,
    presets,
    suggestion,
)

ProjectArgument = Annotated[Path, typer.Argument(help="The project folder.", show_default=False)]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="STAGE.OPTION=VALUE", help="Change a setting.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Do it again even where it is fresh.")]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Processes for independent items; default one per core.")
]
ClusterOption = Annotated[
    str | None, typer.Option(metavar="ADDR", help="A Dask scheduler, tcp://host:port.")
]

# Options that take several values, as in `--scans a b c`; click takes one per option name.
_MULTIPLE = {"new": ("--scans", "--photos")}


def build_cli(pipeline: Pipeline) -> typer.Typer:
    """The whole command line for one pipeline."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        help="From range scans and flash photographs to a clean, watertight, verified model.",
    )
    _add_project_commands(app, pipeline)
    _add_tool_commands(app, pipeline)
    for stage in pipeline:
        app.command(name=stage.name, help=stage.summary, rich_help_panel="Stages")(
            _stage_command(pipeline, stage)
        )
    return app


def run_cli(pipeline: Pipeline, arguments: Sequence[str] | None = None) -> int:
    """Parse, run and report; returns the exit code (0, 1, 2 or 3, and 130 when interrupted).

    Every failure is one message on standard error; with ``--json`` standard output holds
    ``{"error": …}`` as well.
    """
    given = _expanded(list(sys.argv[1:] if arguments is None else arguments))
    as_json = "--json" in given
    try:
        with answer_alone_on_stdout(as_json):
            answer = build_cli(pipeline)(args=given, prog_name="workbench", standalone_mode=False)
        if isinstance(answer, Answer):
            return answer.give(as_json)
        # An exit code: 0 after --help, or the parser's word for an interruption.
        return give_failure(INTERRUPTED, as_json) if answer == INTERRUPTED.exit_code else 0
    except (KeyboardInterrupt, typer.Abort) as error:
        # The parser takes the end of a file, a stage's too, for an interruption.
        cause = error.__cause__
        failure = told(cause) if isinstance(cause, EOFError) else INTERRUPTED
        return give_failure(failure, as_json)
    except Exception as error:
        return give_failure(told(error), as_json)


def _add_project_commands(app: typer.Typer, pipeline: Pipeline) -> None:
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
        rows = [p.as_dict() for p in make_plan(pipeline, opened, _overrides(settings))]
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
            overrides=_overrides(settings),
            workers=workers,
            cluster=cluster,
        )
        return _run(pipeline, project, request)

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


def _add_tool_commands(app: typer.Typer, pipeline: Pipeline) -> None:
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


def _stage_command(pipeline: Pipeline, stage: Stage[Any]) -> Callable[..., Answer]:
    def command(
        project: ProjectArgument,
        force: ForceOption = False,
        settings: SetOption = None,
        workers: WorkersOption = None,
        cluster: ClusterOption = None,
        as_json: JsonOption = False,
    ) -> Answer:
        request = RunRequest(
            target=stage.name,
            force=force,
            overrides=_overrides(settings),
            workers=workers,
            cluster=cluster,
        )
        extra = _report_keys if stage.name == "verify" else None
        return _run(pipeline, project, request, extra)

    return command


def _run(
    pipeline: Pipeline,
    folder: Path,
    request: RunRequest,
    extra: Callable[[Project, list[str]], dict[str, Any]] | None = None,
) -> Answer:
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


def _overrides(settings: Sequence[str] | None) -> StageSettings:
    return merged(parse_assignment(text) for text in settings or ())


def _expanded(arguments: list[str]) -> list[str]:
    """``--scans a b`` as ``--scans a --scans b`` for the commands that take several."""
    if not arguments or arguments[0] not in _MULTIPLE:
        return arguments
    names, expanded, current = _MULTIPLE[arguments[0]], [], None
    for index, argument in enumerate(arguments):
        if argument.startswith("-"):
            name = argument.partition("=")[0]
            current = name if name in names else None
        elif current is not None and arguments[index - 1] != current:
            expanded.append(current)
        expanded.append(argument)
    return expanded
