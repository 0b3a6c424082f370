"""What a report says of sweeps: what settings cost and buy, and which to take."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from workbench.metrics import Metric
from workbench.verification.cost_figures import cost_figure
from workbench.verification.quantities import shown_unit
from workbench.verification.report_content import (
    Block,
    Cell,
    Column,
    Paragraph,
    Plot,
    Section,
    Table,
    TextList,
)

_GIB = 1.0 / 2**30
_MILLIMETRES = ("m", "mm", 1e3)
_COSTS = (
    ("wall_s", "Wall time (s)", 1.0),
    ("cpu_s", "CPU time (s)", 1.0),
    ("peak_rss_bytes", "Peak memory (GiB)", _GIB),
)


def sweep_section(told: Mapping[str, Any]) -> Section:
    """The chapter on what ``workbench sweep`` stored; plain data, as it is stored."""
    points: Sequence[Mapping[str, Any]] = told["points"]
    blocks: list[Block] = [
        Paragraph(
            "Each setting ran in a process of its own, all else as in this project. The ring is "
            "the setting in force, the star the one to take; the line joins those that no other "
            "beats in both. Without a "
            "budget of time, advice goes by the time of the processor, which other work on the "
            "machine moves least. " + told["noise"]["told"]
        )
    ]
    if told["left_out"]:
        lines = (f"{name}: left out, {reason}" for name, reason in told["left_out"].items())
        blocks.append(TextList(tuple(lines)))
    for choice in told["recommended"]:
        own = [p for p in points if _group(p) == _group(choice)]
        blocks += _blocks(choice, own)
    return Section(
        "What settings cost and buy",
        "Error against run time and memory for the knobs of every stage that has some, and which "
        "setting to take.",
        tuple(blocks),
    )


def sweep_metrics(told: Mapping[str, Any]) -> list[Metric]:
    """How many settings were tried, and how many stages run at a setting worth keeping."""
    points = told["points"]
    kept = [p for p in points if p["default"] and p["pareto"]]
    groups = {_group(p) for p in points}
    return [
        Metric("sweep_settings", len(points), "", "Settings tried."),
        Metric("sweep_on_front", len(kept), "",
               f"Settings in force, of {len(groups)}, that no other beats in time and error."),
    ]  # fmt: skip


def _group(told: Mapping[str, Any]) -> tuple[str, str]:
    return told["stage"], told["measure"]


def _title(choice: Mapping[str, Any]) -> str:
    stage, measure = _group(choice)
    return stage if stage == measure else f"{stage}: {measure}"


def _blocks(choice: Mapping[str, Any], points: Sequence[Mapping[str, Any]]) -> list[Block]:
    measured = [point for point in points if point["error"] is not None]
    title = _title(choice)
    if not measured:
        reason = next((point["reason"] for point in points if point["reason"]), "nothing was tried")
        return [Paragraph(f"{title[0].upper() + title[1:]}: no error could be measured: {reason}.")]
    unit, factor = _unit(measured)
    blocks: list[Block] = []
    if len(measured) > 1:
        blocks.append(_plot(title, measured, unit, factor))
    blocks.append(
        _table(points, unit, factor, f"{title[0].upper() + title[1:]}. {_advice(choice)}")
    )
    return blocks


def _unit(points: Sequence[Mapping[str, Any]]) -> tuple[str, float]:
    """The unit errors are shown in, and what turns theirs into it."""
    own = str(points[0]["error_unit"])
    metres, millimetres, factor = _MILLIMETRES
    if own == metres and max(point["error"] for point in points) < 0.1:
        return shown_unit(millimetres), factor
    return shown_unit(own), 1.0


def _plot(title: str, points: Sequence[Mapping[str, Any]], unit: str, factor: float) -> Plot:
    """Numbers of the settings are those of the table's rows."""
    errors = [factor * point["error"] for point in points]
    costs = {label: [scale * point[key] for point in points] for key, label, scale in _COSTS}
    svg = cost_figure(
        "sweep-" + "".join(c if c.isalnum() else "-" for c in title),
        errors,
        costs,
        f"Error ({unit})",
        f"Error of {title} against wall time, processor time and memory for each setting tried.",
        default=_index(points, "default"),
        recommended=_index(points, "recommended"),
    )
    told = points[0]["told"]
    return Plot(svg, f"{title}: {told}.", {f"Error ({unit})": errors} | costs, is_wide=True)


def _index(points: Sequence[Mapping[str, Any]], mark: str) -> int | None:
    return next((k for k, point in enumerate(points) if point[mark]), None)


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _table(points: Sequence[Mapping[str, Any]], unit: str, factor: float, caption: str) -> Table:
    knobs = list(points[0]["knobs"])
    over_seeds = any("seeds" in point for point in points)
    columns = [
        Column("", decimals=0),
        *(Column(name, style="code") for name in knobs),
        Column("Error", unit),
        *((Column("over seeds", unit), Column("±", unit)) if over_seeds else ()),
        Column("Wall", "s"),
        Column("CPU", "s"),
        Column("Peak", "GiB", 2),
        Column("", style="wide"),
    ]
    rows: list[tuple[Cell, ...]] = []
    for number, point in enumerate(points, 1):
        seeds = point.get("seeds", {})
        spread = [_scaled(seeds.get(key), factor) for key in ("error_mean", "error_std")]
        rows.append(
            (
                number,
                *(_value(point["knobs"][name]) for name in knobs),
                _scaled(point["error"], factor),
                *(spread if over_seeds else ()),
                point["wall_s"],
                point["cpu_s"],
                _GIB * point["peak_rss_bytes"],
                _marks(point),
            )
        )
    return Table(tuple(columns), tuple(rows), caption)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None or not math.isfinite(value) else factor * value


def _marks(point: Mapping[str, Any]) -> str:
    marks = [
        word
        for key, word in (("default", "as it is"), ("recommended", "recommended"))
        if point[key]
    ]
    if not point["pareto"] and point["error"] is not None:
        marks.append("another has less error in less time")
    if point["error"] is None:
        marks.append(str(point["reason"]).splitlines()[0] if point["reason"] else "not measured")
    return ", ".join(marks)


def _advice(choice: Mapping[str, Any]) -> str:
    if choice["knobs"] is None:
        return f"Nothing to recommend: {choice['reason']}."
    turned = ", ".join(f"{name} {_value(value)}" for name, value in choice["knobs"].items())
    text = f"Recommended: {turned}; {choice['reason']}."
    checked = choice.get("checked", ())
    held = [check for check in checked if check["holds"]]
    if checked:
        text += f" It holds on {len(held)} of {len(checked)} other seeds"
        broken = [f"seed {c['seed']}: {c['told']}" for c in checked if not c["holds"]]
        text += f" ({'; '.join(broken)})." if broken else "."
    return text
