"""Error against run time: knobs of stages turned, timed and judged."""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer

from workbench.cli.parameters import (
    JsonOption,
    ProjectArgument,
    SetOption,
    WorkersOption,
    overrides,
)
from workbench.console import Answer, table
from workbench.errors import SettingsError
from workbench.pipeline.planner import Pipeline
from workbench.pipeline.progress import Progress, format_seconds
from workbench.project.project import Project

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def add_sweep_commands(app: typer.Typer, pipeline: Pipeline) -> None:
    """``sweep``."""

    @app.command(rich_help_panel="Tools")
    def sweep(
        project: ProjectArgument,
        stage: Annotated[
            list[str] | None, typer.Option(help="Only this stage; may be given again.")
        ] = None,
        knob: Annotated[
            list[str] | None,
            typer.Option(
                metavar="STAGE.OPTION=A,B,C", help="Values to try instead of the usual knobs."
            ),
        ] = None,
        budget: Annotated[
            str | None,
            typer.Option(metavar="TIME", help="What a stage may take, such as 90s or 10min."),
        ] = None,
        error_budget: Annotated[
            float | None,
            typer.Option(min=0.0, help="The error it may have, in the unit of its measure."),
        ] = None,
        repeats: Annotated[int, typer.Option(min=1, max=99, help="Of each setting.")] = 2,
        seeds: Annotated[
            int, typer.Option(min=1, max=99, help="Simulations of so many seeds, all told.")
        ] = 1,
        quick: Annotated[bool, typer.Option("--quick", help="Fewer values of each knob.")] = False,
        settings: SetOption = None,
        workers: WorkersOption = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """What settings cost and buy: error against time and memory, and which to take."""
        from workbench.sweeping.recommendation import Budget
        from workbench.sweeping.seeds import sweep_of_seeds
        from workbench.sweeping.sweep import SweepRequest
        from workbench.sweeping.sweep import sweep as one_sweep
        from workbench.sweeping.trials import parse_knobs

        request = SweepRequest(
            tuple(stage or ()),
            parse_knobs(knob or (), pipeline),
            quick,
            repeats,
            Budget(error_budget, None if budget is None else seconds_of(budget)),
            overrides(settings),
            workers,
        )
        if error_budget is not None and len({*request.stages, *request.knobs}) != 1:
            raise SettingsError(
                "An error budget is in the unit of one stage's measure",
                expected="one --stage, or --knob of one stage",
                fix=f"such as --stage infill --error-budget {error_budget:g}",
            )
        opened, progress = Project(project), Progress()
        if seeds > 1:
            told = sweep_of_seeds(pipeline, opened, request, seeds, progress)
        else:
            told = one_sweep(pipeline, opened, request, progress)
        opened.store.save("sweep_points", told)
        shown = table(
            ("setting", "error", "wall", "cpu", "peak", ""), [_shown(p) for p in told["points"]]
        )
        shown.caption = "\n".join([*map(_advice, told["recommended"]), told["noise"]["told"]])
        return Answer(told, shown)


def seconds_of(text: str) -> float:
    """``90s``, ``10min`` or ``1.5h`` as seconds.

    Raises
    ------
    SettingsError
        The text says something else.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(s|min|h)?\s*", text)
    if found is None or not float(found[1]) > 0.0:
        raise SettingsError(
            f"--budget {text!r} is not understood",
            expected="a time such as 90s, 10min or 1.5h",
            fix="name a number and its unit",
        )
    return float(found[1]) * _SECONDS[found[2] or "s"]


def _shown(point: dict[str, Any]) -> dict[str, str]:
    marks = [name for name in ("default", "pareto", "recommended") if point[name]]
    turned = ", ".join(f"{name}={value}" for name, value in point["knobs"].items())
    error = point["reason"][:40] if point["error"] is None else f"{point['error']:.4g}"
    return {
        "setting": f"{point['stage']} {turned}",
        "error": f"{error} {point['error_unit']}".strip(),
        "wall": format_seconds(point["wall_s"]),
        "cpu": format_seconds(point["cpu_s"]),
        "peak": f"{point['peak_rss_bytes'] / 2**30:.2f} GiB",
        "": ", ".join(marks),
    }


def _advice(choice: dict[str, Any]) -> str:
    name = choice["stage"]
    if choice["measure"] != name:
        name += f" ({choice['measure']})"
    if choice["knobs"] is None:
        return f"{name}: nothing to recommend: {choice['reason']}"
    turned = ", ".join(f"{option}={value}" for option, value in choice["knobs"].items())
    text = f"{name}: {turned} — {choice['reason']}"
    for check in choice.get("checked", ()):
        held = {True: "holds", False: "does not hold", None: "is not known"}[check["holds"]]
        text += f"\n  {held} on seed {check['seed']}: {check['told']}"
    return text
