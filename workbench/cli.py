"""The command line, built from a pipeline: every stage becomes a command of its own."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from workbench import doctor as doctor_module
from workbench.errors import WorkbenchError
from workbench.pipeline.freshness import state_of
from workbench.pipeline.planner import Pipeline, make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.reference import option_rows, with_generated_blocks
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.pipeline.stage import Stage
from workbench.project.project import Project, create_project
from workbench.project.settings import StageSettings, merged, parse_override, presets

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
    """Parse, run and report; returns the exit code (0, 1, 2 or 3).

    Every failure is one message on standard error; with ``--json`` standard output holds
    ``{"error": …}`` as well.
    """
    given = _expanded(list(sys.argv[1:] if arguments is None else arguments))
    try:
        build_cli(pipeline)(args=given, prog_name="workbench", standalone_mode=True)
    except SystemExit as exit_request:
        code = exit_request.code
        return code if isinstance(code, int) else int(code is not None)
    except WorkbenchError as error:
        return _failed(error, given)
    except (ImportError, OSError) as error:
        known = doctor_module.missing_part(error)
        if known is not None:
            return _failed(known, given)
        traceback.print_exc()
        return _failed(WorkbenchError(f"{type(error).__name__}: {error}"), given)
    except Exception as error:  # noqa: BLE001  the last line of defence: tell, then exit 1
        traceback.print_exc()
        return _failed(
            WorkbenchError(
                f"{type(error).__name__}: {error}",
                fix="this is a fault of the workbench; please report it with the lines above",
            ),
            given,
        )
    return 0


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
    ) -> None:
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
        _print(
            {"project": str(project), "scans": scene.scans, "photos": scene.photos},
            as_json,
            f"{project}: {scene.scans} scan files, {scene.photos} photographs. "
            f"Next: workbench plan {project}",
        )

    @app.command(rich_help_panel="Project")
    def plan(
        project: ProjectArgument, settings: SetOption = None, as_json: JsonOption = False
    ) -> None:
        """Every stage: run, fresh, stale or left out, and why."""
        opened = Project(project)
        rows = [p.as_dict() for p in make_plan(pipeline, opened, _overrides(settings))]
        opened.hashes.save()
        _print({"stages": rows}, as_json, _table(("stage", "action", "why"), rows))

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
    ) -> None:
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
        _run_and_print(pipeline, project, request, as_json)

    @app.command(rich_help_panel="Project")
    def status(project: ProjectArgument, as_json: JsonOption = False) -> None:
        """The state of each stage, with the reason."""
        opened = Project(project)
        rows = []
        for planned in make_plan(pipeline, opened):
            state, reason = "left out", planned.reason
            if planned.action != "left out":
                found = state_of(opened, planned.stage, planned.options, planned.absent)
                state, reason = found.state, found.reason
            rows.append({"name": planned.stage.name, "state": state, "reason": reason})
        opened.hashes.save()
        _print({"stages": rows}, as_json, _table(("stage", "state", "why"), rows))


def _add_tool_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    @app.command(rich_help_panel="Tools")
    def simulate(
        out: Annotated[Path, typer.Argument(help="The project folder to make.")],
        scene: Annotated[str, typer.Option(help="What is simulated.")] = "statue",
        seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
        scans: Annotated[int | None, typer.Option(min=1, help="How many scans.")] = None,
        size: Annotated[str, typer.Option(help="small, medium or large.")] = "small",
        preset: Annotated[str | None, typer.Option(help="Preset of the project.")] = None,
        settings: Annotated[
            list[str] | None, typer.Option("--set", metavar="OPTION=VALUE", help="See below.")
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """A project whose truth is known: scans, coarse poses and ``truth/``."""
        from workbench.project.simulated import simulate_project

        made = simulate_project(
            out,
            given={"scene": scene, "seed": seed, "scans": scans, "size": size},
            settings=settings or (),
            preset=preset,
            progress=Progress(),
        )
        found = made.scene()
        _print(
            {"project": str(out), "truth": str(out / "truth"), "scans": found.scans},
            as_json,
            f"{out}: {found.scans} simulated scans. Next: workbench run {out}",
        )

    @app.command(rich_help_panel="Tools")
    def doctor(as_json: JsonOption = False) -> None:
        """What is installed, what is missing, and the line that installs it."""
        found = doctor_module.report()
        rows = [
            {"name": p["name"], "state": "ok" if p["ok"] else "MISSING", "reason": p["version"]}
            | ({"reason": f"{p['version']}: {p['fix']}"} if p["fix"] else {})
            for p in found["parts"]
        ]
        _print(found, as_json, _table(("part", "state", "version"), rows))
        if not found["ok"]:
            raise typer.Exit(3)

    @app.command(rich_help_panel="Tools")
    def options(
        stage: Annotated[str | None, typer.Argument(help="A stage; all without.")] = None,
        readme: Annotated[
            Path | None, typer.Option(help="Rewrite the generated tables of this file.")
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Every option with its default, its bounds and its source."""
        if readme is not None:
            text = readme.read_text(encoding="utf-8")
            readme.write_text(with_generated_blocks(text, pipeline), encoding="utf-8")
        rows = [
            {"name": f"{s.name}.{name}", "default": default, "allowed": allowed, "meaning": meaning}
            for s in pipeline
            if stage in (None, s.name)
            for name, default, allowed, meaning in option_rows(s.options)
        ]
        _print({"options": rows}, as_json, _table(("option", "default", "allowed", "meaning"), rows))


def _stage_command(pipeline: Pipeline, stage: Stage[Any]) -> Callable[..., None]:
    def command(
        project: ProjectArgument,
        force: ForceOption = False,
        settings: SetOption = None,
        workers: WorkersOption = None,
        cluster: ClusterOption = None,
        as_json: JsonOption = False,
    ) -> None:
        request = RunRequest(
            target=stage.name,
            force=force,
            overrides=_overrides(settings),
            workers=workers,
            cluster=cluster,
        )
        extra = _report_keys if stage.name == "verify" else None
        _run_and_print(pipeline, project, request, as_json, extra)

    return command


def _run_and_print(
    pipeline: Pipeline,
    folder: Path,
    request: RunRequest,
    as_json: bool,
    extra: Callable[[Project], dict[str, Any]] | None = None,
) -> None:
    project = Project(folder)
    stages = run_pipeline(pipeline, project, request, Progress())
    shown = [s for s in stages if s["action"] == "run"]
    summary = (
        f"{len(shown)} of {len(stages)} stages run in {sum(s['seconds'] for s in shown):.1f} s"
        if shown
        else "nothing to do: every stage is fresh or left out"
    )
    more = extra(project) if extra else {}
    report = project.store.path("report_html")
    if report.exists():
        summary += f"\nreport: {report}"
    _print({"stages": stages} | more, as_json, summary)


def _report_keys(project: Project) -> dict[str, Any]:
    """What ``verify --json`` adds: where the report is and every stage's metrics."""
    metrics = []
    for name in project.store.items("records"):
        for metric in project.store.load("records", name).get("metrics", []):
            metrics.append({"stage": name, **metric})
    return {"report": str(project.store.path("report_html")), "metrics": metrics}


def _overrides(settings: Sequence[str] | None) -> StageSettings:
    parsed = (parse_override(text) for text in settings or ())
    return merged({stage: {option: value}} for stage, option, value in parsed)


def _expanded(arguments: list[str]) -> list[str]:
    """``--scans a b`` as ``--scans a --scans b`` for the commands that take several."""
    if not arguments or arguments[0] not in _MULTIPLE:
        return arguments
    names, expanded, current = _MULTIPLE[arguments[0]], [], None
    for index, argument in enumerate(arguments):
        if argument.startswith("-"):
            current = argument if argument in names else None
        elif current is not None and arguments[index - 1] != current:
            expanded.append(current)
        expanded.append(argument)
    return expanded


def _print(value: dict[str, Any], as_json: bool, text: str | Table) -> None:
    if as_json:
        print(json.dumps(value, allow_nan=False))
    else:
        Console(soft_wrap=isinstance(text, str), highlight=False, markup=False).print(text)


def _table(columns: Sequence[str], rows: Sequence[dict[str, str]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    return table


def _failed(error: WorkbenchError, arguments: Sequence[str]) -> int:
    print(f"error: {error}", file=sys.stderr)
    if "--json" in arguments:
        print(json.dumps({"error": error.as_dict()}))
    return error.exit_code
