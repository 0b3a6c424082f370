"""What a report shows of the photographs' cameras: how sure they are, and how the surface fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.verification.camera_truth import CameraComparison
from workbench.verification.photo_sections import matted
from workbench.verification.quantities import shown_length, shown_unit
from workbench.verification.report_content import (
    Block,
    Column,
    Paragraph,
    Picture,
    PictureRow,
    Section,
    Table,
    TextList,
)

_SIDE_PX = 420
_OUTLINE = (255, 140, 0)
_WAYS = {
    "as given": "They were brought oriented, in the frame of the surface",
    "picks": "They were brought onto the surface by the places picked in alignment.toml",
    "shape": "They were brought onto the surface by its shape",
    "photographs": "The surface is made of these photographs, in their own frame. ",
}
_SCALES = {
    "none": "There is no scale: lengths are in a unit of the photographs’ own.",
    "cameras as given": "Its scale is that of the cameras as they were given.",
    "picks": "Its place and scale are those of the places picked in alignment.toml.",
    "markers": "Its scale is that of coded markers.",
    "cameras": "Its scale is that of known distances between cameras.",
}


@dataclass(frozen=True)
class OutlinedPhoto:
    """A photograph and where its camera sees the surface.

    Attributes
    ----------
    name : of the photograph.
    picture : (h, w, 3) uint8 sRGB.
    surface : (h', w') bool of the same aspect, where the surface should show.
    """

    name: str
    picture: NDArray[np.uint8]
    surface: NDArray[np.bool_]


def orientation_section(
    poses: Mapping[str, Any],
    shown: Sequence[OutlinedPhoto],
    truth: CameraComparison | None = None,
) -> Section:
    """The chapter on cameras.

    Parameters
    ----------
    poses : as the stage ``orient`` leaves them.
    shown : some photographs, where they lie in the frame of the surface.
    truth : how far the cameras are from the simulated ones, where these are known.
    """
    photos = poses["photos"]
    blocks: list[Block] = [Paragraph(_in_words(poses))]
    if truth is not None:
        blocks.append(Paragraph(_against_truth(truth)))
    if poses["unplaced"]:
        lost = tuple(f"{name}: {reason}" for name, reason in poses["unplaced"].items())
        blocks.append(TextList(lost, tone="attention"))
    if any("center_sigma_m" in entry for entry in photos.values()):
        blocks.append(_table(poses))
    if shown:
        mats = matted([outlined(photo) for photo in shown])
        pictures = tuple(
            Picture(pixels, photo.name, f"{photo.name} with the outline of the model", True)
            for pixels, photo in zip(mats, shown, strict=True)
        )
        told = "The outline is that of the model as each photograph’s camera sees it."
        blocks.append(PictureRow(pictures, told))
    return Section("Cameras", "Where the photographs were taken from.", tuple(blocks))


def outlined(photo: OutlinedPhoto) -> NDArray[np.uint8]:
    """The photograph, small, with the outline of the surface drawn on it, (h, w, 3) uint8."""
    share = min(1.0, _SIDE_PX / max(photo.picture.shape[:2]))
    size = tuple(max(1, round(share * side)) for side in photo.picture.shape[1::-1])
    small = np.array(cv2.resize(photo.picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    mask = cv2.resize(photo.surface.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    lines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(small, lines, -1, _OUTLINE, 1, cv2.LINE_AA)
    return small


def _in_words(poses: Mapping[str, Any]) -> str:
    placed, lost = len(poses["photos"]), len(poses["unplaced"])
    text = f"{placed} of {placed + lost} photographs have a camera. "
    if poses["frame"] != "world":
        return text + "They lie in a frame and a scale of their own, not in that of the surface."
    text += _WAYS[poses["way"]]
    if poses["way"] == "photographs":
        return text + _SCALES[poses["scale"]["way"]]
    sure = any("center_sigma_m" in entry for entry in poses["photos"].values())
    text += (
        ", and adjusted to it together with the lenses: points that photographs share are held "
        "by the measured surface, which fixes the scale."
        if sure
        else ", and left as they came."
    )
    silhouettes = poses.get("silhouettes", {})
    if silhouettes:
        beside = {name: 100 * one["beside"] for name, one in silhouettes.items()}
        hidden = 100 * float(np.mean([one["hidden"] for one in silhouettes.values()]))
        worst = max(beside, key=lambda name: beside[name])
        text += (
            f" {100 - np.mean(list(beside.values())):.1f} % of what the masks keep lies on the "
            "surface as the cameras see it "
            f"(mean; least, {100 - beside[worst]:.1f} %, in {worst}); "
            f"{hidden:.1f} % of that surface is masked, by supports before it and by shadows."
        )
    return text


def _against_truth(truth: CameraComparison) -> str:
    return (
        "Against the simulated cameras, in the scans’ frame: "
        f"{shown_length(np.median(truth.center_m))} and {np.median(truth.rotation_deg):.3f}° "
        "in the median, "
        f"{shown_length(truth.center_m.max())} and {truth.rotation_deg.max():.3f}° at the most."
    )


def _table(poses: Mapping[str, Any]) -> Table:
    rows = tuple(
        (
            name,
            int(entry["points"]),
            1e3 * float(np.linalg.norm(entry["center_sigma_m"])),
            float(entry["rotation_sigma_deg"]),
        )
        for name, entry in sorted(poses["photos"].items())
        if "center_sigma_m" in entry
    )
    columns = (
        Column("photograph", style="code"),
        Column("points", decimals=0),
        Column("place ±", shown_unit("mm"), 2),
        Column("turn ±", "°", 3),
    )
    told = "Standard deviations from the noise of the points; neighbouring patches err together."
    return Table(columns, rows, told)
