"""What a report says of kills and other faults: what was lost, what was wrong, what was told."""

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

_KILLED = (
    Column("Stage", style="code"),
    Column("At any moment"),
    Column("At a write"),
    Column("With workers"),
    Column("Found as"),
    Column("Lost"),
    Column("Wrong"),
)
_FAULTS = (
    Column("Fault", style="wide"),
    Column("Outcome"),
    Column("What people are told", style="wide"),
)


def fault_section(told: Mapping[str, Any]) -> Section:
    """The chapter on a table that ``make faults`` made; plain data, as it is stored."""
    stages: Sequence[Mapping[str, Any]] = told["stages"]
    faults: Sequence[Mapping[str, Any]] = told["faults"]
    blocks: list[Block] = [_cards(told)]
    problems = [f"{row['stage']}: {text}" for row in stages for text in row["problems"]]
    problems += [f"{row['fault']}, {row['done']}: {row['problem']}" for row in _failed(faults)]
    if problems:
        blocks.append(TextList(tuple(problems), "attention"))
    blocks.append(
        Paragraph(
            f"{shown_number(told['kills'])} kills and {shown_number(len(faults))} other faults of "
            f"a small project in which every stage takes part, in {shown_number(told['seconds'])} "
            "s. After each kill, what had been finished must still be there and not be done "
            "again, what is called fresh must have the bytes of an undisturbed run, and the next "
            "run must end with these bytes. The report itself holds dates and times: of its "
            "stage only the files are compared."
        )
    )
    if stages:
        blocks.append(Table(_KILLED, tuple(_stage_row(row) for row in stages), "Killed stages."))
    if faults:
        rows = tuple(_fault_row(row) for row in faults)
        blocks.append(Table(_FAULTS, rows, "Other faults, and what is said of them."))
    intro = (
        "What happens when a run is killed, disks are full, files go away or are damaged: nothing "
        "finished may be lost, nothing wrong may be called fresh, and every message must name "
        "what to do."
    )
    return Section("Faults", intro, tuple(blocks))


def fault_metrics(told: Mapping[str, Any]) -> list[Metric]:
    """How many kills there were, and what was lost or wrong."""
    return [
        Metric("kills", told["kills"], "", "Runs killed by SIGKILL, over all stages."),
        Metric("kills_lost", told["lost"], "", "Finished work that a kill lost.", ("==", 0)),
        Metric("kills_wrong", told["wrong"], "",
               "Products that were called fresh or ended otherwise than undisturbed.", ("==", 0)),
        Metric("faults_failed", told["failed"], "",
               "Other faults that were not refused or mended as they should be.", ("==", 0)),
    ]  # fmt: skip


def _cards(told: Mapping[str, Any]) -> Cards:
    def counted(label: str, count: int, sentence: str) -> Card:
        return Card(label, shown_number(count), sentence, "attention" if count else "good", count)

    return Cards(
        (
            Card("Kills", shown_number(told["kills"]), "Runs killed at random moments.", "plain",
                 told["kills"]),
            counted("Lost", told["lost"], "Finished work that was done again."),
            counted("Wrong", told["wrong"], "Fresh or finished with other bytes."),
            counted("Other faults", told["failed"], "Neither refused with what to do nor mended."),
        )
    )  # fmt: skip


def _failed(faults: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [row for row in faults if not row["passed"]]


def _stage_row(row: Mapping[str, Any]) -> tuple[str | int, ...]:
    found = ", ".join(f"{count} {state}" for state, count in row["found_as"].items())
    counts = (row["moments"], row["writes"], row["workers"])
    return (row["stage"], *counts, found, row["lost"], row["wrong"])


def _fault_row(row: Mapping[str, Any]) -> tuple[str, ...]:
    outcome = "as it should be" if row["passed"] else "NOT as it should be"
    return f"{row['fault']}: {row['done']}", outcome, row["told"]
