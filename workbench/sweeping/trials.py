"""What a sweep tries: every knob in turn about the settings in force, or all combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from workbench.errors import InputError, SettingsError
from workbench.pipeline.knobs import Knob, nested
from workbench.pipeline.planner import Pipeline
from workbench.pipeline.stage import Stage
from workbench.project.settings import (
    StageOptions,
    StageSettings,
    merged,
    options_for,
    parse_assignment,
    suggestion,
)

GivenKnobs = Mapping[str, Mapping[str, tuple[Any, ...]]]


@dataclass(frozen=True)
class Trial:
    """One setting of one stage.

    Attributes
    ----------
    stage, measure : the stage, and by which measure its error is told.
    knobs : option → value of every option swept with this measure.
    table : the options that differ from the settings in force.
    options : all options, checked.
    default : whether the knobs stand as the settings in force have them.
    """

    stage: Stage[Any]
    measure: str
    knobs: Mapping[str, Any]
    table: Mapping[str, Any]
    options: StageOptions
    default: bool

    @property
    def name(self) -> str:
        """For progress: ``infill depth=7``."""
        return f"{self.stage.name} " + ", ".join(f"{k}={v}" for k, v in self.knobs.items())


@dataclass
class _Group:
    """The knobs of one measure."""

    fixed: dict[str, Any] = field(default_factory=dict)
    values: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    combined: bool = False


def parse_knobs(texts: Sequence[str], pipeline: Pipeline) -> dict[str, dict[str, tuple[Any, ...]]]:
    """``stage.option=a,b,c`` texts as stage → option → values.

    Raises
    ------
    SettingsError
        For a text that is not understood, and for a stage that does not exist.
    """
    found: dict[str, dict[str, tuple[Any, ...]]] = {}
    for text in texts:
        target, equals, listed = text.partition("=")
        stage, dot, option = target.strip().partition(".")
        values = [part.strip() for part in listed.split(",") if part.strip()]
        if not (equals and dot and option and values):
            raise SettingsError(
                f"--knob {text!r} is not understood",
                expected="stage.option=a,b,c",
                fix="name the stage, its option and the values to try",
            )
        _known_stage(stage, pipeline)
        read = tuple(parse_assignment(f"x={v}", "option=value")["x"] for v in values)
        found.setdefault(stage, {})[option] = read
    return found


def chosen_stages(
    pipeline: Pipeline, names: Sequence[str], given: GivenKnobs
) -> tuple[Stage[Any], ...]:
    """The stages to sweep, in order: those named, those of given knobs, else all with knobs."""
    for name in names:
        _known_stage(name, pipeline)
    wanted = {*names, *given}
    chosen = tuple(s for s in pipeline if (s.name in wanted if wanted else s.knobs))
    for stage in chosen:
        if not stage.knobs and stage.name not in given:
            raise InputError(
                f"{stage.name} has no knob to sweep",
                expected=", ".join(s.name for s in pipeline if s.knobs),
                fix=f"name one with --knob {stage.name}.OPTION=a,b,c",
            )
    return chosen


def trials_of(
    stage: Stage[Any], settings: StageSettings, given: GivenKnobs, *, quick: bool = False
) -> list[Trial]:
    """The settings of one stage to try, the one in force first.

    Declared knobs are turned one at a time, all others as they stand; knobs given by the user
    are tried in all combinations.

    Raises
    ------
    SettingsError
        For an option that does not exist, or a value it may not have.
    """
    trials: list[Trial] = []
    for measure, group in _groups(stage, given.get(stage.name, {}), quick).items():
        now = options_for(
            stage.name,
            stage.options,
            {stage.name: merged([settings.get(stage.name, {}), group.fixed])},
        )
        plain = now.model_dump(mode="json")
        stand = {option: _value(plain, option) for option in group.values}
        for turned in _turned(group, stand):
            knobs = stand | turned
            table = merged([group.fixed, *(nested(*knob) for knob in turned.items())])
            checked = {stage.name: merged([settings.get(stage.name, {}), table])}
            options = options_for(stage.name, stage.options, checked)
            trials.append(Trial(stage, measure, knobs, table, options, not turned))
    return trials


def _groups(
    stage: Stage[Any], given: Mapping[str, tuple[Any, ...]], quick: bool
) -> dict[str, _Group]:
    declared = {knob.option: knob for knob in stage.knobs}
    groups: dict[str, _Group] = {}
    if not given:
        for knob in stage.knobs:
            values = knob.quick if quick and knob.quick is not None else knob.values
            if values:
                _join(groups, stage, knob, values)
        return groups
    for option, values in given.items():
        knob = declared.get(option, Knob(option, values))
        _join(groups, stage, knob, values)
    for group in groups.values():
        group.combined = len(group.values) > 1
    return groups


def _join(groups: dict[str, _Group], stage: Stage[Any], knob: Knob, values: Any) -> None:
    group = groups.setdefault(knob.measure or stage.name, _Group())
    group.fixed = merged([group.fixed, knob.fixed])
    group.values[knob.option] = tuple(values)


def _turned(group: _Group, stand: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What is turned away from where it stands, nothing first; no setting twice."""
    if group.combined:
        names = list(group.values)
        found = [
            dict(zip(names, values, strict=True)) for values in product(*group.values.values())
        ]
    else:
        found = [{name: value} for name, values in group.values.items() for value in values]
    turned: list[dict[str, Any]] = [{}]
    for one in found:
        moved = {name: value for name, value in one.items() if value != stand[name]}
        if moved not in turned:
            turned.append(moved)
    return turned


def _value(plain: Mapping[str, Any], option: str) -> Any:
    value: Any = plain
    for name in option.split("."):
        if not isinstance(value, Mapping) or name not in value:
            return None  # told as an unknown option once it is set
        value = value[name]
    return value


def _known_stage(name: str, pipeline: Pipeline) -> None:
    names = [stage.name for stage in pipeline]
    if name not in names:
        raise InputError(
            f"There is no stage {name!r}",
            expected=", ".join(names),
            fix=suggestion(name, names) or "choose one of the expected names",
        )
