"""Which settings no other beats, and which of them to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

# Errors of one computation agree to the last digits; what differs by less is the same.
_SAME_ERROR = 1e-6
_TINY = 1e-300

How = Literal["error budget", "time budget", "knee"]


@dataclass(frozen=True)
class Candidate:
    """One setting as the choice sees it.

    Attributes
    ----------
    error : less is better; not negative.
    seconds : time, median; positive.
    default : whether it is the setting in force, which wins where nothing speaks against it.
    """

    error: float
    seconds: float
    default: bool = False


@dataclass(frozen=True)
class Budget:
    """What the user is ready to pay; neither is given for the knee.

    Attributes
    ----------
    error : most error, in the unit of the measure.
    seconds : most wall time of the stage.
    """

    error: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Choice:
    """The setting to take: its index, by which rule, and why, in words."""

    index: int
    how: How
    reason: str


@dataclass(frozen=True)
class NoChoice:
    """Why no setting can be recommended; falsy. ``nearest`` is the one that misses least."""

    how: How
    reason: str
    nearest: int | None = None

    def __bool__(self) -> bool:
        return False


def pareto_indices(candidates: Sequence[Candidate]) -> tuple[int, ...]:
    """Indices of the settings that no other beats in both, by rising time.

    Of settings alike in both, all are kept.
    """
    kept = []
    for k, one in enumerate(candidates):
        beaten = any(
            other.error <= one.error
            and other.seconds <= one.seconds
            and (other.error < one.error or other.seconds < one.seconds)
            for other in candidates
        )
        if not beaten:
            kept.append(k)
    return tuple(sorted(kept, key=lambda k: (candidates[k].seconds, k)))


def recommended(
    candidates: Sequence[Candidate], budget: Budget, noise: float = 0.0
) -> Choice | NoChoice:
    """The setting to take.

    * Within an error budget: the cheapest that keeps it. Where a time budget is given too, it
      must be kept as well.
    * Within a time budget: the most accurate that keeps it.
    * Without a budget: the knee, where error × time is least. A step along the front from there
      to a finer setting costs a larger share of time than it takes off the error, and a step to
      a rougher one adds a larger share of error than it saves time.

    Times that differ by less than the noise are the same: of such settings the more accurate is
    taken, and of those alike in that, the default.

    Parameters
    ----------
    candidates : settings with a finite error and time.
    budget : error, time, both or neither.
    noise : relative spread of times, e.g. 0.05.
    """
    how: How = "knee"
    if budget.error is not None:
        how = "error budget"
    elif budget.seconds is not None:
        how = "time budget"
    if not candidates:
        return NoChoice(how, "no setting was measured")
    kept = [k for k, one in enumerate(candidates) if _keeps(one, budget)]
    if not kept:
        return _missed(candidates, budget, how)
    return Choice(*_chosen(candidates, kept, how, noise, budget))


def _keeps(one: Candidate, budget: Budget) -> bool:
    return (budget.error is None or one.error <= budget.error) and (
        budget.seconds is None or one.seconds <= budget.seconds
    )


def _missed(candidates: Sequence[Candidate], budget: Budget, how: How) -> NoChoice:
    """No setting keeps the budget; the nearest, and what it would take."""
    in_time = [k for k, c in enumerate(candidates) if _keeps(c, Budget(seconds=budget.seconds))]
    if budget.error is not None and in_time:
        nearest = min(in_time, key=lambda k: (candidates[k].error, candidates[k].seconds))
        least = candidates[nearest].error
        told = f"no setting tried has an error of at most {budget.error:.4g}; least: {least:.4g}"
        if budget.seconds is not None:
            told += f" within {budget.seconds:.4g} s"
        return NoChoice(how, told, nearest)
    nearest = min(
        range(len(candidates)), key=lambda k: (candidates[k].seconds, candidates[k].error)
    )
    quickest = candidates[nearest].seconds
    return NoChoice(
        how,
        f"no setting tried takes at most {budget.seconds:.4g} s; quickest: {quickest:.4g} s",
        nearest,
    )


def _chosen(
    candidates: Sequence[Candidate], kept: Sequence[int], how: How, noise: float, budget: Budget
) -> tuple[int, How, str]:
    def cost(k: int) -> float:
        one = candidates[k]
        if how == "knee":
            return max(one.error, _TINY) * one.seconds
        return one.seconds

    if how == "time budget":
        least = min(candidates[k].error for k in kept)
        best = [k for k in kept if candidates[k].error <= least * (1.0 + _SAME_ERROR)]
        quickest = min(candidates[k].seconds for k in best)
        alike = [k for k in best if candidates[k].seconds <= quickest * (1.0 + noise)]
        index = min(alike, key=lambda k: (not candidates[k].default, candidates[k].seconds))
        return index, how, f"the most accurate of those that take at most {budget.seconds:.4g} s"
    least = min(cost(k) for k in kept)
    alike = [k for k in kept if cost(k) <= least * (1.0 + noise)]
    least_error = min(candidates[k].error for k in alike)
    best = [k for k in alike if candidates[k].error <= least_error * (1.0 + _SAME_ERROR)]
    index = min(best, key=lambda k: (not candidates[k].default, candidates[k].seconds))
    if how == "error budget":
        told = f"the cheapest of those with an error of at most {budget.error:.4g}"
        if budget.seconds is not None:
            told += f" and a time of at most {budget.seconds:.4g} s"
        return index, how, told
    return index, how, "the knee: " + _knee_in_words(candidates, index)


def _knee_in_words(candidates: Sequence[Candidate], index: int) -> str:
    """What the next finer and the next rougher setting of the front would change."""
    chosen = candidates[index]
    front = [candidates[k] for k in pareto_indices(candidates)]
    finer = [c for c in front if c.error < chosen.error * (1.0 - _SAME_ERROR)]
    rougher = [
        c
        for c in front
        if c.seconds < chosen.seconds and c.error > chosen.error * (1 + _SAME_ERROR)
    ]
    told = []
    if finer:
        next_one = max(finer, key=lambda c: c.error)
        told.append(
            f"the next finer setting takes {_times(next_one.seconds / chosen.seconds)} the time "
            f"for {_times(next_one.error / max(chosen.error, _TINY))} the error"
        )
    if rougher:
        next_one = max(rougher, key=lambda c: c.seconds)
        told.append(
            f"the next rougher one has {_times(next_one.error / max(chosen.error, _TINY))} the "
            f"error for {_times(next_one.seconds / chosen.seconds)} the time"
        )
    if not told:
        return "no other setting has less error or takes less time"
    return "; ".join(told)


def _times(factor: float) -> str:
    return f"{factor:.2f} ×"


def relative_spread(values: Sequence[float]) -> float:
    """Median absolute deviation over the median; 0 for fewer than two values."""
    if len(values) < 2:
        return 0.0
    middle = float(np.median(values))
    return float(np.median(np.abs(np.asarray(values) - middle))) / middle if middle > 0 else 0.0
