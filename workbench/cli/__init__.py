"""The command line, built from a pipeline: every stage becomes a command of its own."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer

from workbench.cli.bake_commands import add_bake_commands
from workbench.cli.lod_commands import add_lod_commands
from workbench.cli.page_commands import add_page_commands
from workbench.cli.project_commands import add_project_commands
from workbench.cli.render_commands import add_render_commands
from workbench.cli.stability_commands import add_stability_commands
from workbench.cli.stage_commands import add_stage_commands
from workbench.cli.sweep_commands import add_sweep_commands
from workbench.cli.tool_commands import add_tool_commands
from workbench.console import INTERRUPTED, Answer, answer_alone_on_stdout, give_failure, told
from workbench.pipeline.planner import Pipeline

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
    add_project_commands(app, pipeline)
    add_page_commands(app, pipeline)
    add_tool_commands(app, pipeline)
    add_bake_commands(app)
    add_lod_commands(app)
    add_render_commands(app)
    add_stability_commands(app)
    add_sweep_commands(app, pipeline)
    add_stage_commands(app, pipeline)
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
