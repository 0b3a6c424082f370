"""What a report shows of the photographs: a contact sheet and, where it is known, the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.photo_preview import read_preview
from workbench.render.palette import INFILLED, PROVENANCE_COLORS, UNKNOWN_COLOR, srgb_from_linear
from workbench.verification.quantities import shown_number
from workbench.verification.report_content import (
    Block,
    LegendEntry,
    Paragraph,
    Picture,
    PictureRow,
    Section,
)

# As many as a page shows at once; more would make it heavy and nobody the wiser.
MOST_SHOWN = 30
_SHEET_PX, _TRUTH_PX = 260, 420
_MAT_COLOR = (52, 51, 49)
_Item = TypeVar("_Item")
_OBJECT_COLOR, _SHADOW_COLOR = (214, 210, 201), (52, 84, 140)


@dataclass(frozen=True)
class PhotoTruth:
    """Files with the truth about one simulated photograph.

    Attributes
    ----------
    photo : the photograph.
    albedo : 16 bits, linear Rec. 709 × 65535; None where it was not written.
    object_mask, support_mask, shadow_mask : 255 where it is so, else 0.
    """

    photo: Path
    albedo: Path | None
    object_mask: Path
    support_mask: Path
    shadow_mask: Path


def evenly_chosen(items: Sequence[_Item], most: int) -> list[_Item]:
    """At most ``most`` of the items, spread evenly, the first and the last among them."""
    places = np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int)
    return [items[k] for k in places]


def photographs_section(
    paths: Sequence[Path], used_by: Sequence[str], truths: Sequence[PhotoTruth] = ()
) -> tuple[Section, list[str]]:
    """A contact sheet, and for simulated photographs some of them beside their truth.

    Parameters
    ----------
    paths : all photographs of the project.
    used_by : names of the stages that worked with them.
    truths : photographs whose truth is known, as many as are to be shown.

    Returns
    -------
    The section, and a warning for each photograph that should be shown and cannot be read.
    """
    shown = evenly_chosen(paths, MOST_SHOWN)
    previews, warnings = {}, []
    for path in shown:
        try:
            previews[path] = read_preview(path, _SHEET_PX)
        except InputError as error:
            warnings.append(f"{path.name} cannot be read: {error.found}")
    pictures = tuple(
        Picture(picture, path.stem, path.name, is_photograph=True)
        for path, picture in zip(previews, matted(list(previews.values())), strict=True)
    )
    count = (
        f"All {len(paths)} photographs"
        if len(shown) == len(paths)
        else f"{len(shown)} of {shown_number(len(paths))} photographs, evenly chosen"
    )
    caption = f"{count}, as shot: developed with the camera’s white balance, not corrected."
    blocks: list[Block] = [PictureRow(pictures, caption)] if pictures else []
    if not used_by:
        blocks.append(Paragraph("No stage used them: the model has no colour from them."))
    blocks += [_truth_row(truth) for truth in truths]
    return Section("Photographs", "What the camera brought.", tuple(blocks)), warnings


def matted(pictures: Sequence[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """Pictures (h, w, 3) of several sizes, each centred on a dark mat that holds any of them."""
    if not pictures:
        return []
    height, width = np.max([picture.shape[:2] for picture in pictures], axis=0)
    mats = []
    for picture in pictures:
        mat = np.empty((height, width, 3), np.uint8)
        mat[:] = _MAT_COLOR
        top, left = (height - picture.shape[0]) // 2, (width - picture.shape[1]) // 2
        mat[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
        mats.append(mat)
    return mats


def _truth_row(truth: PhotoTruth) -> PictureRow:
    name = truth.photo.stem
    shot = read_preview(truth.photo, _TRUTH_PX)
    pictures = [Picture(shot, "as shot", f"{name} as shot", is_photograph=True)]
    size = (shot.shape[1], shot.shape[0])
    if truth.albedo is not None:
        linear = _read(truth.albedo, size)[..., ::-1].astype(np.float32) / np.float32(65535)
        albedo = srgb_from_linear(linear)
        pictures.append(
            Picture(albedo, "true albedo", f"true albedo of {name}", is_photograph=True)
        )
    masks = {
        color: _read(path, size) >= 128
        for path, color in (
            (truth.object_mask, _OBJECT_COLOR),
            (truth.support_mask, PROVENANCE_COLORS[INFILLED]),
            (truth.shadow_mask, _SHADOW_COLOR),
        )
    }
    pictures.append(Picture(_painted(masks, size), "true masks", f"true masks of {name}"))
    legend = (
        LegendEntry(_OBJECT_COLOR, "object"),
        LegendEntry(PROVENANCE_COLORS[INFILLED], "support"),
        LegendEntry(_SHADOW_COLOR, "in the flash’s shadow"),
        LegendEntry(UNKNOWN_COLOR, "table, or nothing"),
    )
    return PictureRow(tuple(pictures), f"{name} beside what is known of it.", legend)


def _painted(
    masks: Mapping[tuple[int, int, int], NDArray[np.bool_]], size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Masks in their colours (h, w, 3), later ones over earlier ones."""
    picture = np.empty((size[1], size[0], 3), np.uint8)
    picture[:] = UNKNOWN_COLOR
    for color, mask in masks.items():
        picture[mask] = color
    return picture


def _read(path: Path, size: tuple[int, int]) -> NDArray[np.unsignedinteger[Any]]:
    """A picture with all its bits, (rows, cols[, BGR]), reduced to (width, height)."""
    data = np.frombuffer(path.read_bytes(), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if picture is None:
        raise InputError("The picture cannot be read", file=path, fix="simulate it again")
    kind = np.uint16 if picture.dtype == np.uint16 else np.uint8
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), kind)
