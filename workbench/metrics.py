"""A metric: one number with its name, its unit, its meaning and, where there is one, its bound."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

Bound = tuple[str, float]

_COMPARISONS: Final[dict[str, Callable[[float, float], bool]]] = {
    "<=": operator.le,
    "<": operator.lt,
    ">=": operator.ge,
    ">": operator.gt,
    "==": operator.eq,
}


@dataclass(frozen=True)
class Metric:
    """One measured quantity.

    Attributes
    ----------
    name : snake case, unique within a stage.
    value : a number or a truth value, in ``unit``; NaN for "could not be measured".
    unit : ``"m"``, ``"%"``, ``"s"``; the empty string for counts and ratios.
    description : one sentence a reader outside the project understands.
    bound : what the value has to satisfy, e.g. ``("<=", 1e-4)``; None for a plain report.

    Examples
    --------
    >>> Metric("rms", 7e-5, "m", "Distance to the truth.", bound=("<=", 1e-4)).passed
    True
    """

    name: str
    value: float | int | bool
    unit: str
    description: str
    bound: Bound | None = None

    def __post_init__(self) -> None:
        if self.bound is not None and self.bound[0] not in _COMPARISONS:
            known = " ".join(_COMPARISONS)
            raise ValueError(f"{self.name}: unknown comparison {self.bound[0]!r}; one of {known}")

    @property
    def passed(self) -> bool | None:
        """Whether the bound holds (a NaN never does); None without a bound."""
        if self.bound is None:
            return None
        comparison, limit = self.bound
        return bool(_COMPARISONS[comparison](self.value, limit))

    def as_dict(self) -> dict[str, Any]:
        """Plain data for records: JSON has no NaN, so a value that is not finite is None."""
        # Record files hold plain Python: NumPy scalars are turned into what json can write.
        value: float | int | bool | None
        if isinstance(self.value, bool | np.bool_):
            value = bool(self.value)
        elif isinstance(self.value, int | np.integer):
            value = int(self.value)
        else:
            value = float(self.value) if math.isfinite(self.value) else None
        plain: dict[str, Any] = {
            "name": self.name,
            "value": value,
            "unit": self.unit,
            "description": self.description,
        }
        if self.bound is not None:
            plain["bound"] = [self.bound[0], float(self.bound[1])]
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Metric:
        """The metric that `as_dict` wrote."""
        bound = plain.get("bound")
        value = plain["value"]
        return cls(
            plain["name"],
            math.nan if value is None else value,
            plain["unit"],
            plain["description"],
            None if bound is None else (str(bound[0]), float(bound[1])),
        )
