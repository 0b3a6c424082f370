"""The sections of a report that stage records alone can tell: run, settings, inputs, metrics."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.metrics import Metric
from workbench.verification.figures import bar_figure
from workbench.verification.quantities import shown_bytes, shown_duration, shown_unit
from workbench.verification.report_content import (
    Block,
    Cell,
    Column,
    Paragraph,
    Plot,
    Section,
    StageMetric,
    Table,
    TextList,
)

Record = Mapping[str, Any]
LEFT_OUT = "left out"


def stage_metrics(records: Sequence[Record]) -> tuple[StageMetric, ...]:
    """All metrics the stages measured, in their order."""
    return tuple(
        StageMetric(record["stage"], _in_shown_unit(Metric.from_dict(metric)))
        for record in records
        for metric in record.get("metrics", ())
    )


def _in_shown_unit(metric: Metric) -> Metric:
    return replace(metric, unit=shown_unit(metric.unit))


def run_section(records: Sequence[Record]) -> Section:
    """What ran, how long, with how much memory; what was left out and why."""
    # A record without a state is of the stage under way: the one that writes the report.
    ran = [record for record in records if record.get("state", LEFT_OUT) != LEFT_OUT]
    left_out = [record for record in records if record.get("state") == LEFT_OUT]
    blocks: list[Block] = []
    if ran:
        blocks.append(_cost_plot(ran))
        blocks.append(
            Table(
                (
                    Column("Stage"),
                    Column("State"),
                    Column("Time", "s", 1),
                    Column("CPU time", "s", 1),
                    Column("Peak memory", "MB", 0),
                    Column("Why it ran", style="wide"),
                ),
                tuple(
                    (
                        record["stage"],
                        record["state"],
                        record.get("seconds"),
                        record.get("cpu_seconds"),
                        _megabytes(record.get("peak_rss_bytes")),
                        record.get("reason", ""),
                    )
                    for record in ran
                ),
                "Stages in the order of the run.",
            )
        )
    if left_out:
        blocks.append(
            Table(
                (Column("Left out"), Column("Because", style="wide")),
                tuple((record["stage"], record.get("reason", "")) for record in left_out),
                "Stages this project did not need.",
            )
        )
    elif ran:
        blocks.append(Paragraph("No stage was left out."))
    return Section("The run", _run_intro(ran), tuple(blocks))


def warnings_section(records: Sequence[Record]) -> Section:
    """Every warning of every stage; says so when there is none."""
    items = tuple(
        f"{record['stage']}: {warning}"
        for record in records
        for warning in record.get("warnings", ())
    )
    if not items:
        return Section("Warnings", "No stage had anything to warn of.", ())
    count = "One warning" if len(items) == 1 else f"{len(items)} warnings"
    return Section(
        "Warnings",
        f"{count} to read before the model is used.",
        (TextList(items, tone="attention"),),
    )


def metrics_section(metrics: Sequence[StageMetric]) -> Section:
    """All metrics with their bounds."""
    if not metrics:
        return Section("All measurements", "The stages recorded no measurement.", ())
    table = Table(
        (
            Column("Stage"),
            Column("Measurement", style="code"),
            Column("Value"),
            Column("Unit"),
            Column("Bound"),
            Column("Meaning", style="wide"),
        ),
        tuple(
            (
                entry.stage,
                entry.metric.name,
                entry.metric.value,
                entry.metric.unit,
                _bound_text(entry.metric),
                entry.metric.description,
            )
            for entry in metrics
        ),
    )
    bounded = [entry.metric for entry in metrics if entry.metric.bound is not None]
    missed = [metric.name for metric in bounded if not metric.passed]
    intro = "Every number the stages measured, in the unit it was measured in."
    if bounded and not missed:
        intro += f" All {len(bounded)} that have a bound keep it."
    elif missed:
        intro += f" Beyond their bound: {', '.join(missed)}."
    return Section("All measurements", intro, (table,))


def settings_section(records: Sequence[Record]) -> Section:
    """The effective settings of every stage that ran."""
    rows: list[tuple[Cell, ...]] = [
        (record["stage"], option, _option_text(value))
        for record in records
        for option, value in _flat(record.get("options", {}))
    ]
    if not rows:
        return Section("Settings", "The stages that ran have no settings.", ())
    table = Table(
        (Column("Stage"), Column("Option", style="code"), Column("Value", style="code")),
        tuple(rows),
    )
    return Section("Settings", "The settings in effect, defaults included.", (table,))


def inputs_section(records: Sequence[Record]) -> Section:
    """Inputs no stage made, results, libraries and machines; with content hashes."""
    made = {entry["hash"] for record in records for entry in record.get("outputs", ())}
    inputs: dict[tuple[str, str], tuple[Cell, ...]] = {}
    outputs: dict[tuple[str, str], tuple[Cell, ...]] = {}
    for record in records:
        for entry in record.get("inputs", ()):
            if entry["hash"] not in made:
                inputs.setdefault((entry["path"], entry["hash"]), _file_row(entry))
        for entry in record.get("outputs", ()):
            outputs.setdefault((entry["path"], entry["hash"]), _file_row(entry))
    columns = (
        Column("File", style="code"),
        Column("Size"),
        Column("Content hash", style="code"),
    )
    blocks: list[Block] = []
    if inputs:
        blocks.append(Table(columns, tuple(inputs.values()), "Inputs, as they were given."))
    if outputs:
        blocks.append(Table(columns, tuple(outputs.values()), "Results, stage by stage."))
    libraries = sorted(
        {
            (name, version)
            for record in records
            for name, version in record.get("libraries", {}).items()
        }
    )
    if libraries:
        blocks.append(Table((Column("Library"), Column("Version")), tuple(libraries)))
    machines = sorted({_machine(record["host"]) for record in records if record.get("host")})
    if machines:
        blocks.append(Paragraph("Computed on " + "; and on ".join(machines) + "."))
    intro = (
        "A content hash is a fingerprint of a file: the same hash means the same bytes. "
        "provenance.json tells the same history in the W3C PROV form."
    )
    return Section("Files and software", intro, tuple(blocks))


def _cost_plot(ran: Sequence[Record]) -> Plot:
    names = [record["stage"] for record in ran]
    seconds = [_number(record, "seconds") for record in ran]
    memory = [_number(record, "peak_rss_bytes") for record in ran]
    svg = bar_figure(
        "stage-cost",
        names,
        [("Time", seconds, shown_duration), ("Peak memory", memory, shown_bytes)],
        "Bars of run time and peak memory for each stage",
    )
    return Plot(
        svg,
        "Wall time and peak memory of each stage.",
        {"stage": names, "seconds": seconds, "peak_rss_bytes": memory},
    )


def _run_intro(ran: Sequence[Record]) -> str:
    if not ran:
        return "No stage has run."
    total = float(np.nansum([_number(record, "seconds") for record in ran]))
    peak = float(np.nanmax([0.0, *(_number(record, "peak_rss_bytes") for record in ran)]))
    stages = "one stage" if len(ran) == 1 else f"{len(ran)} stages"
    unfinished = [record["stage"] for record in ran if record["state"] != "done"]
    text = f"The work of {stages} took {shown_duration(total)}"
    text += f" and at most {shown_bytes(peak)} of memory." if peak else "."
    if unfinished:
        text += f" Not finished: {', '.join(unfinished)}."
    return text


def _number(record: Record, key: str) -> float:
    """A number of a record; NaN where an interrupted stage left none."""
    value = record.get(key)
    return float("nan") if value is None else float(value)


def _megabytes(count: float | None) -> float | None:
    return None if count is None else count / 1e6


def _bound_text(metric: Metric) -> str:
    if metric.bound is None:
        return ""
    sign = {"<=": "≤", ">=": "≥", "==": "="}.get(metric.bound[0], metric.bound[0])
    return f"{sign} {metric.bound[1]:g} {'✓' if metric.passed else '✗'}"


def _file_row(entry: Mapping[str, Any]) -> tuple[Cell, ...]:
    return entry["path"], shown_bytes(float(entry["bytes"])), entry["hash"]


def _machine(host: Mapping[str, Any]) -> str:
    """A host in words: the processor, the cores, then whatever else was recorded."""
    special: dict[str, Callable[[Any], str]] = {
        "cpu": str,
        "system": str,
        "cores": lambda cores: f"{cores} cores" if cores != 1 else "1 core",
        "memory_bytes": lambda count: f"{shown_bytes(float(count))} of memory",
    }
    words = [shown(host[key]) for key, shown in special.items() if key in host]
    words += [f"{key} {value}" for key, value in host.items() if key not in special]
    return ", ".join(words)


def _flat(options: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Nested options as dotted names."""
    pairs: list[tuple[str, Any]] = []
    for name, value in options.items():
        if isinstance(value, Mapping) and value:
            pairs += _flat(value, f"{prefix}{name}.")
        else:
            pairs.append((f"{prefix}{name}", value))
    return pairs


def _option_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
