"""What a report says of the page in the browser: what each form of the model costs and shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from workbench.metrics import Metric
from workbench.verification.figures import line_figure
from workbench.verification.quantities import shown_number
from workbench.verification.report_content import (
    Block,
    Column,
    Paragraph,
    Plot,
    PlotRow,
    Section,
    Table,
    TextList,
)

_MB = 1e-6
_ON_PROCESSOR = ("swiftshader", "llvmpipe", "softpipe")
_LEAST_ERROR = 1e-4


def page_section(told: Mapping[str, Any]) -> Section:
    """The chapter on what ``workbench publish --measure`` stored; plain data, as it is stored."""
    forms: Sequence[Mapping[str, Any]] = told["forms"]
    blocks: list[Block] = [Paragraph(_in_words(told))]
    problems = [f"{form['label']}: {line}" for form in forms for line in form["told"]]
    budget = told["budget_bytes"]
    problems += [
        f"{form['label']}: {shown_number(_MB * form['end_card_bytes'], 3)} MB on the card at the "
        f"end of the path, more than the {shown_number(_MB * budget, 3)} MB allowed."
        for form in forms
        if form["end_card_bytes"] > budget
    ]
    if problems:
        blocks.append(TextList(tuple(problems), tone="attention"))
    blocks += [_loading_table(forms), _path_table(forms), _likeness_table(forms)]
    blocks.append(PlotRow((_plot_of_frames(forms), _plot_of_bytes(forms))))
    with_errors = [form for form in forms if form["errors"]]
    if with_errors:
        blocks.append(_plot_of_errors(with_errors))
    return Section(
        "In the browser",
        "Every form of the model in the page, opened in a browser: how soon it shows, what it "
        "reads and holds, and how near its pictures are to rays cast at the surface itself.",
        tuple(blocks),
    )


def page_metrics(told: Mapping[str, Any]) -> list[Metric]:
    """The most telling number of every form."""
    metrics = []
    for form in told["forms"]:
        mode, label = form["mode"], form["label"].lower()
        metrics += [
            Metric(f"page_{mode}_first_bytes", form["first_bytes"], "bytes",
                   f"Read to the first picture of the {label}."),
            Metric(f"page_{mode}_full_bytes", form["full_bytes"], "bytes",
                   f"Read to the whole first view of the {label}."),
            Metric(f"page_{mode}_frame", _median(form["path"], "frame_ms"), "ms",
                   f"To draw a picture of the {label} along the path, median."),
            Metric(f"page_{mode}_agreement", min(row["headless"] for row in form["compared"]), "",
                   f"Similarity of the {label} in the page and without one, least."),
        ]  # fmt: skip
    return metrics


def _in_words(told: Mapping[str, Any]) -> str:
    steps = len(told["forms"][0]["path"])
    card = str(told["card"])
    by = (
        "the processor"
        if any(word in card.lower() for word in _ON_PROCESSOR)
        else "a graphics card"
    )
    return (
        f"{told['width']} × {told['height']} pixels, drawn by {by} ({card}). The path goes once "
        f"around the object and nearer, to a third of the distance, in {shown_number(steps)} steps "
        f"of at most {shown_number(told['patience_s'], 2)} s each; what has not come by then is "
        f"shown coarser. At most {shown_number(_MB * told['budget_bytes'], 3)} MB are held on the "
        "card. Times hold within this table: they are those of one machine with whatever else ran."
    )


def _loading_table(forms: Sequence[Mapping[str, Any]]) -> Table:
    columns = (
        Column("Form"),
        Column("File", "MB", 1),
        Column("First picture", "s", 2),
        Column("Read", "MB", 2),
        Column("Whole view", "s", 1),
        Column("Read", "MB", 2),
        Column("Path", "MB", 2),
        Column("Requests", decimals=0),
    )
    rows = tuple(
        (
            form["label"],
            _MB * form["file_bytes"],
            form["first_s"],
            _MB * form["first_bytes"],
            form["full_s"],
            _MB * form["full_bytes"],
            _MB * form["path"][-1]["read_bytes"],
            form["path"][-1]["requests"],
        )
        for form in forms
    )
    return Table(
        columns,
        rows,
        "Loading, from a server that hands out parts of files: time to the first picture and until "
        "the first view is whole, with what was read by then, and over the whole path.",
    )


def _path_table(forms: Sequence[Mapping[str, Any]]) -> Table:
    columns = (
        Column("Form"),
        Column("Frame", "ms", 0),
        Column("Slowest", "ms", 0),
        Column("Calls", decimals=0),
        Column("Items", decimals=0),
        Column("Card", "MB", 1),
        Column("At the end", "MB", 1),
        Column("Given up", "MB", 1),
    )
    rows = tuple(
        (
            form["label"],
            _median(form["path"], "frame_ms"),
            max(row["frame_ms"] for row in form["path"]),
            _median(form["path"], "calls"),
            _median(form["path"], "items"),
            _MB * max(row["card_bytes"] for row in form["path"]),
            _MB * form["end_card_bytes"],
            _MB * (form["path"][-1]["uploaded_bytes"] - form["path"][-1]["card_bytes"]),
        )
        for form in forms
    )
    return Table(
        columns, rows,
        "Along the path: medians of frames, the slowest, and bytes on the card, most and at the "
        "end. Items are triangles, faces of voxels, discs or points drawn. The voxel graph is "
        "traced in strips, over as many frames as it takes.",
    )  # fmt: skip


def _likeness_table(forms: Sequence[Mapping[str, Any]]) -> Table:
    views = len(forms[0]["compared"])
    places = ("far", *("between",) * (views - 2), "near")
    columns = (
        Column("Form"),
        *(Column(f"Twin, {place}", decimals=3) for place in places),
        *(Column(f"Rays, {place}", decimals=3) for place in places),
    )
    rows = tuple(
        (
            form["label"],
            *(row["headless"] for row in form["compared"]),
            *(row["rays"] for row in form["compared"]),
        )
        for form in forms
    )
    return Table(
        columns, rows,
        "Structural similarity of the page's pictures to those of their twins, the same form drawn "
        "without a browser, and to rays cast at the surface: the textured one for photographs, "
        "else that with colours at its corners. Voxels and points end at the detail that was "
        "published.",
    )  # fmt: skip


def _plot_of_frames(forms: Sequence[Mapping[str, Any]]) -> Plot:
    return _along_path(
        forms, "frame_ms", 1.0, "Frame (ms)", "page-frames",
        "Time to draw each step's first picture.",
    )  # fmt: skip


def _plot_of_bytes(forms: Sequence[Mapping[str, Any]]) -> Plot:
    return _along_path(
        forms, "card_bytes", _MB, "On the card (MB)", "page-bytes",
        "Bytes held on the card at each step.",
    )  # fmt: skip


def _along_path(
    forms: Sequence[Mapping[str, Any]], key: str, unit: float, label: str, name: str, caption: str
) -> Plot:
    series = {
        form["label"]: (
            1.0 + np.arange(len(form["path"])),
            [unit * max(row[key], 1e-3) for row in form["path"]],
        )
        for form in forms
    }
    alt = f"{label} along the path, for each form of the model."
    return Plot(
        line_figure(name, series, "Step of the path", label, alt, steps=True),
        caption,
        {form: list(values) for form, (_, values) in series.items()},
    )


def _plot_of_errors(forms: Sequence[Mapping[str, Any]]) -> Plot:
    series = {
        form["label"]: (
            [row["frame_ms"] for row in form["errors"]],
            [max(row["error"], _LEAST_ERROR) for row in form["errors"]],
        )
        for form in forms
    }
    allowed = ", ".join(f"{row['pixel_error']:g}" for row in forms[0]["errors"])
    return Plot(
        line_figure(
            "page-errors", series, "Frame (ms)", "1 − similarity to rays",
            "Error against the time of a frame, for each form with levels of detail.",
        ),
        f"Error against time at the first place of the path, with errors of {allowed} pixels "
        "allowed.",
        {form["label"]: [dict(row) for row in form["errors"]] for form in forms},
    )  # fmt: skip


def _median(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(np.median([row[key] for row in rows]))
