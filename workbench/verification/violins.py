"""Distributions side by side as violins."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from workbench.verification.figures import SERIES
from workbench.verification.svg import inline_svg, page_style

_WIDTH, _HEIGHT = 4.5, 3.4
_STEPS = 60
_SPAN = 0.8


def violin_figure(
    name: str,
    series: Mapping[str, Mapping[int, NDArray[np.float64]]],
    y_label: str,
    alt: str,
) -> str:
    """A violin for each series and group, side by side within a group, medians marked.

    Parameters
    ----------
    name, alt
        as for the other figures of a report.
    series
        label → group → (n,) positive values; all have the same groups.
    y_label
        quantity and unit; the axis is logarithmic.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    groups = list(next(iter(series.values()))) if series else []
    width = _SPAN / max(len(series), 1)
    with page_style():
        figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
        axes = figure.add_subplot()
        axes.set_yscale("log")
        for k, (label, values) in enumerate(series.items()):
            color = SERIES[k % len(SERIES)]
            for number, group in enumerate(groups):
                middle = number + (k - 0.5 * (len(series) - 1)) * width
                heights, shares = _outline(values[group])
                half = 0.46 * width * shares
                axes.fill_betweenx(
                    heights, middle - half, middle + half, color=color, alpha=0.55, linewidth=0,
                    label=label if number == 0 else None,
                )  # fmt: skip
                median = float(np.median(values[group]))
                axes.plot(
                    [middle - 0.4 * width, middle + 0.4 * width], [median] * 2,
                    color=color, linewidth=1.6,
                )  # fmt: skip
        axes.set_xticks(range(len(groups)), [f"{group:,}".replace(",", " ") for group in groups])
        axes.set_ylabel(y_label)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid(visible=False, axis="x")
        if series:
            figure.legend(loc="outside upper left", ncols=2)
    return inline_svg(figure, name, alt)


def _outline(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Heights and how many values lie there, the most being 1."""
    logs = np.log(values[values > 0.0])
    if not len(logs):
        return np.ones(1), np.zeros(1)
    if np.ptp(logs) < 1e-9:
        return np.exp(logs[:1]), np.ones(1)
    counts, edges = np.histogram(logs, _STEPS)
    smooth = np.convolve(counts, [0.25, 0.5, 0.25], mode="same")
    return np.exp(0.5 * (edges[1:] + edges[:-1])), smooth / smooth.max()
