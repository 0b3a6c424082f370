"""What a report says of stiff and extreme cases: the table, one part for every domain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from workbench.metrics import Metric
from workbench.verification.quantities import shown_number
from workbench.verification.report_content import (
    Block,
    Card,
    Cards,
    Column,
    Paragraph,
    Section,
    Table,
    TextList,
)

_WRONG = "WRONG"
_NAMES = {
    "registration": "Scans in one frame",
    "pose graph": "Loops of scans",
    "surface": "Closed surfaces",
    "color": "Colour and flash",
    "texture": "Photographs on triangles",
    "voxels": "Voxels",
    "cameras": "Cameras",
    "points": "Points, clouds and surfels",
    "masks": "Masks",
    "numbers": "Numbers that are none",
}
_COLUMNS = (
    Column("Case"),
    Column("What is stiff about it", style="wide"),
    Column("Outcome"),
    Column("Value"),
    Column("Bound"),
    Column("Where the bound is from, or why it was refused", style="wide"),
    Column("What the method says", style="wide"),
)


def stability_section(told: Mapping[str, Any]) -> Section:
    """The chapter on a table that ``workbench stability`` made; plain data, as it is stored."""
    cases: Sequence[Mapping[str, Any]] = told["cases"]
    wrong = [case for case in cases if not case["passed"]]
    blocks: list[Block] = [_cards(told)]
    if wrong:
        blocks.append(
            TextList(tuple(f"{case['name']}: {_wrong(case)}" for case in wrong), "attention")
        )
    which = "the quick ones of the table" if told["quick"] else "the whole table"
    blocks.append(
        Paragraph(
            f"{shown_number(len(cases))} cases, {which}, in {shown_number(told['seconds'])} s on "
            "one thread. A value may be as large as its bound; where no number can be right, the "
            "method has to refuse and say why."
        )
    )
    domains = dict.fromkeys(case["name"].partition("/")[0] for case in cases)
    for domain in domains:
        rows = tuple(_row(case) for case in cases if case["name"].partition("/")[0] == domain)
        blocks.append(Table(_COLUMNS, rows, f"{_NAMES.get(domain, domain.capitalize())}."))
    intro = (
        "Every method on input that is made to break it. An answer must lie within a bound that "
        "is known beforehand, or the method must refuse with a reason; a wrong answer without a "
        "word is the one failure."
    )
    return Section("Stability", intro, tuple(blocks))


def stability_metrics(told: Mapping[str, Any]) -> list[Metric]:
    """How many cases were right, refused and wrong."""
    return [
        Metric("stability_right", told["right"], "", "Stiff cases answered within their bounds."),
        Metric("stability_refused", told["refused"], "", "Stiff cases refused with a reason."),
        Metric("stability_wrong", told["wrong"], "",
               "Stiff cases with a wrong answer, or refused without need.", ("==", 0)),
    ]  # fmt: skip


def _cards(told: Mapping[str, Any]) -> Cards:
    wrong = told["wrong"]
    return Cards(
        (
            Card("Right", shown_number(told["right"]), "Answers within their bounds.", "good",
                 told["right"]),
            Card("Refused", shown_number(told["refused"]), "No answer, and the reason why.",
                 "plain", told["refused"]),
            Card("Wrong", shown_number(wrong), "Answers beyond their bounds.",
                 "attention" if wrong else "good", wrong),
        )
    )  # fmt: skip


def _wrong(case: Mapping[str, Any]) -> str:
    if case["value"] is None:
        return str(case["reason"])
    return f"{case['value']:.3g} {case['unit']}, {case['bound']:.3g} at most; {case['reason']}"


def _row(case: Mapping[str, Any]) -> tuple[str | float | None, ...]:
    bound = "" if case["bound"] is None else f"{_short(case['bound'])} {case['unit']}".strip()
    refused = case["outcome"] == "refused"
    return (
        case["name"].partition("/")[2],
        case["stiff"],
        case["outcome"],
        "" if case["value"] is None else _short(case["value"]),
        "" if refused else bound,
        case["reason"] if refused else case["source"],
        "" if refused else case["reason"],
    )


def _short(value: float) -> str:
    return f"{value:.2g}".replace("-", "−")
