"""What a photographer notes of calibration frames: ``calibration/*.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from workbench.errors import InputError

_FLAT = "flat"
_FARTHEST_M = 1e6
_EXAMPLE = '[distances_m]\n"linearity_00.dng" = 1.9'


@dataclass(frozen=True)
class CalibrationNotes:
    """Notes of calibration frames.

    Attributes
    ----------
    distances_m : file name → distance from the flash to the target.
    flat : file names of even targets; None where the notes do not say, and names tell.
    """

    distances_m: Mapping[str, float] = field(default_factory=dict)
    flat: tuple[str, ...] | None = None

    def is_flat(self, file: str) -> bool:
        """Whether a frame shows an even target: as noted, else by a name that begins so."""
        if self.flat is not None:
            return file in self.flat
        return file.lower().startswith(_FLAT)


def read_calibration_notes(paths: Iterable[Path], known: Iterable[str]) -> CalibrationNotes:
    """The notes in some TOML files: a table ``distances_m`` and a list ``flat``.

    Parameters
    ----------
    paths : the files.
    known : names of all photographs and frames; a note on any other is an error.

    Raises
    ------
    InputError
        When a file is not valid, or names a frame that is not there.
    """
    distances: dict[str, float] = {}
    flat: list[str] | None = None
    names = set(known)
    for path in paths:
        try:
            document = tomllib.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError, OSError) as error:
            raise InputError(
                "The notes on calibration cannot be read",
                file=path,
                found=str(error)[:200],
                expected=_EXAMPLE,
                fix="correct the file",
            ) from error
        told = document.get("distances_m", {})
        listed = document.get("flat", [])
        sound = (
            document.keys() <= {"distances_m", "flat"}
            and isinstance(told, dict)
            and all(isinstance(d, int | float) and 0 < d < _FARTHEST_M for d in told.values())
            and isinstance(listed, list)
            and all(isinstance(name, str) for name in listed)
        )
        if not sound:
            raise InputError(
                "The notes on calibration are not understood",
                file=path,
                expected=f"{_EXAMPLE}\nand flat = [file names]",
                found=", ".join(map(str, document)),
                fix="correct the file",
            )
        strangers = [name for name in (*told, *listed) if name not in names]
        if strangers:
            raise InputError(
                "The notes on calibration name frames that are not there",
                file=path,
                found=", ".join(strangers),
                fix="write file names with their suffix, as they are in the folder",
            )
        distances |= {name: float(distance) for name, distance in told.items()}
        if "flat" in document:
            flat = [*(flat or []), *listed]
    return CalibrationNotes(distances, None if flat is None else tuple(flat))
