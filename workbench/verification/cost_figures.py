"""Error against several costs at once; returns an ``<svg>`` element as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from workbench.verification.figures import BEFORE, SERIES, pareto_front, plain_ticks
from workbench.verification.svg import inline_svg, page_style

_SIZE = (9.0, 2.9)


def cost_figure(
    name: str,
    errors: Sequence[float],
    costs: Mapping[str, ArrayLike],
    error_label: str,
    alt: str,
    *,
    default: int | None = None,
    recommended: int | None = None,
) -> str:
    """A panel for each cost, one numbered dot per setting, with the front no other beats there.

    Parameters
    ----------
    name, alt
        as in `workbench.verification.figures`.
    errors
        (n,) of the settings; less is better.
    costs
        label with unit → (n,) values; less is better. An axis is logarithmic when its values
        are positive and span more than a factor 10.
    error_label
        quantity and unit.
    default, recommended
        indices of the setting in force, drawn as a ring, and of the one to take, a star.
    """
    from matplotlib.figure import Figure

    y = np.asarray(errors, float)
    with page_style():
        figure = Figure(figsize=_SIZE, layout="constrained")
        panels = figure.subplots(1, len(costs), sharey=True, squeeze=False)[0]
        for axes, (label, values) in zip(panels, costs.items(), strict=True):
            x = np.asarray(values, float)
            front = pareto_front(x, y)
            axes.plot(x[front], y[front], drawstyle="steps-post", color=SERIES[0], linewidth=1.3)
            beaten = np.setdiff1d(np.arange(len(y)), front)
            axes.scatter(x[beaten], y[beaten], s=22, color=BEFORE)
            axes.scatter(x[front], y[front], s=26, color=SERIES[0])
            for index, marker, size, color in (
                (default, "o", 120, SERIES[1]), (recommended, "*", 330, SERIES[2]),
            ):  # fmt: skip
                if index is not None:
                    axes.scatter(x[index], y[index], s=size, marker=marker, facecolors="none",
                                 edgecolors=color, linewidths=1.5)  # fmt: skip
            for number, place in enumerate(zip(x, y, strict=True), 1):
                axes.annotate(str(number), place, xytext=(7, 6), textcoords="offset points",
                              fontsize=8.5)  # fmt: skip
            for one, set_scale, axis in (
                (x, axes.set_xscale, axes.xaxis), (y, axes.set_yscale, axes.yaxis),
            ):  # fmt: skip
                if one.min() > 0 and one.max() > 10 * one.min():
                    set_scale("log")
                    axis.set_major_formatter(plain_ticks())
            axes.margins(0.18)
            axes.set_xlabel(label)
        panels[0].set_ylabel(error_label)
    return inline_svg(figure, name, alt)
