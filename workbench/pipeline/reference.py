"""The tables of stages and options in the README, made from the declarations themselves."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from workbench.errors import InputError
from workbench.pipeline.planner import Pipeline
from workbench.project.artefacts import ARTEFACTS

BEGIN, END = "<!-- begin: {name} -->", "<!-- end: {name} -->"


def stage_table(pipeline: Pipeline) -> str:
    """Markdown table: stage, what it does, what it makes."""
    rows = ["| stage | what it does | makes |", "| --- | --- | --- |"]
    for stage in pipeline:
        made = ", ".join(f"`{ARTEFACTS[name].path}`" for name in stage.writes)
        rows.append(f"| `{stage.name}` | {stage.summary} | {made} |")
    return "\n".join(rows)


def options_table(pipeline: Pipeline) -> str:
    """Markdown table: every option of every stage, with bounds, default and source."""
    rows = ["| option | default | allowed | meaning |", "| --- | --- | --- | --- |"]
    for stage in pipeline:
        for name, default, allowed, meaning in option_rows(stage.options):
            cells = (f"`{stage.name}.{name}`", f"`{default}`", allowed, meaning)
            # A bar ends a cell of Markdown, even between backticks.
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def option_rows(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """(name, default, allowed, meaning) of every option; those in a group as ``group.name``."""
    rows: list[tuple[str, str, str, str]] = []
    schema = model.model_json_schema().get("properties", {})
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            rows += [(f"{name}.{row[0]}", *row[1:]) for row in option_rows(kind)]
            continue
        default = field.get_default(call_default_factory=True)
        shown = "" if default is PydanticUndefined else _plain(default)
        rows.append((name, shown, _allowed(schema[name]), field.description or ""))
    return rows


def with_generated_blocks(text: str, pipeline: Pipeline) -> str:
    """A README with its generated blocks made anew."""
    for name, block in (("stages", stage_table(pipeline)), ("options", options_table(pipeline))):
        begin, end = BEGIN.format(name=name), END.format(name=name)
        if begin in text:
            before, _, rest = text.partition(begin)
            _, found, after = rest.partition(end)
            if not found:
                raise InputError(
                    f"The generated block {name!r} has no end", expected=end, fix="add it"
                )
            text = f"{before}{begin}\n{block}\n{end}{after}"
    return text


def _plain(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _allowed(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_allowed(option) for option in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    kind = str(schema.get("type", "any"))
    if kind == "array":
        return "list" if "items" not in schema else f"list of {_allowed(schema['items'])}"
    if kind not in ("integer", "number"):
        return {"null": "none", "boolean": "true, false", "string": "text"}.get(kind, kind)
    low = schema.get("minimum", schema.get("exclusiveMinimum"))
    high = schema.get("maximum", schema.get("exclusiveMaximum"))
    word = "whole number" if kind == "integer" else "number"
    above = "" if low is None else f"{'>' if 'exclusiveMinimum' in schema else '≥'} {low}"
    below = "" if high is None else f"{'<' if 'exclusiveMaximum' in schema else '≤'} {high}"
    bounds = " and ".join(bound for bound in (above, below) if bound)
    return f"{word} {bounds}".rstrip()
