"""The sections of a report that tell distances: residuals of the scans, comparison with truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.verification.distances import DistanceSummary
from workbench.verification.figures import histogram_figure
from workbench.verification.quantities import length_unit, shown_length
from workbench.verification.report_content import (
    Block,
    Cell,
    Column,
    Paragraph,
    Plot,
    PlotRow,
    Section,
    Table,
)
from workbench.verification.truth import TruthComparison


def fit_section(
    residuals: Mapping[str, ArrayLike],
    samples_per_scan: Mapping[str, int] | None,
    of_photographs: bool = False,
) -> Section:
    """Residuals between scans and between samples and surface, as histograms and a table.

    Parameters
    ----------
    residuals, of_photographs
        as for `scan_report.build_scan_report`.
    samples_per_scan
        scan name → number of samples; tells a single scan from silence.
    """
    plots, rows, missing = [], [], []
    pairs = {
        label: np.asarray(residuals[key], float)
        for key, label in (("before_m", "before"), ("after_m", "after"))
        if key in residuals
    }
    if pairs:
        caption = "Distance between overlapping scans before and after registration."
        plots.append(_residual_plot("registration", pairs, "Distance between scans", caption))
        rows += [(f"Between scans, {label}", DistanceSummary.of(v)) for label, v in pairs.items()]
    elif of_photographs:
        missing.append(
            "Photographs are brought together by their orientation; how well stands in its chapter."
        )
    elif samples_per_scan is not None and len(samples_per_scan) == 1:
        missing.append("There is one scan only, so that there was nothing to align.")
    else:
        missing.append("No registration residuals were recorded.")
    if "samples_to_surface_m" in residuals:
        values = np.asarray(residuals["samples_to_surface_m"], float)
        caption = "Distance of the samples from the finished surface."
        plots.append(
            _residual_plot("samples", {"samples": values}, "Distance to the surface", caption)
        )
        rows.append(("Samples to surface", DistanceSummary.of(values)))
    else:
        missing.append("No distances between samples and surface were recorded.")
    blocks: list[Block] = []
    if plots:
        blocks += [PlotRow(tuple(plots)), summary_table(rows, "")]
    if missing:
        blocks.append(Paragraph(" ".join(missing)))
    intro = "How well the scans agree with each other and with the surface made from them."
    if of_photographs:
        intro = "How well the depth maps agree with the surface made from them."
    return Section("Residuals", intro, tuple(blocks))


def summary_table(rows: Sequence[tuple[str, DistanceSummary]], caption: str) -> Table:
    """Distances side by side in one unit; the unit fits the largest RMS."""
    largest = max((s.rms for _, s in rows if np.isfinite(s.rms)), default=1.0)
    unit = length_unit(largest)
    scale = unit.per_metre
    smallest = min((s.median for _, s in rows if s.median > 0), default=largest) * scale
    decimals = int(np.clip(2 - np.floor(np.log10(smallest)), 0, 6)) if smallest > 0 else 3
    with_bias = any(np.isfinite(summary.bias) for _, summary in rows)
    columns = [Column("Distances"), Column("Number")]
    names = ["RMS", "Mean", "Median", "95 %", "Largest"] + (["Bias"] if with_bias else [])
    columns += [Column(name, unit.symbol, decimals) for name in names]
    cells: list[tuple[Cell, ...]] = []
    for label, s in rows:
        values = [s.rms, s.mean, s.median, s.p95, s.maximum] + ([s.bias] if with_bias else [])
        cells.append((label, s.count, *(scale * value for value in values)))
    return Table(tuple(columns), tuple(cells), caption)


def _residual_plot(
    name: str, series: Mapping[str, NDArray[np.float64]], quantity: str, caption: str
) -> Plot:
    summaries = {label: DistanceSummary.of(values) for label, values in series.items()}
    unit = length_unit(max(summary.median for summary in summaries.values()))
    svg = histogram_figure(
        f"residual-{name}",
        {label: values * unit.per_metre for label, values in series.items()},
        f"{quantity} ({unit.symbol})",
        caption,
    )
    data = {
        label: {"count": s.count, "rms_m": s.rms, "median_m": s.median, "p95_m": s.p95}
        for label, s in summaries.items()
    }
    return Plot(svg, f"{caption} Dashed lines mark the medians.", data)


def truth_section(comparison: TruthComparison | None, reference_name: str) -> Section:
    """Accuracy and completeness against a truth, or the sentence that none is known.

    Parameters
    ----------
    comparison
        the distances, or None.
    reference_name
        what the truth is, in words that follow "the".
    """
    title = "Compared with known truth"
    if comparison is None:
        return Section(
            title,
            "For this object no independent truth is known. The residuals above tell how well "
            "data and surface agree, not how true either is.",
            (),
        )
    rows = [
        ("Measured surface → truth", comparison.accuracy_measured),
        ("Whole surface → truth", comparison.accuracy_all),
        ("Truth → surface", comparison.completeness),
    ]
    unit = length_unit(max(comparison.accuracy_all.median, 1e-9))
    deviation = comparison.deviation_m * unit.per_metre
    series = {"measured": deviation[comparison.deviation_measured]}
    if not comparison.deviation_measured.all():
        series = {"infilled": deviation[~comparison.deviation_measured], **series}
    svg = histogram_figure(
        "truth-deviation",
        series,
        f"Deviation from the {reference_name} ({unit.symbol})",
        "Histogram of the signed deviation from the truth",
        counted="surface",
    )
    thresholds = comparison.within[len(comparison.within) // 2][0]
    threshold_unit = length_unit(thresholds)
    smallest = comparison.within[0][0] * threshold_unit.per_metre
    decimals = max(0, -int(np.floor(np.log10(smallest) + 1e-9)))
    completeness = Table(
        (
            Column("Within", threshold_unit.symbol, decimals),
            Column("Any surface", "%", 2),
            Column("Measured surface", "%", 2),
        ),
        tuple(
            (threshold * threshold_unit.per_metre, 100 * share, 100 * measured)
            for (threshold, share), (_, measured) in zip(
                comparison.within, comparison.within_measured, strict=True
            )
        ),
        "Completeness: share of the true area that has surface this near.",
    )
    hausdorff = shown_length(comparison.hausdorff95_m)
    return Section(
        title,
        f"Distances between the model and the {reference_name}, in one frame. 95 % of either "
        f"surface lies within {hausdorff} of the other.",
        (
            summary_table(rows, "Distances in both directions. Bias is positive outwards."),
            completeness,
            Plot(svg, "Signed deviation of the surface, positive outwards."),
        ),
    )
