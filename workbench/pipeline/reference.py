"""The tables of stages and options in the README, made from the declarations themselves."""

from __future__ import annotations

import re
from typing import Any

from pydantic_core import PydanticUndefined

from workbench.pipeline.planner import Pipeline
from workbench.project.artefacts import ARTEFACTS
from workbench.project.settings import StageOptions

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
            rows.append(f"| `{stage.name}.{name}` | `{default}` | {allowed} | {meaning} |")
    return "\n".join(rows)


def option_rows(model: type[StageOptions]) -> list[tuple[str, str, str, str]]:
    """(name, default, allowed, meaning) of every option."""
    rows = []
    schema = model.model_json_schema()["properties"] if model.model_fields else {}
    for name, field in model.model_fields.items():
        default = "" if field.default is PydanticUndefined else _plain(field.default)
        rows.append((name, default, _allowed(schema[name]), field.description or ""))
    return rows


def with_generated_blocks(text: str, pipeline: Pipeline) -> str:
    """A README with its generated blocks made anew."""
    for name, block in (("stages", stage_table(pipeline)), ("options", options_table(pipeline))):
        begin, end = BEGIN.format(name=name), END.format(name=name)
        pattern = re.escape(begin) + r".*?" + re.escape(end)
        replacement = f"{begin}\n{block}\n{end}"
        text = re.sub(pattern, lambda _, new=replacement: new, text, flags=re.DOTALL)  # type: ignore[misc]
    return text


def _plain(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _allowed(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_allowed(option) for option in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    kind = {"null": "none", "boolean": "true, false", "string": "text"}.get(schema["type"])
    if kind:
        return kind
    low = schema.get("minimum", schema.get("exclusiveMinimum"))
    high = schema.get("maximum", schema.get("exclusiveMaximum"))
    word = "whole number" if schema["type"] == "integer" else "number"
    if low is None and high is None:
        return word
    above = f"> {low}" if "exclusiveMinimum" in schema else f"≥ {low}"
    below = f"< {high}" if "exclusiveMaximum" in schema else f"≤ {high}"
    return " and ".join(([above] if low is not None else []) + ([below] if high is not None else []))
