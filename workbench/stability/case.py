"""A stiff case: what is run, what must come of it, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

from workbench.errors import WorkbenchError

Outcome = Literal["right within bound", "refused", "WRONG"]


@dataclass(frozen=True)
class Bound:
    """What a value may be at most, and why.

    Attributes
    ----------
    limit : in ``unit``; the value may be as large.
    unit : the empty string for counts and ratios.
    source : where the limit comes from: injected noise, theory or what was published.
    """

    limit: float
    unit: str
    source: str


@dataclass(frozen=True)
class Measured:
    """What a method answered, held against what is known.

    Attributes
    ----------
    value : in the unit of the case's bound; a NaN meets no bound.
    told : what the method itself says of its condition, residual or uncertainty.
    """

    value: float
    told: str = ""

    @classmethod
    def nothing(cls, told: str) -> Measured:
        """An answer that no number can make right."""
        return cls(math.inf, told)


@dataclass(frozen=True)
class Refused:
    """The method gave no answer and said why."""

    reason: str


@dataclass(frozen=True)
class Case:
    """One stiff case of one method.

    A case has a bound, or words that its refusal must hold, or both where either will do.

    Attributes
    ----------
    name : ``domain/what``, unique.
    method : what is tried, as a reader knows it.
    stiff : one sentence: what is stiff or extreme about it.
    run : makes the case, asks the method and measures the answer. A `WorkbenchError` counts
        as a refusal with its message.
    bound : of the measured value; None where only a refusal is right.
    refusal : words of the reason; None where an answer is owed.
    quick : whether it belongs to the quick table.
    """

    name: str
    method: str
    stiff: str
    run: Callable[[], Measured | Refused]
    bound: Bound | None = None
    refusal: str | None = None
    quick: bool = True

    def __post_init__(self) -> None:
        if self.bound is None and self.refusal is None:
            raise ValueError(f"{self.name}: neither a bound nor a refusal is expected")


@dataclass(frozen=True)
class Row:
    """A line of the table: a case and what came of it.

    Attributes
    ----------
    case : that was run.
    outcome : ``WRONG`` for an answer beyond the bound, for an answer where a refusal is owed,
        for a refusal where an answer is, and for a failure that says nothing of its cause.
    value : measured; NaN without an answer.
    reason : why it was refused, or what the method told of itself.
    seconds : of wall time.
    """

    case: Case
    outcome: Outcome
    value: float
    reason: str
    seconds: float

    @property
    def passed(self) -> bool:
        return self.outcome != "WRONG"

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON, which has no NaN: what is not finite is None."""
        bound = self.case.bound
        return {
            "name": self.case.name,
            "method": self.case.method,
            "stiff": self.case.stiff,
            "outcome": self.outcome,
            "passed": self.passed,
            "value": float(self.value) if math.isfinite(self.value) else None,
            "unit": bound.unit if bound else "",
            "bound": bound.limit if bound else None,
            "source": bound.source if bound else "",
            "reason": self.reason,
            "seconds": self.seconds,
        }


def tried(case: Case) -> Row:
    """Run a case and judge what came of it; no exception of the method leaves this function."""
    start = perf_counter()
    try:
        found = case.run()
    except WorkbenchError as error:
        found = Refused(str(error))
    except Exception as error:
        reason = f"failed with {type(error).__name__}: {error}"
        return Row(case, "WRONG", math.nan, reason, perf_counter() - start)
    seconds = perf_counter() - start
    if isinstance(found, Refused):
        owed = case.refusal is not None and case.refusal in found.reason
        reason = " ".join(found.reason.split())
        return Row(case, "refused" if owed else "WRONG", math.nan, reason, seconds)
    right = case.bound is not None and found.value <= case.bound.limit
    return Row(case, "right within bound" if right else "WRONG", found.value, found.told, seconds)
