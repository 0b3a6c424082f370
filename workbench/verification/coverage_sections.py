"""What a report says of how much was seen: by which scan, by photographs, and by none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.render import palette
from workbench.verification.distances import vertex_areas
from workbench.verification.figures import bar_figure, overlap_figure
from workbench.verification.quantities import shown_number, shown_unit
from workbench.verification.report_content import (
    Block,
    Column,
    Paragraph,
    Plot,
    PlotRow,
    Section,
    Table,
)
from workbench.verification.truth import measured_vertices

Overlap = tuple[Sequence[str], ArrayLike]
"""Names, and (n, n) shares of what the row saw that the column saw too."""


@dataclass(frozen=True)
class FilledByPhotographs:
    """What photographs added to scans.

    Attributes
    ----------
    samples, photographs : how many, and of how many.
    vertices : (n,) bool, vertices of the surface whose nearest sample is one of these.
    """

    samples: int
    photographs: int
    vertices: NDArray[np.bool_]


def origins_of(surface: TriangleMesh, filled: FilledByPhotographs | None) -> NDArray[np.uint8]:
    """Who measured each vertex (n,), as in the palette."""
    origins = np.where(measured_vertices(surface), palette.MEASURED, palette.INFILLED)
    if filled is not None:
        origins[filled.vertices & (origins == palette.MEASURED)] = palette.BY_PHOTOGRAPHS
    return origins.astype(np.uint8)


def measured_share(surface: TriangleMesh) -> float:
    """Share of the surface area that was measured, in [0, 1]."""
    areas = vertex_areas(surface)
    total = float(areas.sum())
    return float(areas[measured_vertices(surface)].sum()) / total if total > 0 else float("nan")


def coverage_section(
    surface: TriangleMesh,
    overlap: Overlap | None,
    samples_per_scan: Mapping[str, int] | None,
    of_photographs: bool,
    filled: FilledByPhotographs | None,
) -> Section:
    """What each scan or photograph saw, and the surface by origin."""
    kind = "photograph" if of_photographs else "scan"
    blocks: list[Block] = []
    plots: list[Plot] = []
    missing: list[str] = []
    if samples_per_scan:
        names = list(samples_per_scan)
        counts = [float(samples_per_scan[name]) for name in names]
        svg = bar_figure(
            "samples-per-scan",
            names,
            [("Samples", counts, lambda count: shown_number(int(count)))],
            f"Bars of the number of samples of each {kind}",
        )
        plots.append(Plot(svg, f"Samples each {kind} contributed.", {"samples": samples_per_scan}))
    else:
        missing.append(f"The number of samples of each {kind} was not recorded.")
    if overlap is not None and len(overlap[0]) > 1:
        names, shares = list(overlap[0]), np.asarray(overlap[1], float)
        svg = overlap_figure("overlap", names, shares, "Matrix of the overlap of the scans")
        caption = (
            "Overlap: of each scan (row) the part that another scan (column) saw as well, "
            "in per cent."
        )
        plots.append(Plot(svg, caption, {"scans": names, "overlap": shares}))
    elif samples_per_scan is not None and len(samples_per_scan) == 1:
        missing.append("A single scan has no overlap.")
    elif not of_photographs:
        missing.append("The overlap of the scans was not recorded.")
    if plots:
        blocks.append(PlotRow(tuple(plots)))
    if "provenance" in surface.vertex_attributes:
        areas, origins = vertex_areas(surface), origins_of(surface, filled)
        total = max(float(areas.sum()), float(np.finfo(float).tiny))
        kinds = {palette.MEASURED: "measured", palette.INFILLED: "infilled"}
        if filled is not None:
            kinds = {
                palette.MEASURED: "measured by scans",
                palette.BY_PHOTOGRAPHS: "measured by photographs alone",
                palette.INFILLED: "infilled",
            }
        held = {name: float(areas[origins == kind].sum()) for kind, name in kinds.items()}
        rows = tuple((name, area, 100 * area / total) for name, area in held.items())
        columns = (Column("Surface"), Column("Area", shown_unit("m²")), Column("Share", "%", 2))
        blocks.append(Table(columns, rows, "The surface by origin."))
    if missing:
        blocks.append(Paragraph(" ".join(missing)))
    shared = "" if of_photographs else ", and how much they share"
    return Section("Coverage", f"What each {kind} saw{shared}.", tuple(blocks))
