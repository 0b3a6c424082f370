"""The table of kills and faults: for people, and as plain data for the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tests.faults.fault import Fault
from tests.faults.kills import Tally


def document(tallies: Sequence[Tally], faults: Sequence[Fault], seconds: float) -> dict[str, Any]:
    """What a project stores as ``fault_table``."""
    return {
        "seconds": round(seconds, 1),
        "kills": sum(tally.kills for tally in tallies),
        "lost": sum(tally.lost for tally in tallies),
        "wrong": sum(tally.wrong for tally in tallies),
        "failed": sum(not fault.passed for fault in faults),
        "stages": [
            {
                "stage": tally.stage,
                "moments": tally.moments,
                "writes": tally.writes,
                "workers": tally.workers,
                "resumed": tally.resumed,
                "found_as": dict(sorted(tally.found_as.items())),
                "lost": tally.lost,
                "wrong": tally.wrong,
                "problems": list(tally.problems),
            }
            for tally in tallies
        ],
        "faults": [
            {
                "fault": fault.name,
                "done": fault.done,
                "expected": fault.expected,
                "told": fault.told,
                "passed": fault.passed,
                "problem": fault.problem,
            }
            for fault in faults
        ],
    }


def shown_tally(tally: Tally) -> str:
    """One line for people, and one for every problem."""
    found = ", ".join(f"{count} {state}" for state, count in sorted(tally.found_as.items()))
    line = (
        f"{tally.stage:<9} killed {tally.moments} times at any moment, {tally.writes} at a write, "
        f"{tally.workers} with workers ({found}): {tally.lost} lost, {tally.wrong} wrong"
    )
    return "\n  ".join([line, *tally.problems])


def shown_fault(fault: Fault) -> str:
    """One line for people, and what was wrong."""
    line = f"{'ok    ' if fault.passed else 'FAILED'} {fault.name}: {fault.done} — {fault.told}"
    return line if fault.passed else f"{line}\n  {fault.problem}"
