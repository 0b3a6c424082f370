"""A project whose truth is known."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from pydantic import ValidationError

from workbench.errors import InputError, SettingsError
from workbench.project.project import PROJECT_FILE, Project, create_project
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.writing import write_simulation


class Reports(Protocol):
    """What tells the user how far the simulation is."""

    def line(self, text: str, *, transient: bool = False) -> None: ...


def simulate_project(
    out: Path,
    *,
    given: dict[str, Any],
    settings: Sequence[str] = (),
    preset: str | None = None,
    progress: Reports,
) -> Project:
    """Simulate a scene into ``out`` and make it a project.

    Parameters
    ----------
    out : the project folder to make.
    given : simulation options by name; None values are left to the scene's defaults.
    settings : further ``option=value`` texts; ``scanner.depth_sigma_m=0.001`` reaches inside.
    preset : the project's preset; by default the one named like the scene, else ``default``.

    Raises
    ------
    SettingsError
        For an option that does not exist or is out of bounds.
    InputError
        Where ``out`` holds a project already.
    """
    if (out / PROJECT_FILE).exists():
        raise InputError("There is a project already", file=out, fix="choose another folder")
    options = simulation_options(given, settings)
    write_simulation(
        out,
        options,
        lambda done, total, label: progress.line(f"  {label} {done}/{total}", transient=True),
    )
    return create_project(
        out, scans=[out / "scans"], preset=preset or _PRESETS.get(options.scene, "default")
    )


_PRESETS = {"statue": "statue", "building": "building"}


def simulation_options(given: dict[str, Any], settings: Sequence[str]) -> SimulationOptions:
    """Checked options from names and ``option=value`` texts."""
    plain = {name: value for name, value in given.items() if value is not None}
    for text in settings:
        path, equals, value = text.partition("=")
        if not equals:
            raise SettingsError(f"--set {text!r} is not understood", expected="option=value")
        try:
            parsed: Any = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            parsed = value
        *groups, name = path.strip().split(".")
        table = plain
        for group in groups:
            table = table.setdefault(group, {})
        table[name] = parsed
    try:
        return SimulationOptions.model_validate(plain)
    except ValidationError as error:
        first = error.errors()[0]
        raise SettingsError(
            f"Simulation option {'.'.join(str(part) for part in first['loc'])}: {first['msg']}",
            found=repr(first["input"]),
            fix="the options are those of workbench/synthetic/options.py",
        ) from error
