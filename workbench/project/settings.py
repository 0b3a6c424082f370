"""Settings: what a stage may be told, and the order in which that is decided.

Preset in ``configs/`` < ``project.toml`` < ``--set stage.option=value``. Nothing unknown
passes: a mistyped stage or option is an error that names the nearest known one.
"""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from workbench.errors import SettingsError

StageSettings = dict[str, dict[str, Any]]


class StageOptions(BaseModel):
    """Base of every stage's options and of groups of options inside them: frozen, closed, finite.

    A field with ``json_schema_extra={"changes_result": False}`` (threads, verbosity) does
    not make finished results stale.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def result_options(self) -> dict[str, Any]:
        """The plain options that can change the result."""
        plain = self.model_dump(mode="json")
        for name, field in type(self).model_fields.items():
            extra, value = field.json_schema_extra, getattr(self, name)
            if isinstance(extra, dict) and extra.get("changes_result") is False:
                del plain[name]
            elif isinstance(value, StageOptions):
                plain[name] = value.result_options()
        return plain


OptionsT = TypeVar("OptionsT", bound=BaseModel)


def presets() -> dict[str, Path]:
    """Name → file of every preset in ``configs/``."""
    folder = Path(str(files("configs")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_preset(name: str) -> StageSettings:
    """The stage tables of a preset."""
    known = presets()
    if name not in known:
        raise SettingsError(
            f"There is no preset {name[:80]!r}",
            expected=", ".join(known),
            fix=suggestion(name, known) or "choose one of the expected names",
        )
    document = read_toml(known[name])
    for key in document.keys() - {"stages"}:
        raise SettingsError(
            f"Unknown table [{key}]",
            file=known[name],
            expected="[stages.<name>]",
            fix="correct the name of the table",
        )
    return read_stage_tables(document, known[name])


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as plain data; broken ones raise with the line."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # of numbers of thousands of digits, too
        raise SettingsError(
            "Not valid TOML",
            file=path,
            found=str(error)[:200],
            fix="correct the file at that place",
        ) from error
    except OSError as error:
        raise SettingsError(
            "The file cannot be read", file=path, found=error.strerror, fix="check its permissions"
        ) from error


def read_stage_tables(document: Mapping[str, Any], file: Path) -> StageSettings:
    """The ``[stages.<name>]`` tables of a document."""
    tables = document.get("stages", {})
    if not isinstance(tables, dict) or not all(isinstance(t, dict) for t in tables.values()):
        raise SettingsError(
            "[stages] must hold one table per stage", file=file, fix="write [stages.register]"
        )
    return {stage: dict(table) for stage, table in tables.items()}


def parse_assignment(text: str, expected: str = "stage.option=value") -> dict[str, Any]:
    """``a.b=value`` as nested tables; the value is read as TOML, else taken as text.

    ``expected`` shows the form that was asked for; at least as many names must be given.

    Examples
    --------
    >>> parse_assignment("infill.depth=9")
    {'infill': {'depth': 9}}
    """
    target, equals, value = text.partition("=")
    names = [name.strip() for name in target.split(".")]
    if not equals or not all(names) or len(names) < len(expected.split(".")):
        raise SettingsError(
            f"--set {text!r} is not understood",
            expected=expected,
            fix="name the option in full, and no spaces around the equals sign",
        )
    try:
        parsed: Any = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        parsed = value.strip()
    if not isinstance(parsed, bool | int | float | str | list | dict):
        parsed = value.strip()  # TOML knows dates; options do not
    for name in reversed(names):
        parsed = {name: parsed}
    return dict(parsed)


def merged(layers: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Tables merged option by option at every depth, later layers winning."""
    result: dict[str, Any] = {}
    for layer in layers:
        for name, value in layer.items():
            if isinstance(value, Mapping):
                before = result.get(name)
                result[name] = merged([before if isinstance(before, dict) else {}, value])
            else:
                result[name] = value
    return result


def options_for(stage: str, model: type[OptionsT], settings: StageSettings) -> OptionsT:
    """The checked options of one stage.

    Raises
    ------
    SettingsError
        With the option, what was given and what is allowed.
    """
    try:
        # Strict, so that true is no number and "3" no count; by way of JSON, whose strict
        # mode still takes a list for a tuple and 1 for 1.0.
        plain = json.dumps(settings.get(stage, {}), default=str)
        return model.model_validate_json(plain, strict=True)
    except ValidationError as error:
        problem = first_problem(error, model)
        raise SettingsError(
            f"{'There is no option' if problem.unknown else 'Wrong value for'} "
            f"{stage}.{problem.name}",
            stage=stage,
            found=problem.found,
            expected=problem.expected,
            fix=problem.suggestion or f"`workbench options {stage}` lists what there is",
        ) from error


@dataclass(frozen=True)
class Problem:
    """The first thing wrong with some settings, in words.

    Attributes
    ----------
    name : the dotted name of the option.
    found : the value given.
    expected : what is allowed; None where the option itself is ``unknown``.
    suggestion : the nearest known name, for an unknown one.
    """

    name: str
    found: str
    expected: str | None
    unknown: bool
    suggestion: str | None


def first_problem(error: ValidationError, model: type[BaseModel]) -> Problem:
    """What a validation error of ``model`` says about its first option."""
    first, *others = error.errors()
    group: type[BaseModel] | None = model
    names: list[str] = []
    known: list[str] = []
    for part in map(str, first["loc"]):
        if group is None:
            break  # what follows names the branch of a union or the place in a list
        names.append(part)
        fields = {field.alias or name: field for name, field in group.model_fields.items()}
        known = list(fields)
        kind = fields[part].annotation if part in fields else None
        group = kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None
    unknown = first["type"] == "extra_forbidden"
    messages = [first["msg"]] + [
        other["msg"] for other in others if other["loc"][: len(names)] == first["loc"][: len(names)]
    ]
    found = repr(first["input"])
    return Problem(
        name=".".join(names) or "in combination",
        found=found if len(found) <= 100 else found[:100] + "…",
        expected=None if unknown else " or ".join(dict.fromkeys(messages)),
        unknown=unknown,
        suggestion=suggestion(names[-1], known) if unknown and names else None,
    )


def check_stage_names(settings: StageSettings, known: Iterable[str]) -> None:
    """Raise for settings of a stage that does not exist."""
    names = list(known)
    for stage in settings:
        if stage not in names:
            raise SettingsError(
                f"There is no stage {stage!r}",
                expected=", ".join(names),
                fix=suggestion(stage, names) or "remove the setting",
            )


def suggestion(name: str, known: Iterable[str]) -> str | None:
    """``did you mean 'register'?``, where a known name is near enough."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else None
