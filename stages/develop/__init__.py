"""Develop photographs: RAW to linear colour, calibrated with a chart, of one exposure."""

from __future__ import annotations

from collections.abc import Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from stages.develop.calibrating import (
    FittedChart,
    Looks,
    NoCalibration,
    calibration_of,
    facts_of,
    kind_of,
    lens_light_of,
    linearity_of,
)
from stages.develop.items import develop_photo, look_at
from stages.develop.telling import Recipe, calibration_document, photo_entries, result_of
from workbench.errors import SettingsError
from workbench.photos.calibration_notes import read_calibration_notes
from workbench.photos.exif import sidecar_files
from workbench.photos.exposure import compared_exposures
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.mask_subjects import photos_by_name
from workbench.project.project import PHOTO_SUFFIXES, Scene
from workbench.project.settings import StageOptions

if TYPE_CHECKING:
    from workbench.color.calibration import ColorMatrix
    from workbench.color.spaces import WorkingSpace

_FRAME = "calibration."
Corner = tuple[float, float]
Corners = Annotated[tuple[Corner, ...], Field(min_length=4, max_length=4)]


class DevelopOptions(StageOptions):
    """Options of ``develop``."""

    half_size: bool = Field(
        False, description="Make one pixel of 2 × 2 photosites: four times quicker, for a draft."
    )
    demosaic: Literal["dht", "ahd", "vng", "linear"] = Field(
        "dht",
        description="How the colours between a mosaic's photosites are found; dht is the most "
        "exact here, ahd LibRaw's own default.",
    )
    space: Literal["rec709", "prophoto"] = Field(
        "rec709", description="Primaries of the linear working space; ProPhoto clips no pigment."
    )
    matrix: Literal["linear", "root_polynomial"] = Field(
        "linear",
        description="Colour matrix 3 × 3, or with the root terms of Finlayson et al. 2015.",
    )
    chart: str = Field(
        "auto",
        description="Where the ColorChecker is: auto looks in every photograph and calibration "
        "frame, none looks nowhere, a name in that one.",
    )
    chart_corners: dict[str, Corners] = Field(
        {},
        description="Corners of a chart that is not found, by photograph: four times right and "
        "down in pixels, in turn round the board or its patches.",
    )
    exposure: Literal["one", "as_shot"] = Field(
        "one",
        description="Bring photographs of other time, ISO and aperture to one exposure, or leave "
        "them as they are.",
    )


def needed(scene: Scene, options: DevelopOptions) -> Need:
    if not scene.photos:
        return Need(False, "no photographs")
    frames = f" and {scene.calibration} calibration files" if scene.calibration else ""
    return Need(True, f"{scene.photos} photographs{frames} to develop")


def estimate(scene: Scene, options: DevelopOptions) -> Estimate:
    # A photograph of 24 million pixels takes some 2 GiB, one per worker, and 110 MB on disk.
    shrunk = 4 if options.half_size else 1
    one = 2**31 // shrunk
    return Estimate(one, scene.photos * (2**27 // shrunk), item_bytes=one)


def run(job: Job[DevelopOptions]) -> StageResult:
    from workbench.color.spaces import working_space

    products, options = job.products, job.options
    photos = photos_by_name(products.input_paths("photo_files"))
    frames, notes_files = _calibration_files(products.input_paths("calibration_files"))
    files = {name: path.name for name, path in (photos | frames).items()}
    notes = read_calibration_notes(notes_files, files.values())
    flat = {name for name in frames if notes.is_flat(files[name])}
    looks = _looks(job, photos | frames, flat)
    space = working_space(options.space)
    light = lens_light_of(looks)
    chart = calibration_of(looks, light, space, options.matrix, options.chart)
    facts = {name: facts_of(look) for name, look in looks.items()}
    exposures = compared_exposures(facts, chart.name if isinstance(chart, FittedChart) else None)
    linearity = linearity_of(looks, notes, files, exposures.gains)
    recipes = {
        name: Recipe(
            *_color_of(name, looks, chart, space),
            exposures.gains[name] if options.exposure == "one" else 1.0,
            light.of(looks[name]),
        )
        for name in photos
    }
    scale = max(recipe.reach for recipe in recipes.values())
    developed = _developed(job, photos, recipes, scale, space)
    entries = photo_entries(photos, looks, developed, recipes, exposures)
    document = calibration_document(chart, looks, light.found, linearity, space)
    step = 2 if options.half_size else 1
    inventory = {"space": space.name, "scale": scale, "pixel_step": step, "photos": entries}
    products.save("photo_inventory", inventory)
    products.save("color_calibration", document)
    seconds = [made["seconds"] for made in developed.values()]
    return result_of(entries, document, exposures, seconds)


def _looks(job: Job[DevelopOptions], paths: Mapping[str, Path], flat: Set[str]) -> Looks:
    """A first look at every photograph and calibration frame."""
    corners = {
        _known_name(name, paths): [list(corner) for corner in given]
        for name, given in job.options.chart_corners.items()
    }
    sought = _known_name(job.options.chart, paths)
    items = {
        name: {
            "path": str(path),
            "content": job.products.input_hash(path),
            "sidecar": [job.products.input_hash(beside) for beside in sidecar_files(path)],
            "flat": name in flat,
            "corners": corners.get(name),
            "search": sought in ("auto", name) and name not in flat,
        }
        for name, path in paths.items()
    }
    return job.tasks.map_items("looking at photographs", look_at, items)


def _developed(
    job: Job[DevelopOptions],
    photos: Mapping[str, Path],
    recipes: Mapping[str, Recipe],
    scale: float,
    space: WorkingSpace,
) -> Looks:
    """Every photograph in the working space; returns what there is to say of each."""
    common = {
        "half_size": job.options.half_size,
        "demosaic": job.options.demosaic,
        "scale": scale,
        "space": {
            "name": space.name,
            "title": space.title,
            "xyz_d50_from_rgb": space.xyz_d50_from_rgb.tolist(),
        },
    }
    items = {
        name: common
        | recipes[name].as_dict()
        | {"name": name, "path": str(path), "content": job.products.input_hash(path)}
        for name, path in photos.items()
    }
    found = job.tasks.map_items("developing", develop_photo, items)
    for product in ("developed_photos", "unclipped_masks"):
        job.products.remove_items_except(product, set(photos))
    return found


def _calibration_files(paths: tuple[Path, ...]) -> tuple[dict[str, Path], list[Path]]:
    """Frames by a name that no photograph has, and notes."""
    frames = [path for path in paths if path.suffix.lower() in PHOTO_SUFFIXES]
    named = {_FRAME + name: path for name, path in photos_by_name(frames).items()}
    return named, [path for path in paths if path not in frames]


def _known_name(chart: str, paths: Mapping[str, Path]) -> str:
    """The option as a name of ``paths``, with or without its suffix and its folder's mark."""
    if chart in ("auto", "none"):
        return chart
    for name, path in paths.items():
        if chart in (name, path.name, name.removeprefix(_FRAME)):
            return name
    raise SettingsError(
        "There is no photograph of this name",
        stage="develop",
        found=chart,
        expected="auto, none, or the name of a photograph or calibration frame",
        fix="correct develop.chart or develop.chart_corners",
    )


def _color_of(
    name: str, looks: Looks, chart: FittedChart | NoCalibration, space: WorkingSpace
) -> tuple[ColorMatrix, str]:
    """The colour matrix of a photograph, and in words what it rests on."""
    from workbench.color.camera_matrix import camera_color, profile_color

    look = looks[name]
    if isinstance(chart, FittedChart) and kind_of(look) == kind_of(looks[chart.name]):
        return chart.calibration.color, "chart"
    if look["profile_matrix"] is not None:
        matrix = np.array(look["profile_matrix"])
        return profile_color(space, matrix), f"profile: {look['linearised_from']}"
    # One white balance for all photographs of a camera, so that they agree.
    told = [
        other["white_balance"]
        for other in looks.values()
        if kind_of(other) == kind_of(look) and other["white_balance"] is not None
    ]
    balance = np.median(np.array(told), axis=0) if told else None
    known = look["camera_from_xyz"]
    return camera_color(space, balance, None if known is None else np.array(known))


DEVELOP = Stage(
    name="develop",
    version=1,
    summary="Develops RAW photographs to linear colour of one exposure, calibrated with a chart.",
    options=DevelopOptions,
    reads=("photo_files", "photo_sidecars", "calibration_files"),
    writes=("developed_photos", "unclipped_masks", "photo_inventory", "color_calibration"),
    needed=needed,
    run=run,
    libraries=(
        *("numpy", "scipy", "opencv-contrib-python-headless", "rawpy", "pillow", "tifffile"),
        *("exifread", "colour-science"),
    ),
    estimate=estimate,
    knobs=(
        Knob("demosaic", ("linear", "vng", "ahd", "dht"), quick=()),
        Knob("half_size", (True, False), quick=(True,)),
    ),
)
