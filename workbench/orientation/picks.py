"""Places the user found both on the surface and in photographs.

``alignment.toml`` in the project folder::

    [[points]]
    world = [0.12, -0.30, 1.52]          # in the coordinates of the scans
    photo_003 = [1204.5, 873.0]          # right and down from the upper left corner, pixels
    photo_007 = [802.0, 911.5]
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.colmap import ColmapModel
from workbench.geometry.lines import place_nearest_to
from workbench.geometry.similarity import Similarity, best_similarity

_LEAST_PICKS = 3
_WORST_CONDITION = 1e8
_WORLD = "world"
# No coordinate and no pixel is beyond this.
_LARGEST = 1e15
_FIX = "Correct the file at that place."


@dataclass(frozen=True)
class Pick:
    """One place.

    Attributes
    ----------
    world : (3,) float64 on the surface.
    pixels : photograph's name without suffix → (2,) where it shows.
    """

    world: NDArray[np.float64]
    pixels: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class PickedPlace:
    """The similarity the user's places make, and how well they agree (root mean square)."""

    surface_from_model: Similarity
    error: float


@dataclass(frozen=True)
class NoPicks:
    """Why the user's places do not say where the model belongs; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


def read_picks(path: Path, photos: Mapping[str, Path]) -> tuple[Pick, ...]:
    """The places in ``alignment.toml``.

    Parameters
    ----------
    photos : the photographs by name without suffix.

    Raises
    ------
    InputError : no TOML, an unknown photograph, a value that is no place, a place in fewer than
        two photographs, or fewer than three places.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            "The file of places cannot be read", file=path, found=str(error)[:200], fix=_FIX
        ) from None
    entries = table.get("points")
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise InputError(
            "There are no places in it", file=path, expected="[[points]] tables", fix=_FIX
        )
    picks = tuple(_pick(entry, path, number, photos) for number, entry in enumerate(entries, 1))
    if len(picks) < _LEAST_PICKS:
        raise InputError(
            "Too few places",
            file=path,
            expected="three, better five",
            found=str(len(picks)),
            fix="Pick more places, each in two photographs or more.",
        )
    return picks


def similarity_of_picks(model: ColmapModel, picks: tuple[Pick, ...]) -> PickedPlace | NoPicks:
    """Where the model belongs by the places that two of its photographs or more show."""
    cameras = model.photo_cameras()
    ours, theirs = [], []
    for pick in picks:
        seen = [name for name in sorted(pick.pixels) if name in cameras]
        if len(seen) < 2:
            continue
        rays = [
            (cameras[name].center, cameras[name].directions(pick.pixels[name][None])[0])
            for name in seen
        ]
        place = place_nearest_to(rays, _WORST_CONDITION)
        if place is not None:
            ours.append(place)
            theirs.append(pick.world)
    if len(ours) < _LEAST_PICKS:
        return NoPicks("fewer than three of the picked places show in two placed photographs")
    found = best_similarity(np.array(ours), np.array(theirs))
    if not isinstance(found, Similarity):
        return NoPicks(f"the picked places do not fix the model: {found.reason}")
    apart = np.linalg.norm(found.apply(np.array(ours)) - np.array(theirs), axis=1)
    return PickedPlace(found, float(np.sqrt((apart**2).mean())))


def _pick(entry: Mapping[str, object], path: Path, number: int, photos: Mapping[str, Path]) -> Pick:
    where = f"place {number}"
    world = _numbers(entry.get(_WORLD), 3, path, f"{where}, {_WORLD}")
    pixels = {}
    for name, value in entry.items():
        if name == _WORLD:
            continue
        if name not in photos:
            raise InputError(
                "There is no such photograph",
                file=path,
                where=where,
                expected="names without suffix, like " + ", ".join(list(photos)[:3]),
                found=name,
                fix=_FIX,
            )
        pixels[name] = _numbers(value, 2, path, f"{where}, {name}")
    if len(pixels) < 2:
        raise InputError(
            "A place must be shown by two photographs or more",
            file=path,
            where=where,
            fix="Pick it in another photograph, or leave the place out.",
        )
    return Pick(world, pixels)


def _numbers(value: object, count: int, path: Path, where: str) -> NDArray[np.float64]:
    if (
        not isinstance(value, list)
        or len(value) != count
        or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
        # By Python, which compares whole numbers of any length.
        or not all(abs(v) < _LARGEST for v in value)
    ):
        raise InputError(
            "This is no place", file=path, where=where, expected=f"{count} numbers",
            found=str(value)[:200], fix=_FIX,
        )  # fmt: skip
    return np.array(value, float)
