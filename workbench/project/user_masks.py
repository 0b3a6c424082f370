"""The masks people draw: ``masks/training`` to learn from, ``masks/corrected`` to win.

A mask is a PNG as large as what it belongs to and named like it: ``scan_03.png`` for
the range map ``scan_03``, one pixel per cell of the scanner's grid; ``DSC_0012.png`` for the
photograph ``DSC_0012.NEF``, upright as the photograph is shown. 255 = keep, 0 = clutter.
Where a scan and a photograph share a name, ``DSC_0012.NEF.png`` says which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.mask_png import read_mask_png, write_mask_png

Role = Literal["training", "corrected"]
Kind = Literal["scan", "photo"]


@dataclass(frozen=True)
class Subject:
    """A range map or a photograph that can have a mask.

    Attributes
    ----------
    kind : which of the two.
    name : of the range map, or of the photograph's file without its suffix.
    file : name of the user's file.
    size : width and height of the mask, pixels; None for a scan without a grid, which can
        have none.
    """

    kind: Kind
    name: str
    file: str
    size: tuple[int, int] | None


def mask_folder(root: Path, role: Role) -> Path:
    """Where the masks of a role lie in a project."""
    return root / "masks" / role


def mask_path(root: Path, role: Role, subject: Subject, subjects: Sequence[Subject]) -> Path:
    """Where the user's mask of a subject lies, whether or not it is there."""
    shared = any(other.name == subject.name and other.kind != subject.kind for other in subjects)
    stem = subject.file if shared else subject.name
    return mask_folder(root, role) / f"{stem}.png"


def masks_by_subject(files: Sequence[Path], subjects: Sequence[Subject]) -> dict[Subject, Path]:
    """Every mask file with what it belongs to, in the order of ``subjects``.

    Raises
    ------
    InputError
        For a file that belongs to nothing, to two things, or to a scan without a grid; for
        two files that belong to one thing.
    """
    found: dict[Subject, Path] = {}
    for path in files:
        stem = path.name.removesuffix(path.suffix)
        matches = [s for s in subjects if stem == s.file] or [s for s in subjects if stem == s.name]
        if path.suffix.lower() != ".png" or len(matches) != 1:
            raise _unmatched(path, stem, subjects, len(matches))
        subject = matches[0]
        if subject.size is None:
            raise InputError(
                "The scan has no grid, so it can have no mask",
                file=path,
                fix="export the scan with the scanner's own grid, or remove the mask",
            )
        if subject in found:
            raise InputError(
                f"Two masks for one {subject.kind}",
                file=path,
                found=f"also {found[subject].name}",
                fix="keep one of them",
            )
        found[subject] = path
    return {subject: found[subject] for subject in subjects if subject in found}


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """A user's mask, (h, w) uint8 of 0 and 255.

    Parameters
    ----------
    size : width and height it must have.

    Raises
    ------
    InputError
        When it is no image, or of another size.
    """
    try:
        mask = read_mask_png(path)
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(
            "The mask cannot be read",
            file=path,
            found=str(error) or type(error).__name__,
            expected="a PNG, white where the object is",
            fix="draw it again: workbench edit-masks",
        ) from error
    found = mask.shape[::-1]
    if found != size:
        raise InputError(
            "The mask has another size than what it belongs to",
            file=path,
            expected=f"{size[0]} × {size[1]} pixels",
            found=f"{found[0]} × {found[1]} pixels",
            fix="draw the mask on the image at its own size: workbench edit-masks",
        )
    return mask


def write_mask(path: Path, mask: NDArray[np.uint8]) -> None:
    """Write a mask (h, w) uint8 whole: beside, synced, renamed; the same bytes each time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        write_mask_png(temporary, mask)


def _unmatched(path: Path, stem: str, subjects: Sequence[Subject], matches: int) -> InputError:
    from workbench.project.settings import suggestion

    if path.suffix.lower() != ".png":
        return InputError(
            "A mask must be a PNG file", file=path, fix="save it as PNG, or move it elsewhere"
        )
    if matches:
        return InputError(
            "The mask belongs to a scan and to a photograph",
            file=path,
            expected=" or ".join(f"{s.file}.png" for s in subjects if s.name == stem),
            fix="name it after the file",
        )
    names = [subject.name for subject in subjects]
    return InputError(
        "The mask belongs to no scan and no photograph",
        file=path,
        expected="the name of a scan or of a photograph"
        + (f", {names[0]}.png to {names[-1]}.png" if names else ""),
        fix=suggestion(stem, names) or "rename it, or move it elsewhere",
    )
