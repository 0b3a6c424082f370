"""Photographs in, oriented cameras and the points they share out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from os import cpu_count
from time import perf_counter
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from workbench.errors import InputError
from workbench.formats.colmap import ColmapModel
from workbench.orientation.features import FeatureSettings, PhotoFeatures, features_of
from workbench.orientation.mapping import (
    MappingSettings,
    adjusted,
    placed,
    quiet_pycolmap,
    start_camera,
)
from workbench.orientation.matching import MatchSettings, matched
from workbench.orientation.pairs import PairSettings, pairs_to_match
from workbench.orientation.photographs import PhotoToOrient
from workbench.orientation.reconstruction import colmap_model, reprojection_px
from workbench.orientation.two_views import TwoViews, VerificationSettings, verified

Progress = Callable[[str, float], None]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class OrientationSettings:
    """How photographs are oriented; see the parts.

    Attributes
    ----------
    features, pairs, matches, verification, mapping : settings of the steps.
    seed : of all draws.
    workers : photographs and pairs at once; None takes one per core. Not seen in the result.
        Each takes `feature_memory_bytes` while features are found.
    """

    features: FeatureSettings = field(default_factory=FeatureSettings)
    pairs: PairSettings = field(default_factory=PairSettings)
    matches: MatchSettings = field(default_factory=MatchSettings)
    verification: VerificationSettings = field(default_factory=VerificationSettings)
    mapping: MappingSettings = field(default_factory=MappingSettings)
    seed: int = 0
    workers: int | None = None


@dataclass(frozen=True)
class Orientation:
    """Where the photographs were taken; falsy where none could be placed.

    Attributes
    ----------
    model : placed photographs with all their features as observations, and the points; the
        frame and the scale are arbitrary. Photograph i has image id i + 1.
    unplaced : reason by name of every photograph that could not be placed.
    reason : why nothing could be placed; empty where something could.
    reprojection_px : root mean square distance of observations from their points.
    mean_track : photographs that see a point, on average.
    pairs_compared, pairs_verified : how many pairs were matched, and obeyed one motion.
    seconds : wall time by step.
    """

    model: ColmapModel
    unplaced: dict[str, str]
    reason: str = ""
    reprojection_px: float = float("nan")
    mean_track: float = float("nan")
    pairs_compared: int = 0
    pairs_verified: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.model.images)


def oriented(
    photos: Sequence[PhotoToOrient],
    settings: OrientationSettings | None = None,
    progress: Progress | None = None,
    features: Sequence[PhotoFeatures] | None = None,
) -> Orientation:
    """The cameras of photographs, found from the photographs alone.

    Parameters
    ----------
    photos : of different names.
    settings : how; the same photographs, settings and seed give the same result to the bit.
    progress : told what is under way and its share done, 0 to 1; what it raises ends the work.
    features : what `features_of` found in each photograph; None finds them here.

    Raises
    ------
    InputError
        A photograph or mask cannot be read, a name comes twice, or a prior focal length is
        not positive.
    """
    settings = settings or OrientationSettings()
    tell = progress or _silent
    names = _names(photos)
    seconds: dict[str, float] = {}
    start = perf_counter()

    def done(step: str) -> None:
        nonlocal start
        seconds[step] = perf_counter() - start
        start = perf_counter()

    workers = settings.workers or cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool, threadpool_limits(1, "blas"), quiet_pycolmap():
        if features is None:
            features = _each(
                pool, lambda one: features_of(one, settings.features), photos, "features", tell
            )
        done("features")
        pairs = pairs_to_match(
            features,
            settings.pairs,
            lambda likeness, some: _each(pool, likeness, some, "pairs", tell),
        )
        done("pairs")
        camera_of, cameras = _shared_cameras(photos, features)
        sights = _each(
            pool,
            lambda pair: _two_views(pair, features, camera_of, cameras, settings),
            pairs,
            "matching",
            tell,
        )
        views = [sight for sight in sights if sight is not None]
        done("matching")
        placed_so_far = 2

        def on_photo() -> None:
            nonlocal placed_so_far
            placed_so_far += 1
            tell("placing", min(placed_so_far / len(photos), 1.0))

        tell("placing", 0.0)
        found = placed(
            names, features, camera_of, cameras, views, settings.mapping, settings.seed, on_photo
        )
        done("placing")
        if found is None:
            return _nothing(names, features, views, len(pairs), seconds)
        tell("adjusting", 0.0)
        found = adjusted(found, settings.mapping)
        done("adjusting")
    model = colmap_model(found, features)
    there = {number - 1 for number in model.images}
    return Orientation(
        model=model,
        unplaced={
            name: _why_not(index, features[index], views, there)
            for index, name in enumerate(names)
            if index not in there
        },
        reprojection_px=reprojection_px(model),
        mean_track=float(found.compute_mean_track_length()),
        pairs_compared=len(pairs),
        pairs_verified=len(views),
        seconds=seconds,
    )


def _names(photos: Sequence[PhotoToOrient]) -> list[str]:
    """The photographs' names, once what is said of the photographs makes sense."""
    names = [photo.name for photo in photos]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InputError("A photograph's name comes twice.", found=", ".join(twice))
    for photo in photos:
        if photo.focal_px is not None and not 0.0 < photo.focal_px < np.inf:
            raise InputError(
                "A focal length must be positive.",
                where=photo.name,
                found=f"{photo.focal_px} px",
                fix="Correct it in the photograph's EXIF data, or leave it out.",
            )
    return names


def _silent(step: str, share: float) -> None:
    """No progress is wanted."""


def _each(
    pool: ThreadPoolExecutor,
    function: Callable[[_Item], _Result],
    items: Sequence[_Item],
    step: str,
    tell: Progress,
) -> list[_Result]:
    """Results of all items in their order."""
    tell(step, 0.0)
    results = []
    futures = [pool.submit(function, item) for item in items]
    try:
        for number, future in enumerate(futures, start=1):
            results.append(future.result())
            tell(step, number / len(futures))
    finally:
        for future in futures:
            future.cancel()
    return results


def _shared_cameras(
    photos: Sequence[PhotoToOrient], features: Sequence[PhotoFeatures]
) -> tuple[list[int], dict[int, Any]]:
    """Per photograph its camera's identifier, and pycolmap's cameras by identifier."""
    numbers: dict[tuple[str, int, int], int] = {}
    priors: dict[int, list[float]] = {}
    camera_of = []
    for photo, seen in zip(photos, features, strict=True):
        key = (photo.camera_key, seen.width, seen.height)
        number = numbers.setdefault(key, len(numbers) + 1)
        camera_of.append(number)
        priors.setdefault(number, []).extend([] if photo.focal_px is None else [photo.focal_px])
    cameras = {
        number: start_camera(
            number, width, height, float(np.median(priors[number])) if priors[number] else None
        )
        for (_, width, height), number in numbers.items()
    }
    return camera_of, cameras


def _two_views(
    pair: tuple[int, int],
    features: Sequence[PhotoFeatures],
    camera_of: Sequence[int],
    cameras: Mapping[int, Any],
    settings: OrientationSettings,
) -> TwoViews | None:
    i, j = pair
    return verified(
        i,
        j,
        (features[i], features[j]),
        (cameras[camera_of[i]], cameras[camera_of[j]]),
        matched(features[i].descriptors, features[j].descriptors, settings.matches),
        settings.verification,
        settings.seed,
    )


def _nothing(
    names: Sequence[str],
    features: Sequence[PhotoFeatures],
    views: Sequence[TwoViews],
    compared: int,
    seconds: dict[str, float],
) -> Orientation:
    if not views:
        reason = "no two photographs show enough of the same"
    else:
        reason = "no two photographs show the same from places far enough apart"
    return Orientation(
        model=ColmapModel({}, {}),
        unplaced={name: _why_not(i, features[i], views, set()) for i, name in enumerate(names)},
        reason=reason,
        pairs_compared=compared,
        pairs_verified=len(views),
        seconds=seconds,
    )


def _why_not(
    index: int, seen: PhotoFeatures, views: Sequence[TwoViews], placed_ones: set[int]
) -> str:
    """Why a photograph has no place, in plain words."""
    if len(seen.points) == 0:
        return "nothing to be recognised in it: no features inside its mask"
    partners = {
        view.second if view.first == index else view.first
        for view in views
        if index in (view.first, view.second)
    }
    if not partners:
        return f"no other photograph shows enough of its {len(seen.points)} features"
    if not partners & placed_ones:
        return f"it shares features with {len(partners)} others, none of which could be placed"
    return (
        f"it shares features with {len(partners & placed_ones)} of those placed, too few or too "
        "contradictory to place it"
    )
