"""The figures of reports; each function returns an ``<svg>`` element as text.

``name`` is unique within a page (letters, digits, ``-``), ``alt`` says in a sentence what
the figure shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.render.palette import ColorScale
from workbench.verification.quantities import shown_number
from workbench.verification.svg import INK, inline_svg, page_style

# Readable on light and dark paper, and apart from each other for colour-blind readers.
SERIES = ("#2f7f79", "#c8791a", "#5a74a8", "#a3557a", "#7d8a3c", "#55524c", "#6bb0d4")
BEFORE = "#a79f91"
_WIDTH = 4.5  # inches; 324 SVG units, so that text stays legible on a phone
_LONGEST_LABEL = 22


@dataclass(frozen=True)
class TradeoffPoint:
    """One setting tried: its name and what it cost in both directions (less is better)."""

    name: str
    x: float
    y: float


def histogram_figure(
    name: str,
    series: Mapping[str, ArrayLike],
    x_label: str,
    alt: str,
    *,
    counted: str = "samples",
) -> str:
    """Overlaid histograms of one quantity, with the median of each series.

    Parameters
    ----------
    name, alt
        see the module.
    series
        label → (n,) values in the unit of ``x_label``; values that are not finite are
        left out. Two series read as before and after. The axis becomes logarithmic when
        medians of positive series lie more than a factor 8 apart.
    x_label
        quantity and unit.
    counted
        what one value stands for, in the plural.
    """
    from matplotlib.figure import Figure

    kept = {label: _finite(values) for label, values in series.items()}
    kept = {label: values for label, values in kept.items() if len(values)}
    edges, logarithmic = _bin_edges(list(kept.values()))
    colors = (BEFORE, SERIES[0]) if len(kept) == 2 else SERIES
    with page_style():
        legend_rows = (len(kept) + 1) // 2
        figure = Figure(figsize=(_WIDTH, 2.8 + 0.22 * legend_rows), layout="constrained")
        axes = figure.add_subplot()
        if logarithmic:
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(plain_ticks())
        for k, (label, values) in enumerate(kept.items()):
            color = colors[k % len(colors)]
            share = 100 * np.histogram(values, edges)[0] / len(values)
            median = float(np.median(values))
            axes.stairs(share, edges, fill=True, color=color, alpha=0.35)
            axes.stairs(
                share,
                edges,
                color=color,
                linewidth=1.4,
                label=f"{_short(label)}: median {shown_number(median, 3)}",
            )
            axes.axvline(median, color=color, linewidth=1.2, linestyle=(0, (4, 2)))
        axes.set_xlim(edges[0], edges[-1])
        axes.set_ylim(bottom=0)
        axes.set_xlabel(x_label)
        axes.set_ylabel(f"Share of {counted} (%)")
        axes.grid(visible=False, axis="x")
        if kept:
            figure.legend(loc="outside upper left", ncols=2)
    return inline_svg(figure, name, alt)


def bar_figure(
    name: str,
    labels: Sequence[str],
    panels: Sequence[tuple[str, ArrayLike, Callable[[float], str]]],
    alt: str,
) -> str:
    """Horizontal bars, one row per label and one panel per quantity, each bar with its value.

    Parameters
    ----------
    name, alt
        see the module.
    labels
        one per row, first on top.
    panels
        (title with unit, (n,) values or NaN, how a value is written at its bar).
    """
    from matplotlib.figure import Figure

    rows = np.arange(len(labels))
    with page_style():
        height = 0.62 + 0.27 * max(len(labels), 2)
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for k, (axes, (title, values, shown)) in enumerate(zip(all_axes, panels, strict=True)):
            numbers = np.asarray(values, float)
            lengths = np.nan_to_num(numbers)
            axes.barh(rows, lengths, height=0.62, color=SERIES[k % len(SERIES)], alpha=0.8)
            longest = float(lengths.max(initial=0)) or 1.0
            for row, number in zip(rows, numbers, strict=True):
                if np.isfinite(number):
                    axes.text(
                        max(number, 0) + 0.02 * longest,
                        row,
                        shown(float(number)),
                        va="center",
                        fontsize=8.5,
                    )
            axes.set_xlim(0, 1.38 * longest)
            axes.set_title(title, color=INK)
            axes.set_yticks(rows, [_short(label) for label in labels])
            axes.set_ylim(len(labels) - 0.4, -0.6)
            axes.tick_params(axis="y", length=0)
            axes.tick_params(axis="x", bottom=False, labelbottom=False)
            axes.spines["bottom"].set_visible(False)
            axes.grid(visible=False)
    return inline_svg(figure, name, alt)


def overlap_figure(name: str, names: Sequence[str], overlap: ArrayLike, alt: str) -> str:
    """Heat map of how much of each scan (row) is also seen by each other scan (column).

    Parameters
    ----------
    name, alt
        see the module.
    names
        n scan names.
    overlap
        (n, n) shares in [0, 1]; the diagonal is not drawn.
    """
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

    shares = np.array(overlap, float)
    np.fill_diagonal(shares, np.nan)
    n = len(names)
    colormap = LinearSegmentedColormap.from_list(
        "verdigris", ["#eef1ec", "#2f7f79", "#123c3c"], N=64
    )
    with page_style():
        side = min(4.6, 1.5 + 0.36 * n)
        figure = Figure(figsize=(_WIDTH, side), layout="constrained")
        axes = figure.add_subplot()
        # Cells as shapes: an embedded picture would blur where a page enlarges it.
        mesh = axes.pcolormesh(shares, cmap=colormap, vmin=0, vmax=1, edgecolors="face")
        if n <= 12:
            for row, column in np.ndindex(n, n):
                if row != column and np.isfinite(shares[row, column]):
                    axes.text(
                        column + 0.5,
                        row + 0.5,
                        f"{100 * shares[row, column]:.0f}",
                        ha="center",
                        va="center",
                        fontsize=8.5,
                        color="#fdfcfa" if shares[row, column] > 0.33 else "#1b1a17",
                    )
        shown = [_short(label, 14) for label in names]
        axes.set_xticks(np.arange(n) + 0.5, shown, rotation=40, ha="right")
        axes.set_yticks(np.arange(n) + 0.5, shown)
        axes.set_aspect("equal")
        axes.invert_yaxis()
        axes.tick_params(length=0)
        axes.grid(visible=False)
        axes.spines[["left", "bottom"]].set_visible(False)
        bar = figure.colorbar(mesh, ax=axes, shrink=0.8, ticks=[0, 0.25, 0.5, 0.75, 1])
        bar.ax.set_yticklabels(["0", "25", "50", "75", "100"])
        bar.set_label("Overlap (% of the row's scan)")
        if bar.solids is not None:  # Matplotlib would embed a picture.
            bar.solids.set_rasterized(False)
            bar.solids.set_edgecolor("face")
        bar.outline.set_visible(False)
    return inline_svg(figure, name, alt)


def tradeoff_figure(
    points: Sequence[TradeoffPoint],
    x_label: str,
    y_label: str,
    default_name: str,
    *,
    name: str = "tradeoff",
    alt: str = "",
) -> str:
    """Error against cost, one dot per setting, with the front no other setting beats.

    Parameters
    ----------
    points
        settings tried; less is better in x and y. An axis is logarithmic when its
        values are positive and span more than a factor 10.
    x_label, y_label
        quantity and unit.
    default_name
        the setting used by default, drawn as a ring.
    name, alt
        see the module.
    """
    from matplotlib.figure import Figure

    x = np.array([point.x for point in points], float)
    y = np.array([point.y for point in points], float)
    front = pareto_front(x, y)
    with page_style():
        figure = Figure(figsize=(_WIDTH, 3.5), layout="constrained")
        axes = figure.add_subplot()
        for values, set_scale, axis in (
            (x, axes.set_xscale, axes.xaxis),
            (y, axes.set_yscale, axes.yaxis),
        ):
            if len(values) and values.min() > 0 and values.max() > 10 * values.min():
                set_scale("log")
                axis.set_major_formatter(plain_ticks())
        axes.plot(
            x[front],
            y[front],
            drawstyle="steps-post",
            color=SERIES[0],
            linewidth=1.3,
            label="not beaten in both",
        )
        beaten = np.setdiff1d(np.arange(len(points)), front)
        axes.scatter(x[beaten], y[beaten], s=22, color=BEFORE, label="beaten")
        axes.scatter(x[front], y[front], s=26, color=SERIES[0])
        chosen = [k for k, point in enumerate(points) if point.name == default_name]
        if chosen:
            axes.scatter(
                x[chosen],
                y[chosen],
                s=110,
                facecolors="none",
                edgecolors=SERIES[1],
                linewidths=1.8,
                label=f"default: {_short(default_name)}",
            )
        for k in sorted({*front.tolist(), *chosen}):
            axes.annotate(
                _short(points[k].name),
                (x[k], y[k]),
                xytext=(6, 7),
                textcoords="offset points",
                fontsize=8.5,
            )
        axes.margins(0.16)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        figure.legend(loc="outside upper left", ncols=3)
    return inline_svg(figure, name, alt or f"{y_label} against {x_label} of {len(points)} settings")


def line_figure(
    name: str,
    series: Mapping[str, tuple[ArrayLike, ArrayLike]],
    x_label: str,
    y_label: str,
    alt: str,
    *,
    steps: bool = False,
) -> str:
    """A line per series over one quantity, axes logarithmic.

    Parameters
    ----------
    name, alt
        see the module.
    series
        label → ((n,) values > 0 of the quantity, (n,) values > 0).
    x_label, y_label
        quantity and unit.
    steps
        whether the quantity counts steps: its axis is linear then, and no step has a dot.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    with page_style():
        figure = Figure(figsize=(_WIDTH, 3.3), layout="constrained")
        axes = figure.add_subplot()
        for k, (label, (x, y)) in enumerate(series.items()):
            color = SERIES[k % len(SERIES)]
            marker = "" if steps else "o"
            axes.plot(np.asarray(x), np.asarray(y), marker=marker, markersize=4, color=color,
                      linewidth=1.4, label=_short(label))  # fmt: skip
        axes.set_yscale("log")
        if not steps:
            axes.set_xscale("log")
        for axis in (axes.yaxis,) if steps else (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(plain_ticks())
            # Within a decade the small ticks would be labelled, in mathematics.
            axis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        if series:
            figure.legend(loc="outside upper left", ncols=2)
    return inline_svg(figure, name, alt)


def pareto_front(x: ArrayLike, y: ArrayLike) -> NDArray[np.intp]:
    """Indices, by rising x, of the points no other point beats in both (less is better)."""
    xs, ys = np.asarray(x, float), np.asarray(y, float)
    front: list[int] = []
    for k in np.lexsort((ys, xs)):
        if not front or ys[k] < ys[front[-1]]:
            front.append(int(k))
    return np.array(front, np.intp)


def color_bar_figure(name: str, scale: ColorScale, alt: str) -> str:
    """The legend of a colour scale, horizontal."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    steps = 96
    edges = np.linspace(scale.low, scale.high, steps + 1)
    with page_style():
        figure = Figure(figsize=(_WIDTH, 0.62), layout="constrained")
        axes = figure.add_subplot()
        axes.pcolormesh(
            edges,
            [0, 1],
            0.5 * (edges[None, 1:] + edges[None, :-1]),
            cmap=colormaps[scale.colormap],
            vmin=scale.low,
            vmax=scale.high,
            edgecolors="face",
        )
        axes.set_yticks([])
        axes.spines[:].set_visible(False)
        axes.grid(visible=False)
        axes.set_xlabel(scale.label)
        axes.set_xticks(np.linspace(scale.low, scale.high, 5))
        axes.xaxis.set_major_formatter(plain_ticks())
    return inline_svg(figure, name, alt)


def _finite(values: ArrayLike) -> NDArray[np.float64]:
    numbers = np.asarray(values, float).ravel()
    return np.asarray(numbers[np.isfinite(numbers)], np.float64)


def _bin_edges(series: Sequence[NDArray[np.float64]]) -> tuple[NDArray[np.float64], bool]:
    """Bins that hold all but the longest tails, and whether they grow geometrically."""
    if not series:
        return np.linspace(0, 1, 2), False
    low = min(float(np.percentile(values, 0.5)) for values in series)
    high = max(float(np.percentile(values, 99)) for values in series)
    if low < 0:
        reach = max(-low, high) or 1.0
        return np.linspace(-reach, reach, 61), False
    medians = [float(np.median(values)) for values in series]
    if min(medians) > 0 and max(medians) > 8 * min(medians):
        start = max(low, 0.02 * min(medians))
        return np.geomspace(start, 1.5 * high, 61), True
    return np.linspace(0, high or 1.0, 51), False


def plain_ticks() -> Any:
    """How ticks are written: plainly, with a true minus."""
    from matplotlib.ticker import FuncFormatter

    return FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−"))


def _short(label: str, longest: int = _LONGEST_LABEL) -> str:
    return label if len(label) <= longest else f"{label[: longest - 1]}…"
