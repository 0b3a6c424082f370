"""One fault, what a run told of it, and whether all was as it should be."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.faults.kills import Reference
from tests.faults.snapshot import NOT_REPEATED, product_hashes, states
from tests.faults.warm import start


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Attributes
    ----------
    name : the kind of fault.
    done : what was done to the project.
    expected : what should come of it.
    told : what people were told.
    problem : what was not as it should be; empty where all was.
    """

    name: str
    done: str
    expected: str
    told: str
    problem: str = ""

    @property
    def passed(self) -> bool:
        """Whether all was as it should be."""
        return not self.problem


@dataclass(frozen=True)
class Place:
    """A finished project, and a folder to break copies of it in; ``quick`` for a few stages."""

    reference: Reference
    scratch: Path
    quick: bool = False


def outcome(
    place: Place, arguments: Sequence[str], before: Callable[[], None] | None = None
) -> tuple[int | None, str]:
    """Exit code and what was told of a run of ``workbench``."""
    run = start([*arguments, "--json"], place.scratch / "log", before)
    code = run.wait()
    run.kill()
    return code, run.told


def refused(
    place: Place, arguments: Sequence[str], before: Callable[[], None] | None = None
) -> tuple[str, str]:
    """What a run that must be refused says in one line, and what is missing in it."""
    scratch = place.scratch
    code, told = outcome(place, arguments, before)
    error = {}
    for line in told.splitlines():
        if line.startswith('{"error"'):
            error = json.loads(line)["error"]
    if not error:
        return told.strip()[-200:], f"no refusal, but {code}: {told[-600:]}"
    parts = [error["message"]]
    parts += [f"{key}: {error[key]}" for key in ("file", "found", "fix") if key in error]
    said = "; ".join(parts).replace(str(scratch), "…")
    if code != 2:
        return said, f"exit code {code}, not 2: {told[-900:]}"
    return said, "" if error.get("fix") else "it does not say what to do"


def differences(place: Place, project: Path, stages: Sequence[str]) -> str:
    """What of some stages' products is other than in the finished project, in words."""
    for name in stages:
        told, now = place.reference.products[name], product_hashes(project, [name])
        if name in NOT_REPEATED:
            told, now = dict.fromkeys(told, ""), dict.fromkeys(now, "")
        other = sorted(path for path in {*told, *now} if told.get(path) != now.get(path))
        if other:
            return f"{name}: other bytes in {', '.join(other[:5])}"
    return ""


def wrongly_fresh(place: Place, project: Path) -> str:
    """Stages that are called fresh and are not as in the finished project, in words."""
    fresh = [name for name, (state, _) in states(project).items() if state == "fresh"]
    return differences(place, project, fresh)
