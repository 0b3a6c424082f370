"""What in a project can have a mask, and the picture a mask is drawn on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.project.artefacts import ARTEFACTS
from workbench.project.project import Project
from workbench.project.store import is_file_name
from workbench.project.user_masks import Subject

# No scanner has more, and a mask is made room for before any of it is there.
_MOST_CELLS = 1 << 29


def mask_subjects(project: Project) -> tuple[Subject, ...]:
    """Every range map and every photograph of a project, in the project's order.

    The range maps are known once ``ingest`` has run.

    Raises
    ------
    InputError
        When a photograph cannot be read, or two share a name.
    """
    if not project.store.exists("scan_inventory"):
        return photo_subjects(project.photo_files)
    inventory = project.store.load("scan_inventory")
    file = project.store.path("scan_inventory")
    return (*scan_subjects(inventory, file), *photo_subjects(project.photo_files))


def subjects_of(inventory: Mapping[str, Any], files: Sequence[Path]) -> tuple[Subject, ...]:
    """The range maps of a scan inventory, empty before there is one, and the photographs.

    Raises
    ------
    InputError
        When a photograph cannot be read, or two share a name.
    """
    return (*scan_subjects(inventory), *photo_subjects(files))


def scan_subjects(inventory: Mapping[str, Any], file: Path | None = None) -> tuple[Subject, ...]:
    """The range maps of a scan inventory; those without a grid have no size.

    Parameters
    ----------
    file : where the inventory is from, for the error.

    Raises
    ------
    InputError
        It is none: masks are written by these names, which must not lead elsewhere.
    """
    try:
        return tuple(_scan_subject(entry) for entry in inventory.get("scans", ()))
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(
            "The inventory of scans is damaged",
            file=file or ARTEFACTS["scan_inventory"].path,
            found=f"{type(error).__name__}: {error}"[:200],
            fix="run ingest again with --force",
        ) from error


def _scan_subject(entry: Mapping[str, Any]) -> Subject:
    name, scan_file, grid = entry["name"], entry["file"], entry["grid"]
    for text in (name, scan_file):
        if not (isinstance(text, str) and is_file_name(text)):
            raise ValueError(f"{text!r} is no name of a file")
    size = _turned(grid)
    if size is not None and (min(size) < 0 or size[0] * size[1] > _MOST_CELLS):
        raise ValueError(f"a grid of {size[0]} × {size[1]} cells")
    return Subject("scan", name, scan_file, size)


def photo_subjects(files: Sequence[Path]) -> tuple[Subject, ...]:
    """The photographs, named by their files without suffix.

    Raises
    ------
    InputError
        When one cannot be read, or two share a name.
    """
    from workbench.formats.photo_reading import photo_size

    return tuple(
        Subject("photo", name, path.name, photo_size(path))
        for name, path in photos_by_name(files).items()
    )


def photos_by_name(files: Sequence[Path]) -> dict[str, Path]:
    """File name without suffix → photograph.

    Raises
    ------
    InputError
        When two share a name, as a RAW file and the camera's own JPEG of it do.
    """
    named: dict[str, Path] = {}
    for path in files:
        if path.stem in named:
            raise InputError(
                "Two photographs share a name",
                file=path,
                found=str(named[path.stem]),
                fix="keep one of the two: of a RAW file and a JPEG of the same shot, the RAW file",
            )
        named[path.stem] = path
    return named


def subject_picture(project: Project, subject: Subject) -> NDArray[np.uint8]:
    """What a subject looks like: (h, w, 3) uint8 sRGB of the subject's size.

    Of a range map its reflectance, else its colours, else its shape.

    Raises
    ------
    InputError
        When the file is not there or cannot be read, or the scan has no grid.
    """
    if subject.kind == "photo":
        from workbench.formats.photo_reading import read_photo

        return read_photo(photos_by_name(project.photo_files)[subject.name])
    from workbench.masking.range_map_signal import range_map_picture

    return range_map_picture(project.store.load("range_maps", subject.name))


def _turned(grid: Sequence[int] | None) -> tuple[int, int] | None:
    """(rows, columns) as width and height."""
    return None if grid is None else (int(grid[1]), int(grid[0]))
