"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from workbench.project.settings import StageSettings, merged, parse_assignment

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


def overrides(settings: Sequence[str] | None) -> StageSettings:
    """``--set`` texts as tables of settings."""
    return merged(parse_assignment(text) for text in settings or ())
