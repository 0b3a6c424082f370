"""What a report says of texturing: which photographs show, the seams, and how good it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.verification.figures import line_figure
from workbench.verification.quantities import shown_number, shown_percent
from workbench.verification.report_content import (
    Block,
    Cell,
    Column,
    Paragraph,
    Picture,
    PictureRow,
    Plot,
    Section,
    Table,
    TextList,
)
from workbench.verification.texture_scaling import ScalingPoint
from workbench.verification.texture_views import WAYS, HeldOutView

_SHOWN_WAYS = ("stitched", "z-buffered", "overwritten", "simplified")
_MARGIN = 8
_MAT = (52, 51, 49)
# Labels are told apart by hues a golden ratio apart.
_GOLDEN = 0.61803398875


def texture_section(
    record: Mapping[str, Any],
    views: Sequence[HeldOutView],
    foreground: int,
    scaling: Sequence[ScalingPoint] = (),
) -> Section:
    """The chapter on texturing.

    Parameters
    ----------
    record : of the stage ``texture``.
    views : of photographs held out; none where none were.
    foreground : triangles of the depth meshes that their own photographs texture.
    scaling : both ways of labelling, timed at several sizes; none where that was left out.
    """
    said = {metric["name"]: metric["value"] for metric in record["metrics"]}
    blocks: list[Block] = [Paragraph(_in_words(said))]
    warnings = tuple(record.get("warnings", ()))
    if warnings:
        blocks.append(TextList(warnings, tone="attention"))
    blocks += [_pictures(view) for view in views[:1]]
    if views:
        blocks.append(_quality_table(views, foreground))
        blocks.append(_steps_table(views))
    else:
        blocks.append(
            Paragraph(
                "No photograph was kept out to compare renderings with; "
                "texture.held_out asks for some."
            )
        )
    blocks.append(_labels_table(said))
    if scaling:
        blocks.append(_scaling_plot(scaling))
    return Section(
        "Texture", "Which photograph shows where, and how good a rendering is.", tuple(blocks)
    )


def _in_words(said: Mapping[str, Any]) -> str:
    text = (
        f"{shown_number(int(said['photographs']))} photographs texture the surface, free of their "
        f"flash; {shown_percent(said['used_pixels'] / 100.0)} of what they show of it may be used, "
        f"and {shown_percent(said['doubted_pixels'] / 100.0)} of that is left out because the "
        "other photographs contradict it, as they do highlights and clutter. "
    )
    if "depth_meshes" in said:
        text += (
            f"{shown_number(int(said['depth_meshes']))} depth meshes hold "
            f"{shown_number(int(said['depth_triangles']))} triangles, "
            f"{shown_number(int(said['foreground_triangles']))} of them textured by their own "
            "photograph. "
        )
    if "atlas_pages" in said:
        pages = int(said["atlas_pages"])
        text += (
            f"The surface itself is textured from {shown_number(int(said['atlas_patches']))} "
            f"patches on {shown_number(pages)} {'page' if pages == 1 else 'pages'}; "
            f"{shown_percent(said['surface_unseen'] / 100.0)} of its triangles are shown wholly by "
            "no photograph and have the blended or inpainted colour."
        )
    return text


def _pictures(view: HeldOutView) -> PictureRow:
    rows, columns = np.nonzero(view.mask)
    box = (
        slice(max(rows.min() - _MARGIN, 0), rows.max() + _MARGIN),
        slice(max(columns.min() - _MARGIN, 0), columns.max() + _MARGIN),
    )
    pictures = [_picture(view.truth, view, box, view.told[0].upper() + view.told[1:])]
    pictures += [
        _picture(view.pictures[way], view, box, WAYS[way][0].upper() + WAYS[way][1:])
        for way in _SHOWN_WAYS
        if way in view.pictures
    ]
    pictures.append(_picture(_label_colors(view.labels), view, box, "Which photograph shows"))
    caption = (
        f"The view of {view.name}, which textured nothing: {view.told}, and renderings from the "
        "other photographs. Only what all of them show is compared."
    )
    return PictureRow(tuple(pictures), caption, most_beside=6)


def _picture(
    color: NDArray[np.float32], view: HeldOutView, box: tuple[slice, slice], caption: str
) -> Picture:
    pixels = np.round(255.0 * np.clip(color, 0.0, 1.0)).astype(np.uint8)
    pixels[~view.mask] = _MAT
    return Picture(np.ascontiguousarray(pixels[box]), caption, caption, is_photograph=True)


def _label_colors(labels: NDArray[np.int32]) -> NDArray[np.float32]:
    """A hue for each photograph; grey for none."""
    from matplotlib.colors import hsv_to_rgb

    most = int(labels.max(initial=-1)) + 1
    numbers = np.arange(most)
    hues = np.stack(
        [(numbers * _GOLDEN) % 1.0, 0.45 + 0.3 * (numbers % 2), 0.75 + 0.2 * (numbers % 3 == 0)], 1
    )
    table = np.vstack([hsv_to_rgb(hues).reshape(-1, 3), [[0.5, 0.5, 0.5]]]).astype(np.float32)
    return np.asarray(table[labels])


def _quality_table(views: Sequence[HeldOutView], foreground: int) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for way, label in WAYS.items():
        told = [view.quality[way] for view in views if way in view.quality]
        if told:
            psnr, ssim, sharp = (
                float(np.mean([getattr(q, name) for q in told]))
                for name in ("psnr", "ssim", "sharpness")
            )
            share = sharp / float(np.mean([view.true_sharpness for view in views]))
            rows.append((label, psnr, ssim, 100.0 * share))
    columns = (
        Column("Against photographs held out", style="wide"),
        Column("PSNR", "dB", 2),
        Column("SSIM", decimals=4),
        Column("Sharpness", "%", 0),
    )
    caption = (
        f"Means over {len(views)} photographs that textured nothing. Sharpness is that of the "
        f"photograph itself where it is 100 %. One mesh has as many triangles as the depth meshes "
        f"have in the foreground, {shown_number(foreground)}, labelled by the same energy."
    )
    return Table(columns, tuple(rows), caption)


def _steps_table(views: Sequence[HeldOutView]) -> Table:
    rows = tuple(
        (view.name, view.before.across, view.after.across, view.after.within) for view in views
    )
    columns = (
        Column("Photograph"),
        Column("Step at borders", "of 255", 2),
        Column("After levelling", "of 255", 2),
        Column("Elsewhere", "of 255", 2),
    )
    caption = (
        "How much colours differ between neighbouring pixels where the photograph changes, before "
        "and after levelling, and elsewhere, which is the paint’s own."
    )
    return Table(columns, rows, caption)


def _scaling_plot(points: Sequence[ScalingPoint]) -> Plot:
    triangles = [point.triangles for point in points]
    series = {
        "depth meshes": (triangles, [point.depth_meshes_s for point in points]),
        "one mesh": (triangles, [point.one_mesh_s for point in points]),
    }
    svg = line_figure(
        "texture-scaling", series, "triangles", "labelled in (s)",
        "Time of labelling many depth meshes and one mesh against their triangles",
    )  # fmt: skip
    data = {
        str(point.size_px): {
            "triangles": point.triangles,
            "depth meshes, s": point.depth_meshes_s,
            "one mesh, s": point.one_mesh_s,
        }
        for point in points
    }
    sizes = ", ".join(str(point.size_px) for point in points)
    return Plot(
        svg,
        f"Candidates, costs and labels with depth maps of {sizes} pixels, on one thread, the "
        "photographs in memory (Arikan et al., fig. 8).",
        data,
    )


def _labels_table(said: Mapping[str, Any]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (label, said[name])
        for label, name in (
            ("energy with the best photograph everywhere", "energy_before"),
            ("energy of the labels", "energy"),
            ("of it above the proven bound, %", "energy_gap"),
            ("photographs that are candidates of a depth mesh", "candidate_photos"),
            ("triangles of depth meshes in the background, %", "overlap"),
            ("candidates, costs and colours of depth meshes, s", "cost_seconds"),
            ("labels of depth meshes, s", "label_seconds"),
            ("photographs loaded for them", "picture_loads"),
            ("labels of the surface, s", "surface_label_seconds"),
            ("atlas of the surface, s", "atlas_seconds"),
            ("step of colour across seams of the atlas, of 255", "seam_step_before"),
            ("the same after seam levelling", "seam_step_after"),
            ("colours moved by seam levelling, of 255", "levelling_moved"),
        )
        if name in said
    ]
    return Table(
        (Column("Labels", style="wide"), Column("Value", decimals=2)),
        tuple(rows),
        "The choice of photographs (Arikan et al., eq. 1) and what it took.",
    )
