"""What a report says of voxels: how small a graph is, and how good each level of detail is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.formats.gltf import srgb_from_linear
from workbench.metrics import Metric
from workbench.render.palette import background
from workbench.verification.figures import TradeoffPoint, tradeoff_figure
from workbench.verification.quantities import shown_length, shown_number
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
)
from workbench.voxels.graph_export import EncodingFigures
from workbench.voxels.published_encodings import PUBLISHED, PUBLISHED_LEVELS
from workbench.voxels.voxel_set import VoxelGrid


@dataclass(frozen=True)
class LevelFigures:
    """One level of detail.

    Attributes
    ----------
    level : of 2**level voxels a side.
    voxels, chunks : how many.
    megabytes : of its chunks, as stored.
    seconds : to make a file whose finest level it is.
    error : mean difference of pictures from those of the surface, of 255.
    """

    level: int
    voxels: int
    chunks: int
    megabytes: float
    seconds: float
    error: float


@dataclass(frozen=True)
class ExportedVoxels:
    """What there is to say of the voxels of an export.

    Attributes
    ----------
    grid : the cube they are cells of, in metres.
    voxels : how many, of the finest level.
    file_bytes : of the file.
    encoding : of a graph; empty for levels of detail.
    encodings : of a graph, what each encoding makes of it; none where that was left out.
    levels : of a file of levels, coarse to fine.
    geometry_bytes : of the file, the surface itself for close-ups.
    pictures : name → (h, w, 4) uint8 traced picture, sRGB with alpha.
    """

    grid: VoxelGrid
    voxels: int
    file_bytes: int
    encoding: str
    encodings: Sequence[EncodingFigures]
    levels: Sequence[LevelFigures]
    geometry_bytes: int
    pictures: Mapping[str, NDArray[np.uint8]]


def voxel_section(told: ExportedVoxels) -> Section:
    """The chapter on the voxels of an export."""
    kind = f"a sparse voxel graph ({told.encoding})" if told.encoding else "levels of detail"
    text = (
        f"The surface is exported as {kind}: {shown_number(told.voxels)} voxels of "
        f"{shown_length(told.grid.voxel_size)} in a cube of {told.grid.resolution} a "
        f"side, {shown_number(told.file_bytes / 1e6)} MB in the file. "
    )
    if told.encoding:
        text += "Every voxel was decoded again and compared before the file was kept."
    elif told.geometry_bytes:
        text += (
            f"{shown_number(told.geometry_bytes / 1e6)} MB of that are the surface itself, for "
            "close-ups."
        )
    blocks: list[Block] = [Paragraph(text), _pictures(told)]
    if told.encodings:
        blocks.append(_encodings_table(told))
    if told.levels:
        blocks.append(_levels_table(told.levels))
    if len(told.levels) > 1:
        blocks += _levels_plots(told.levels)
    intro = "The surface as voxels, for viewers that draw large models piece by piece."
    return Section("Voxels", intro, tuple(blocks))


def voxel_metrics(told: ExportedVoxels) -> list[Metric]:
    """Bits of each encoding and errors of levels."""
    return [
        *(
            Metric(f"voxel_bits_{row.encoding}", row.bits_per_voxel, "bits",
                   f"Size of the graph for each voxel, encoded as {row.encoding}.")
            for row in told.encodings
        ),
        *(
            Metric(f"voxel_error_{1 << row.level}", row.error, "of 255",
                   f"Pictures of {1 << row.level}³ voxels against those of the surface.")
            for row in told.levels
        ),
        *(
            Metric(f"voxel_seconds_{1 << row.level}", row.seconds, "s",
                   f"To cut the surface into {1 << row.level}³ voxels and all coarser ones.")
            for row in told.levels
        ),
    ]  # fmt: skip


def _pictures(told: ExportedVoxels) -> PictureRow:
    pictures = []
    for name, picture in told.pictures.items():
        alpha = picture[..., 3:].astype(np.float32) / np.float32(255.0)
        behind = srgb_from_linear(background(*alpha.shape[:2]))
        mixed = picture[..., :3] * alpha + behind * (np.float32(1.0) - alpha)
        pixels = np.ascontiguousarray(np.rint(mixed).astype(np.uint8))
        pictures.append(Picture(pixels, name, f"The voxels, {name.lower()}", True))
    caption = (
        "Traced voxel by voxel with hard shadows; a cell smaller than a pixel is not looked into."
    )
    return PictureRow(tuple(pictures), caption)


def _encodings_table(told: ExportedVoxels) -> Table:
    level = max(told.grid.level, PUBLISHED_LEVELS[0])
    rows: list[tuple[Cell, ...]] = [
        (
            f"{row.encoding} (in the file)" if row.encoding == told.encoding else row.encoding,
            row.nodes,
            row.bytes / 1e6,
            row.bits_per_voxel,
            100.0 * row.share_of_svdag,
            *(model.bits_per_voxel(row.encoding, level) for model in PUBLISHED),
        )
        for row in told.encodings
    ]
    columns = (
        Column("Encoding"),
        Column("Nodes"),
        Column("Size", "MB", 3),
        Column("Per voxel", "bits", 3),
        Column("Of svdag", "%", 1),
        *(Column(model.name, "bits", 3) for model in PUBLISHED),
    )
    caption = (
        "All encodings of these voxels, without colours, beside what the paper took for two "
        f"scanned statues at {1 << level}³ (Jaspe 2018, tables 5.1 and 5.4). Finer voxels take "
        "fewer bits each; it does not tell of osvdag."
    )
    return Table(columns, tuple(rows), caption)


def _levels_table(levels: Sequence[LevelFigures]) -> Table:
    columns = (
        Column("Voxels a side"),
        Column("Voxels"),
        Column("Chunks"),
        Column("Size", "MB", 2),
        Column("Made in", "s", 2),
        Column("Picture error", "of 255", 2),
    )
    rows = tuple(
        (1 << row.level, row.voxels, row.chunks, row.megabytes, row.seconds, row.error)
        for row in levels
    )
    caption = (
        "Levels of detail in the file. The error is the mean difference of shaded pictures along "
        "the axes, 512 pixels a side, from those of the surface itself; the time is that of a "
        "file with this level as its finest, on one thread."
    )
    return Table(columns, rows, caption)


def _levels_plots(levels: Sequence[LevelFigures]) -> list[Plot]:
    """Error against bytes, and against the time a level takes to make."""
    plots = []
    for key, unit, name, what in (
        ("megabytes", "voxels of the level (MB)", "voxel-levels", "its bytes"),
        ("seconds", "made in (s)", "voxel-times", "the time to make it"),
    ):
        points = [
            TradeoffPoint(str(1 << row.level), getattr(row, key), row.error) for row in levels
        ]
        svg = tradeoff_figure(
            points, unit, "picture error (of 255)", points[-1].name,
            name=name, alt=f"Error of pictures of each level against {what}",
        )  # fmt: skip
        data = {row.name: {key: row.x, "error": row.y} for row in points}
        caption = f"How near a level is against {what}; the finest one is ringed."
        plots.append(Plot(svg, caption, data))
    return plots
