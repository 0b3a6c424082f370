"""What of a stage trades error for time, and how wrong its products are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from workbench.errors import SettingsError
from workbench.project.settings import merged, options_for

if TYPE_CHECKING:
    from workbench.pipeline.stage import Products
    from workbench.project.project import Scene


@dataclass(frozen=True)
class Knob:
    """An option that trades error for time, memory or space, and the values worth trying.

    Attributes
    ----------
    option : dotted name within the stage's options.
    values : what a sweep tries, from rough to fine.
    quick : the few of them that a quick sweep tries; all where it is None.
    fixed : options of the stage that hold while this one is swept, so that only what it
        decides is made and timed.
    measure : name of the error measure; the stage's own name where nothing is said.
    """

    option: str
    values: tuple[Any, ...]
    quick: tuple[Any, ...] | None = None
    fixed: Mapping[str, Any] = field(default_factory=dict)
    measure: str = ""

    def check(self, stage: str, model: type[BaseModel]) -> None:
        """Raise ValueError where the stage's options do not allow what is declared."""
        if not self.values or not set(self.quick or ()) <= set(self.values):
            raise ValueError(f"stage {stage}: {self.option} has no values, or other quick ones")
        for value in self.values:
            try:
                table = merged([self.fixed, nested(self.option, value)])
                options_for(stage, model, {stage: table})
            except SettingsError as error:
                raise ValueError(f"stage {stage}: {self.option}={value!r}: {error}") from error


@dataclass(frozen=True)
class MeasuredError:
    """How wrong a stage's products are.

    Attributes
    ----------
    value : less is better, in ``unit``.
    told : what was measured against what, for people.
    """

    value: float
    unit: str
    told: str


@dataclass(frozen=True)
class NotMeasured:
    """Why an error could not be measured; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class ErrorMeasure:
    """How wrong the products of a stage are: against the truth, else against what was left out.

    Attributes
    ----------
    of : given products to read and the scene.
    leaves_out_scan : without a truth, the stage and those before it work without one scan, whose
        pose ``scan_poses`` then has under ``held_out`` instead of ``scans``.
    """

    of: Callable[[Products, Scene], MeasuredError | NotMeasured]
    leaves_out_scan: bool = False


def nested(option: str, value: Any) -> dict[str, Any]:
    """A dotted option as nested tables.

    Examples
    --------
    >>> nested("window.rows", 3)
    {'window': {'rows': 3}}
    """
    for name in reversed(option.split(".")):
        value = {name: value}
    return dict(value)
