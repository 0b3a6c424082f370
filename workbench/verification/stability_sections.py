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

_NAMES = {
    "registration": "Scans in one frame",
    "pose graph": "Loops of scans",
    "surface": "Closed surfaces",
    "color": "Colour and flash",
    "calibration": "Charts and targets",
    "texture": "Photographs on triangles",
    "voxels": "Voxels",
    "cameras": "Cameras",
    "points": "Points, clouds and surfels",
    "masks": "Masks",
    "numbers": "Numbers that are none",
}
_COLUMNS = (
    Column("Case, and what is stiff about it", style="wide"),
    Column("Outcome"),
    Column("Value, and bound"),
    Column("Where the bound is from, and what the method says", style="wide"),
)
# Cases of numbers that are none, which make a table of their own: a column for each.
_NUMBERS, _BROKEN = "numbers", ("NaN", "infinite", "denormal")
_LONGEST_REASON = 160


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
    for domain in dict.fromkeys(_domain(case) for case in cases):
        of_domain = [case for case in cases if _domain(case) == domain]
        caption = f"{_NAMES.get(domain, domain.capitalize())}."
        if domain == _NUMBERS:
            blocks.append(_numbers_table(of_domain, caption))
        else:
            blocks.append(Table(_COLUMNS, tuple(_row(case) for case in of_domain), caption))
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


def _domain(case: Mapping[str, Any]) -> str:
    return str(case["name"]).partition("/")[0]


def _row(case: Mapping[str, Any]) -> tuple[str, ...]:
    refused = case["outcome"] == "refused"
    said = [case["reason"]] if refused else [case["source"], case["reason"]]
    return (
        f"{case['name'].partition('/')[2]}: {case['stiff']}",
        _outcome(case),
        "" if case["value"] is None else _compared(case),
        _shortened("; ".join(part for part in said if part)),
    )


def _numbers_table(cases: Sequence[Mapping[str, Any]], caption: str) -> Table:
    """One row for every input of a method, one column for every number it was broken with."""
    outcomes: dict[str, dict[str, str]] = {}
    for case in cases:
        given, _, number = case["name"].partition("/")[2].rpartition(", ")
        outcomes.setdefault(given, {})[number] = _outcome(case)
    columns = (Column("Method and what of its input", style="wide"), *map(Column, _BROKEN))
    rows = tuple((given, *(found.get(n, "") for n in _BROKEN)) for given, found in outcomes.items())
    return Table(
        columns,
        rows,
        f"{caption} One number of the input is exchanged: NaN and infinity are refused, or passed "
        "over where that is what the method is for; a number next to 0 does as well as 0.",
    )


def _outcome(case: Mapping[str, Any]) -> str:
    return "right" if case["outcome"] == "right within bound" else str(case["outcome"])


def _compared(case: Mapping[str, Any]) -> str:
    if case["bound"] is None:
        return _short(case["value"])
    sign = "≤" if case["value"] <= case["bound"] else ">"
    return f"{_short(case['value'])} {sign} {_short(case['bound'])} {case['unit']}".strip()


def _shortened(text: str) -> str:
    if len(text) <= _LONGEST_REASON:
        return text
    return text[:_LONGEST_REASON].rpartition(" ")[0] + " …"


def _short(value: float) -> str:
    return f"{value:.2g}".replace("-", "−")
