"""What a report shows of the masks: how wrong they are, and what they look like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.masking import overlay
from workbench.verification.mask_errors import CheckedMasks
from workbench.verification.photo_sections import matted
from workbench.verification.report_content import (
    Block,
    Column,
    LegendEntry,
    Paragraph,
    Picture,
    PictureRow,
    Section,
    Table,
)

_SIDE_PX = 420


@dataclass(frozen=True)
class ShownMask:
    """A scan or a photograph to show with its mask.

    Attributes
    ----------
    name : of the scan or photograph.
    picture : (h, w, 3) uint8 sRGB.
    mask : (h', w') uint8, 255 = keep; of the same aspect.
    truth : the same, where it is known.
    """

    name: str
    picture: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    truth: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class MaskedKind:
    """All that is to be told of the masks of scans, or of photographs.

    Attributes
    ----------
    plural : ``scans`` or ``photographs``.
    masked, of : how many have a mask, of how many.
    by_hand : how many masks are as the user drew them.
    seconds : per mask, median.
    shown : some of them.
    checked : errors, where a truth is known.
    truth : what they were compared with, for people.
    """

    plural: str
    masked: int
    of: int
    by_hand: int
    seconds: float
    shown: Sequence[ShownMask]
    checked: CheckedMasks | None = None
    truth: str = ""


def masks_section(kinds: Sequence[MaskedKind]) -> Section:
    """The chapter on masks; kinds without masks are left out by the caller."""
    blocks: list[Block] = []
    for kind in kinds:
        blocks.append(Paragraph(_sentence(kind)))
        if kind.checked is not None:
            blocks.append(_error_table(kind, kind.checked))
        if kind.shown:
            blocks.append(_overlays(kind))
        told = [shown for shown in kind.shown if shown.truth is not None]
        if told:
            blocks.append(_differences(kind, told))
    intro = (
        "What was taken for the object, and what was masked away as clutter before any other step."
    )
    return Section("Masks", intro, tuple(blocks))


def _sentence(kind: MaskedKind) -> str:
    by_hand = f", {kind.by_hand} of them as drawn by hand" if kind.by_hand else ""
    return (
        f"{kind.masked} of {kind.of} {kind.plural} have a mask{by_hand}; "
        f"{kind.seconds:.1f} s a mask."
    )


def _error_table(kind: MaskedKind, checked: CheckedMasks) -> Table:
    found, used = checked.automatic, checked.final
    unit = "samples" if kind.plural == "scans" else "pixels"
    columns = (
        Column(""),
        Column(f"as found, {unit}"),
        Column("as found", "%", 3),
        Column(f"as used, {unit}"),
        Column("as used", "%", 3),
    )
    counted = [
        ("Object", "model_samples", ""),
        ("Clutter", "clutter_samples", ""),
        ("False positives: clutter kept", "false_positives", "false_positive_percent"),
        ("False negatives: object masked away", "false_negatives", "false_negative_percent"),
    ]
    if found.true_false_negatives is not None:
        label = "True false negatives: and kept nowhere else"
        counted.append((label, "true_false_negatives", "true_false_negative_percent"))
    rows = tuple(
        (
            label,
            *(
                cell
                for errors in (found, used)
                for cell in (getattr(errors, count), getattr(errors, share) if share else None)
            ),
        )
        for label, count, share in counted
    )
    caption = (
        f"Masks of {kind.plural} against {kind.truth}, as found by the classifier and as used, "
        "with what was drawn by hand in their place. Percentages are of the clutter "
        "(Jaspe 2018, tables 3.1 and 3.2)."
    )
    return Table(columns, rows, caption)


def _overlays(kind: MaskedKind) -> PictureRow:
    pictures = [overlay.overlay(*_of_one_size(one)[:2]) for one in kind.shown]
    legend = (
        LegendEntry(overlay.CLUTTER_TINT, "masked away"),
        LegendEntry(overlay.OUTLINE, "edge of the mask"),
    )
    return _row(kind, kind.shown, pictures, "Masks over what they belong to.", legend)


def _differences(kind: MaskedKind, shown: Sequence[ShownMask]) -> PictureRow:
    pictures = []
    for one in shown:
        _, mask, truth = _of_one_size(one)
        assert truth is not None
        pictures.append(overlay.difference(mask, truth))
    legend = (
        LegendEntry(overlay.RIGHT_KEPT, "object, kept"),
        LegendEntry(overlay.RIGHT_AWAY, "clutter or nothing, masked away"),
        LegendEntry(overlay.KEPT_WRONGLY, "clutter, kept"),
        LegendEntry(overlay.MISSED, "object, masked away here"),
    )
    return _row(kind, shown, pictures, f"The same masks against {kind.truth}.", legend)


def _row(
    kind: MaskedKind,
    shown: Sequence[ShownMask],
    pictures: Sequence[NDArray[np.uint8]],
    caption: str,
    legend: tuple[LegendEntry, ...],
) -> PictureRow:
    row = tuple(
        Picture(pixels, one.name, f"mask of {one.name}", is_photograph=kind.plural != "scans")
        for pixels, one in zip(matted(pictures), shown, strict=True)
    )
    return PictureRow(row, caption, legend)


def _of_one_size(
    one: ShownMask,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Picture, mask and truth, the longer side `_SIDE_PX`."""
    height, width = one.picture.shape[:2]
    share = _SIDE_PX / max(height, width)
    size = (max(1, round(width * share)), max(1, round(height * share)))

    def sized(image: NDArray[np.uint8], how: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.resize(image, size, interpolation=how), np.uint8)

    # A scan's grid is smaller than the page's picture: its cells are to be seen as they are.
    smooth = cv2.INTER_AREA if share < 1.0 else cv2.INTER_NEAREST
    truth = None if one.truth is None else sized(one.truth, cv2.INTER_NEAREST)
    return sized(one.picture, smooth), sized(one.mask, cv2.INTER_NEAREST), truth
