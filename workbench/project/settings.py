"""Settings: what a stage may be told, and the order in which that is decided.

Preset in ``configs/`` < ``project.toml`` < ``--set stage.option=value``. Nothing unknown
passes: a mistyped stage or option is an error that names the nearest known one.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from workbench.errors import SettingsError

StageSettings = dict[str, dict[str, Any]]


class StageOptions(BaseModel):
    """Base of every stage's options: frozen, closed, finite.

    A field with ``json_schema_extra={"changes_result": False}`` (threads, verbosity) does
    not make finished results stale.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def result_options(self) -> dict[str, Any]:
        """The plain options that can change the result."""
        plain = self.model_dump(mode="json")
        for name, field in type(self).model_fields.items():
            extra = field.json_schema_extra
            if isinstance(extra, dict) and extra.get("changes_result") is False:
                del plain[name]
        return plain


OptionsT = TypeVar("OptionsT", bound=StageOptions)


def presets() -> dict[str, Path]:
    """Name → file of every preset in ``configs/``."""
    folder = Path(str(files("configs")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_preset(name: str) -> StageSettings:
    """The stage tables of a preset."""
    known = presets()
    if name not in known:
        raise SettingsError(
            f"There is no preset {name!r}",
            expected=", ".join(known),
            fix=_suggestion(name, known) or "choose one of the expected names",
        )
    return read_stage_tables(read_toml(known[name]), known[name])


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as plain data; broken ones raise with the line."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError("Not valid TOML", file=path, found=str(error)) from error


def read_stage_tables(document: Mapping[str, Any], file: Path) -> StageSettings:
    """The ``[stages.<name>]`` tables of a document."""
    tables = document.get("stages", {})
    if not isinstance(tables, dict) or not all(isinstance(t, dict) for t in tables.values()):
        raise SettingsError(
            "[stages] must hold one table per stage", file=file, fix="write [stages.register]"
        )
    return {stage: dict(table) for stage, table in tables.items()}


def parse_override(text: str) -> tuple[str, str, Any]:
    """``stage.option=value`` to its parts; the value is read as TOML, else as a string."""
    target, equals, value = text.partition("=")
    stage, dot, option = target.strip().partition(".")
    if not (equals and dot and stage and option):
        raise SettingsError(f"--set {text!r} is not understood", expected="stage.option=value")
    try:
        parsed: Any = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    return stage, option, parsed


def merged(layers: Iterable[StageSettings]) -> StageSettings:
    """Stage tables merged option by option, later layers winning."""
    result: StageSettings = {}
    for layer in layers:
        for stage, table in layer.items():
            result.setdefault(stage, {}).update(table)
    return result


def options_for(stage: str, model: type[OptionsT], settings: StageSettings) -> OptionsT:
    """The checked options of one stage.

    Raises
    ------
    SettingsError
        With the option, what was given and what is allowed.
    """
    try:
        return model.model_validate(settings.get(stage, {}))
    except ValidationError as error:
        first = error.errors()[0]
        option = ".".join(str(part) for part in first["loc"])
        unknown = first["type"] == "extra_forbidden"
        raise SettingsError(
            f"{'There is no option' if unknown else 'Wrong value for'} {stage}.{option}",
            stage=stage,
            found=repr(first["input"]),
            expected=None if unknown else first["msg"],
            fix=_suggestion(option, model.model_fields) or f"see `workbench {stage} --help`",
        ) from error


def check_stage_names(settings: StageSettings, known: Iterable[str]) -> None:
    """Raise for settings of a stage that does not exist."""
    names = list(known)
    for stage in settings:
        if stage not in names:
            raise SettingsError(
                f"There is no stage {stage!r}",
                expected=", ".join(names),
                fix=_suggestion(stage, names) or "remove the setting",
            )


def _suggestion(name: str, known: Iterable[str]) -> str | None:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else None
