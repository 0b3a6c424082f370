"""A project whose truth is known."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from pydantic import ValidationError

from workbench.errors import InputError, SettingsError
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.project.settings import first_problem, load_preset, merged, parse_assignment
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.writing import write_simulation

_PRESETS = {"statue": "statue", "building": "building"}


class Reports(Protocol):
    """What tells the user how far the simulation is."""

    def line(self, text: str, *, transient: bool = False) -> None:
        """Show a line; a transient one may be overwritten by the next."""


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
        Where ``out`` is there already and not an empty folder.
    """
    out = out.resolve()
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise InputError(
            "There is something already", file=out, fix="choose another folder, or remove it"
        )
    options = simulation_options(given, settings)
    preset = preset or _PRESETS.get(options.scene, "default")
    load_preset(preset)
    # Made beside and renamed, so that a simulation that was stopped leaves no half scene.
    partial = out.with_name(f".{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        write_simulation(
            partial,
            options,
            lambda done, total, label: progress.line(f"  {label} {done}/{total}", transient=True),
        )
        os.replace(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return create_project(out, scans=[out / "scans"], preset=preset)


def simulation_options(given: dict[str, Any], settings: Sequence[str]) -> SimulationOptions:
    """Checked options from names and ``option=value`` texts."""
    named = {name: value for name, value in given.items() if value is not None}
    plain = merged([named, *(parse_assignment(text, "option=value") for text in settings)])
    try:
        return SimulationOptions.model_validate(plain)
    except ValidationError as error:
        problem = first_problem(error, SimulationOptions)
        raise SettingsError(
            f"{'There is no' if problem.unknown else 'Wrong value for'} simulation option "
            f"{problem.name}",
            found=problem.found,
            expected=problem.expected,
            fix=problem.suggestion or "the options are those of workbench/synthetic/options.py",
        ) from error
