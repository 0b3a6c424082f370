"""What a report says of surfels: how even they lie, what prefixes are worth, what they cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.metrics import Metric
from workbench.verification.figures import TradeoffPoint, tradeoff_figure
from workbench.verification.quantities import shown_length, shown_number, shown_unit
from workbench.verification.report_content import Block, Column, Paragraph, Plot, Section, Table
from workbench.verification.surfel_errors import ChoiceFigures, PrefixFigures
from workbench.verification.violins import violin_figure

# What orders are called in a report, in the order they are shown.
_ORDERS = {
    "random": "random",
    "progressive": "rounds of the paper",
    "exact": "exact",
    "both sides": "exact, sides apart",
}


@dataclass(frozen=True)
class ExportedSurfels:
    """What there is to say of the surfels of an export.

    Attributes
    ----------
    file_bytes, surfels, nodes, levels : of the file.
    median_distance : of the whole object's surfels to their nearest, metres.
    prefixes : of the whole object's, short to long.
    choices : resolutions of candidates, coarse to fine.
    spacing : order → prefix → distances to the nearest, relative to the object's diagonal.
    """

    file_bytes: int
    surfels: int
    nodes: int
    levels: int
    median_distance: float
    prefixes: Sequence[PrefixFigures]
    choices: Sequence[ChoiceFigures]
    spacing: Mapping[str, Mapping[int, NDArray[np.float64]]]


def surfel_section(told: ExportedSurfels) -> Section:
    """The chapter on the surfels of an export."""
    text = (
        f"{shown_number(told.surfels)} surfels in {shown_number(told.nodes)} "
        f"{'node' if told.nodes == 1 else 'nodes'} of {shown_number(told.levels)} "
        f"{'level' if told.levels == 1 else 'levels'}, {shown_number(told.file_bytes / 1e6)} MB in "
        "the file. Any prefix of a node's surfels covers its part of the surface evenly, so that "
        "a viewer draws as many as its picture needs. Those of the whole object are "
        f"{shown_length(told.median_distance)} apart in the median."
    )
    blocks: list[Block] = [Paragraph(text)]
    if told.prefixes:
        blocks += [_prefix_table(told.prefixes), _prefix_plot(told.prefixes)]
    if told.spacing:
        blocks += [_spacing_plot(told.spacing), _spacing_table(told.spacing)]
    if told.choices:
        blocks += [_choice_table(told.choices), _choice_plot(told.choices)]
    intro = "The surface as discs, coarse to fine, for viewers that draw it point by point."
    return Section("Surfels", intro, tuple(blocks))


def surfel_metrics(told: ExportedSurfels) -> list[Metric]:
    """Likeness and holes of prefixes."""
    return [
        metric
        for row in told.prefixes
        for metric in (
            Metric(f"surfel_ssim_{row.count}", row.similarity, "",
                   f"SSIM of {row.count} surfels to the surface at the size they are meant for."),
            Metric(f"surfel_holes_{row.count}", 100.0 * row.holes, "%",
                   f"The surface's pixels that show none of {row.count} surfels."),
        )
    ]  # fmt: skip


def _prefix_table(rows: Sequence[PrefixFigures]) -> Table:
    columns = (
        Column("Surfels"),
        Column("Size", "kB", 1),
        Column("Radius", shown_unit("mm"), 3),
        Column("Picture", "px"),
        Column("SSIM", decimals=3),
        Column("Holes", "%", 3),
        Column("Drawn in", "ms", 1),
    )
    cells = tuple(
        (
            row.count, row.kilobytes, 1e3 * row.radius, row.picture_px, row.similarity,
            100.0 * row.holes, 1e3 * row.drawn_s,
        )
        for row in rows
    )  # fmt: skip
    caption = (
        "Prefixes of the whole object's surfels (Brandt et al. 2019, 4.1), each in a picture in "
        "which a disc that covers the object is two pixels wide, held against the surface "
        "itself under the same light."
    )
    return Table(columns, cells, caption)


def _prefix_plot(rows: Sequence[PrefixFigures]) -> Plot:
    points = [TradeoffPoint(str(row.count), 1e3 * row.drawn_s, 1e3 * row.radius) for row in rows]
    svg = tradeoff_figure(
        points, "drawn in (ms)", f"radius of discs ({shown_unit('mm')})", points[-1].name,
        name="surfel-prefixes", alt="Radius of discs against the time to draw them",
    )  # fmt: skip
    data = {row.name: {"milliseconds": row.x, "radius_mm": row.y} for row in points}
    return Plot(svg, "How fine a prefix is against the processor time to draw it.", data)


def _spacing_plot(spacing: Mapping[str, Mapping[int, NDArray[np.float64]]]) -> Plot:
    shown = {
        _ORDERS[name]: {prefix: 100.0 * values for prefix, values in spacing[name].items()}
        for name in _ORDERS
        if name in spacing
    }
    svg = violin_figure(
        "surfel-spacing", shown, "distance to the nearest (% of the diagonal)",
        "Distributions of distances between neighbouring surfels for each order and prefix",
    )  # fmt: skip
    data = {
        name: {str(prefix): float(np.median(values)) for prefix, values in prefixes.items()}
        for name, prefixes in shown.items()
    }
    caption = (
        "How far surfels are from their nearest, for the first 1000, 5000 and 10 000 of several "
        "orders (Brandt et al. 2019, fig. 3); the file has the last one. Even surfels have narrow "
        "shapes."
    )
    return Plot(svg, caption, data)


def _spacing_table(spacing: Mapping[str, Mapping[int, NDArray[np.float64]]]) -> Table:
    exact = spacing["exact"]
    rows = []
    for name, label in _ORDERS.items():
        if name not in spacing:
            continue
        for prefix, values in spacing[name].items():
            rows.append(
                (
                    label,
                    prefix,
                    float(np.median(values) / np.median(exact[prefix])),
                    float(values.min() / exact[prefix].min()),
                )
            )
    columns = (
        Column("Order"),
        Column("Surfels"),
        Column("Median", "of exact", 3),
        Column("Smallest", "of exact", 3),
    )
    caption = (
        "Distances to the nearest, relative to those of the exact greedy order. With sides apart, "
        "the two sides of a thin wall have surfels of their own, which lie close to each other."
    )
    return Table(columns, tuple(rows), caption)


def _choice_table(rows: Sequence[ChoiceFigures]) -> Table:
    columns = (
        Column("Pictures", "px"),
        Column("Candidates"),
        Column("Chosen in", "s", 2),
        Column("Farthest place", "of finest", 3),
    )
    cells = tuple((row.resolution_px, row.candidates, row.seconds, row.gap_share) for row in rows)
    caption = (
        "What finer pictures to choose from cost and buy: how far the surface is from the surfels "
        "at most, relative to the finest."
    )
    return Table(columns, cells, caption)


def _choice_plot(rows: Sequence[ChoiceFigures]) -> Plot:
    points = [TradeoffPoint(f"{row.resolution_px} px", row.seconds, row.gap_share) for row in rows]
    svg = tradeoff_figure(
        points, "chosen in (s)", "farthest place (of finest)", points[-1].name,
        name="surfel-candidates", alt="Evenness of surfels against the time to choose them",
    )  # fmt: skip
    data = {row.name: {"seconds": row.x, "farthest": row.y} for row in points}
    return Plot(svg, "How well surfels cover the surface against the time to choose them.", data)
