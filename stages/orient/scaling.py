"""How large photographs alone say the object is, and which way up it stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.orient.options import OrientOptions
from workbench.errors import InputError
from workbench.metrics import Metric
from workbench.pipeline.stage import Job

if TYPE_CHECKING:
    from workbench.formats.colmap import ColmapModel
    from workbench.orientation.scale import NoScale, Scale

_TAKEN_FOR_METRES = (
    "lengths are taken for metres, as the given cameras have them; where they have no scale, "
    "tell distances (orient.camera_distances_m), or say so (orient.given_unit=none)"
)
_NO_SCALE = (
    "no scale: lengths are in a unit of the photographs' own; photograph coded markers "
    "(orient.marker_size_m), or tell distances between cameras (orient.camera_distances_m)"
)


@dataclass(frozen=True)
class OwnScale:
    """What is told of the scale: plain data, warnings and metrics."""

    told: dict[str, Any]
    warnings: tuple[str, ...] = ()
    metrics: tuple[Metric, ...] = ()


def in_own_scale(
    job: Job[OrientOptions], model: ColmapModel, photos: Mapping[str, Path], picks: tuple[Any, ...]
) -> tuple[ColmapModel, OwnScale]:
    """The model in metres, where places, markers or distances tell how large it is.

    What was not brought in a frame of the user's own stands upright.
    """
    from workbench.geometry.similarity import Similarity
    from workbench.orientation.alignment import transformed
    from workbench.orientation.scale import NoScale
    from workbench.orientation.upright import standing

    if picks:
        model, error = _onto_picks(model, picks)
        return model, OwnScale({"way": "picks", "error_m": error.value}, metrics=(error,))
    scale = _scale(job, model, photos)
    if isinstance(scale, NoScale):
        raise InputError(
            f"The scale cannot be told: {scale.reason}", fix="correct orient's options"
        )
    if not job.scene.cameras:
        model = transformed(model, standing(model))
    elif scale is None and job.options.given_unit == "m":
        return model, OwnScale({"way": "cameras as given"}, (_TAKEN_FOR_METRES,))
    if scale is None:
        return model, OwnScale({"way": "none"}, (_NO_SCALE,))
    metrics = (
        Metric("scale_distances", scale.told_by, "", "Known distances that tell the scale."),
        Metric("scale_spread", 100.0 * scale.spread, "%", "How far they scatter, robust sigma."),
    )
    to_metres = Similarity(scale.metres, np.eye(3), np.zeros(3))
    return transformed(model, to_metres), OwnScale(asdict(scale), metrics=metrics)


def before_the_surface(
    model: ColmapModel, picks: tuple[Any, ...]
) -> tuple[ColmapModel, str, tuple[Metric, ...]]:
    """The model in the scans' frame before they have a surface: by picks, or as it was given.

    Returns
    -------
    The model, in which of the two ways, and how well.
    """
    if not picks:
        return model, "as given", ()
    model, error = _onto_picks(model, picks)
    return model, "picks", (error,)


def _onto_picks(model: ColmapModel, picks: tuple[Any, ...]) -> tuple[ColmapModel, Metric]:
    """The model where the places picked belong, and how far these are off."""
    from workbench.orientation.alignment import transformed
    from workbench.orientation.picks import NoPicks, similarity_of_picks

    placed = similarity_of_picks(model, picks)
    if isinstance(placed, NoPicks):
        raise InputError(f"alignment.toml: {placed.reason}", fix="correct it, or take it away")
    error = Metric("picks_error", placed.error, "m", "RMS distance of the places picked.")
    return transformed(model, placed.surface_from_model), error


def _scale(
    job: Job[OrientOptions], model: ColmapModel, photos: Mapping[str, Path]
) -> Scale | NoScale | None:
    """What the options tell of the scale; None where they tell nothing."""
    from workbench.formats.photo_reading import read_photo
    from workbench.orientation.scale import markers_in, scale_by_cameras, scale_by_markers

    options, cameras = job.options, model.photo_cameras()
    if options.marker_size_m is not None or options.marker_distances_m:
        distances = {
            (int(one), int(other)): apart
            for (one, other), apart in _pairs(options.marker_distances_m, "marker_distances_m")
        }
        with job.progress.step("looking for coded markers"):
            corners = {
                name: markers_in(read_photo(photos[name]), options.markers) for name in cameras
            }
        return scale_by_markers(cameras, corners, options.marker_size_m, distances)
    if options.camera_distances_m:
        named = dict(_pairs(options.camera_distances_m, "camera_distances_m"))
        return scale_by_cameras(cameras, named)
    return None


def _pairs(given: Mapping[str, float], option: str) -> list[tuple[tuple[str, str], float]]:
    found = []
    for key, apart in given.items():
        names = key.split()
        numbers = option != "marker_distances_m" or all(name.isdigit() for name in names)
        if len(names) != 2 or not apart > 0.0 or not numbers:
            raise InputError(
                f"orient.{option} tells no distance",
                found=f"{key!r} = {apart}",
                expected="two names with a space between, and a length above 0",
                fix="correct it in project.toml",
            )
        found.append(((names[0], names[1]), apart))
    return found
