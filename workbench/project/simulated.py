"""A project whose truth is known."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel, ValidationError

from workbench.errors import InputError, SettingsError
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.project.settings import first_problem, load_preset, merged, parse_assignment
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photo_presets import scene_photo_defaults
from workbench.synthetic.photo_series import PhotographsElsewhere, write_photos
from workbench.synthetic.simulation import build_scene
from workbench.synthetic.writing import is_simulated, write_simulation

_PRESETS = {"statue": "statue", "building": "building"}
_PHOTO_PREFIX = "photos."

OptionsT = TypeVar("OptionsT", bound=BaseModel)


class Reports(Protocol):
    """What tells the user how far the simulation is."""

    def line(self, text: str, *, transient: bool = False) -> None:
        """Show a line; a transient one may be overwritten by the next."""


@dataclass(frozen=True)
class Order:
    """What is to be simulated.

    Attributes
    ----------
    scans : options of the scene and its scans.
    photos : options of the photographs; None for none.
    """

    scans: SimulationOptions
    photos: PhotoOptions | None


def simulate_project(
    out: Path,
    *,
    given: dict[str, Any],
    settings: Sequence[str] = (),
    preset: str | None = None,
    progress: Reports,
    workers: int | None = None,
    elsewhere: PhotographsElsewhere | None = None,
) -> Project:
    """Simulate a scene into ``out`` and make it a project.

    A simulation that was stopped while it took photographs goes on where it stopped when it
    is asked for once more; until all is done it lies in a hidden folder beside ``out``.

    Parameters
    ----------
    out : the project folder to make.
    given : simulation options by name; ``photos`` is the number of photographs. None values
        are left to the scene's defaults, which are no photographs.
    settings : further ``option=value`` texts; ``scanner.depth_sigma_m=0.001`` reaches inside,
        ``photos.flash.mode=ttl`` is about the photographs.
    preset : the project's preset; by default the one named like the scene, else ``default``.
    progress : where to report.
    workers : photographs computed at once on this machine; one per core where nothing is said.
    elsewhere : takes the photographs on other machines instead.

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
    order = simulation_order(given, settings)
    preset = preset or _PRESETS.get(order.scans.scene, "default")
    load_preset(preset)
    # Made beside and renamed, so that a simulation that was stopped leaves no half scene.
    partial = out.with_name(f".{out.name}.partial")
    if not is_simulated(partial, order.scans):
        shutil.rmtree(partial, ignore_errors=True)

    def report(done: int, total: int, label: str) -> None:
        progress.line(f"  {label} {done}/{total}", transient=True)

    try:
        scene = None
        if not is_simulated(partial, order.scans):
            scene = build_scene(order.scans)
            write_simulation(partial, order.scans, report, scene)
        if order.photos is not None:
            write_photos(
                partial,
                scene or build_scene(order.scans),
                order.scans,
                order.photos,
                progress=report,
                workers=workers,
                elsewhere=elsewhere,
            )
        os.replace(partial, out)
    except BaseException:
        if order.photos is not None and is_simulated(partial, order.scans):
            progress.line("  what is finished is kept: the same command goes on from there")
        else:
            shutil.rmtree(partial, ignore_errors=True)
        raise
    photos = [out / "photos"] if order.photos is not None else []
    return create_project(out, scans=[out / "scans"], photos=photos, preset=preset)


def simulation_order(given: dict[str, Any], settings: Sequence[str]) -> Order:
    """Checked options from names and ``option=value`` texts."""
    named = {name: value for name, value in given.items() if value is not None}
    count = named.pop("photos", 0)
    about_photos = [text for text in settings if text.startswith(_PHOTO_PREFIX)]
    about_scans = [text for text in settings if text not in about_photos]
    plain = merged([named, *(parse_assignment(text, "option=value") for text in about_scans)])
    scans = _checked(SimulationOptions, plain, "simulation option ")
    if not count:
        if about_photos:
            raise SettingsError(
                "No photographs are simulated",
                found=", ".join(about_photos),
                fix="say how many with --photos N, or leave the settings of photographs out",
            )
        return Order(scans, None)
    shared = {"size": scans.size, "seed": scans.seed, "photos": count}
    wanted = merged(parse_assignment(text, "photos.option=value") for text in about_photos)
    layers = [scene_photo_defaults(scans.scene), shared, wanted.get("photos", {})]
    return Order(scans, _checked(PhotoOptions, merged(layers), "photos."))


def _checked(model: type[OptionsT], plain: dict[str, Any], prefix: str) -> OptionsT:
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        problem = first_problem(error, model)
        module = model.__module__.replace(".", "/")
        raise SettingsError(
            f"{'There is no' if problem.unknown else 'Wrong value for'} {prefix}{problem.name}",
            found=problem.found,
            expected=problem.expected,
            fix=problem.suggestion or f"the options are those of {module}.py",
        ) from error
