"""What in a project can have a mask, and the picture a mask is drawn on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.project.project import Project
from workbench.project.user_masks import Subject


def mask_subjects(project: Project) -> tuple[Subject, ...]:
    """Every range map and every photograph of a project, in the project's order.

    The range maps are known once ``ingest`` has run.

    Raises
    ------
    InputError
        When a photograph cannot be read, or two share a name.
    """
    inventory = (
        project.store.load("scan_inventory") if project.store.exists("scan_inventory") else {}
    )
    return subjects_of(inventory, project.photo_files)


def subjects_of(inventory: Mapping[str, Any], files: Sequence[Path]) -> tuple[Subject, ...]:
    """The range maps of a scan inventory, empty before there is one, and the photographs.

    Raises
    ------
    InputError
        When a photograph cannot be read, or two share a name.
    """
    return (*scan_subjects(inventory), *photo_subjects(files))


def scan_subjects(inventory: Mapping[str, Any]) -> tuple[Subject, ...]:
    """The range maps of a scan inventory; those without a grid have no size."""
    return tuple(
        Subject("scan", entry["name"], entry["file"], _turned(entry["grid"]))
        for entry in inventory.get("scans", ())
    )


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
