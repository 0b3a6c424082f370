"""The table of stiff and extreme cases: run, shown, and kept for a project's report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from workbench.cli.parameters import JsonOption
from workbench.console import Answer, table
from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.pipeline.progress import Progress
from workbench.project.project import Project

_FILE = "stability.json"
_SHOWN_REASON = 60


def add_stability_commands(app: typer.Typer) -> None:
    """``stability``."""

    @app.command(rich_help_panel="Tools")
    def stability(
        project: Annotated[
            Path | None,
            typer.Argument(help="A project whose report shall have it.", show_default=False),
        ] = None,
        quick: Annotated[bool, typer.Option("--quick", help="In less than a minute.")] = False,
        only: Annotated[
            str | None, typer.Option(help="Part of names of cases, or a pattern with * and ?.")
        ] = None,
        out: Annotated[
            Path | None, typer.Option(help=f"A folder that gets the table as {_FILE}.")
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Stiff and extreme cases of every method: right within a bound, refused, or wrong."""
        opened = Project(project) if project is not None else None
        if out is not None and not out.is_dir():
            raise InputError("There is no such folder", file=out, fix="make it, or correct --out")
        from workbench.stability.table import chosen, rows_of, table_document

        cases = chosen(quick=quick, only=only)
        with Progress().step("stiff cases", len(cases)) as step:
            rows = rows_of(cases, step.advance)
        told = table_document(rows, quick=quick)
        if opened is not None:
            opened.store.save("stability_table", told)
        if out is not None:
            with replacing(out / _FILE) as temporary:
                temporary.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
        shown = table(
            ("case", "outcome", "value", "bound", "reason"), [_shown(row) for row in told["cases"]]
        )
        shown.caption = (
            f"{told['right']} right within their bounds, {told['refused']} refused with a reason, "
            f"{told['wrong']} wrong"
        )
        return Answer(told, shown, 1 if told["wrong"] else 0)


def _shown(row: dict[str, Any]) -> dict[str, str]:
    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3g}"

    # What a method says of itself where it is right is in the JSON and the report.
    right = row["outcome"] == "right within bound"
    reason = "" if right else row["reason"]
    return {
        "case": row["name"],
        "outcome": "right" if right else row["outcome"],
        "value": number(row["value"]),
        "bound": f"{number(row['bound'])} {row['unit']}".strip(),
        "reason": reason if len(reason) <= _SHOWN_REASON else reason[: _SHOWN_REASON - 1] + "…",
    }
