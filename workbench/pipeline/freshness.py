"""Whether what lies there is still what would be made now — derived, never listed by hand."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workbench.pipeline.records import RecordFolder, library_versions
from workbench.pipeline.stage import Stage
from workbench.project.artefacts import ARTEFACTS
from workbench.project.hashing import hash_of_value
from workbench.project.project import Project
from workbench.project.settings import StageOptions


@dataclass(frozen=True)
class State:
    """The state of one stage: ``fresh stale missing interrupted running failed``."""

    state: str
    reason: str


def fingerprint(
    project: Project, stage: Stage[Any], options: StageOptions, absent: frozenset[str]
) -> dict[str, Any]:
    """All that decides a stage's result: version, options, libraries, content of inputs.

    ``absent`` names the artefacts of stages that are left out.
    """
    return {
        "version": stage.version,
        "schemas": {name: ARTEFACTS[name].schema for name in stage.reads + stage.writes},
        "options": options.result_options(),
        "libraries": library_versions(stage.libraries),
        "inputs": {
            name: "left out" if name in absent else _input_hash(project, stage, name)
            for name in stage.reads
        },
    }


def settings_hash(stage: Stage[Any], options: StageOptions) -> str:
    """The part of the fingerprint that is the same for all items of the stage."""
    schemas = [[name, ARTEFACTS[name].schema] for name in stage.reads + stage.writes]
    libraries = library_versions(stage.libraries)
    return hash_of_value([stage.version, schemas, options.result_options(), libraries])


def output_hashes(project: Project, names: Iterable[str]) -> dict[str, str]:
    """Artefact → hash of every product that is there, of those named."""
    found = {name: project.store.paths(name) for name in names}
    return {name: project.hashes.of_files(paths) for name, paths in found.items() if paths}


def file_entries(project: Project, names: Iterable[str]) -> list[dict[str, Any]]:
    """Every file behind some artefacts with its hash and size, for the record."""
    return [
        {
            "artefact": name,
            "path": os.path.relpath(path, project.root),
            "hash": project.hashes.of_file(path),
            "bytes": path.stat().st_size,
        }
        for name in names
        for path in _files(project, name)
    ]


def state_of(
    project: Project, stage: Stage[Any], options: StageOptions, absent: frozenset[str]
) -> State:
    """The state of a stage, the first reason that applies in words."""
    folder = RecordFolder(project, stage.name)
    running = folder.running()
    if running:
        return State("running", running)
    interrupted = folder.interrupted()
    if interrupted:
        return State("interrupted", f"a run that began {interrupted} did not end")
    record = folder.read()
    if folder.damaged():
        return State("stale", "its record is damaged")
    if record is None:
        return State("missing", "not run yet")
    if record.get("state") == "failed":
        return State(
            "failed", str(record.get("reason") or "for no reason that was told").splitlines()[0]
        )
    outputs = output_hashes(project, stage.writes)
    for name, content in record.get("output_hashes", {}).items():
        if name not in outputs:
            return State("stale", f"missing output: {ARTEFACTS[name].description}")
        if outputs[name] != content:
            return State("stale", f"output changed since: {ARTEFACTS[name].description}")
    reason = _difference(project, record, fingerprint(project, stage, options, absent))
    return State("stale", reason) if reason else State("fresh", f"done {record.get('ended')}")


def _files(project: Project, name: str) -> tuple[Path, ...]:
    brought = ARTEFACTS[name].format == "input"
    return project.input_paths(name) if brought else project.store.paths(name)


def _input_hash(project: Project, stage: Stage[Any], name: str) -> str:
    if name == "records":
        # What every other stage did: item name matters, for all files have one name.
        others = [item for item in project.store.items(name) if item != stage.name]
        paths = [project.store.path(name, item) for item in others]
        hashes = [project.hashes.of_file(path) for path in paths]
        return hash_of_value(list(zip(others, hashes, strict=True)))
    return project.hashes.of_files(_files(project, name))


def _difference(project: Project, record: dict[str, Any], now: dict[str, Any]) -> str | None:
    """What changed between a record and a fingerprint, in words; None when nothing did."""
    before = record.get("fingerprint", {})
    if before.get("version") != now["version"]:
        return f"code changed: version {before.get('version')} to {now['version']}"
    if before.get("schemas") != now["schemas"]:
        return "code changed: another form of what is stored"
    for name, (old, new) in _changes(before.get("options", {}), now["options"]):
        return f"options changed: {name} from {old} to {new}"
    for name, (old, new) in _changes(before.get("libraries", {}), now["libraries"]):
        return f"library changed: {name} from {old} to {new}"
    for name, (_, new) in _changes(before.get("inputs", {}), now["inputs"]):
        if name not in now["inputs"]:
            return f"input changed: {name} is no longer read"
        if new == "left out":
            return f"input changed: {ARTEFACTS[name].description} (now left out)"
        return f"input changed: {ARTEFACTS[name].description}{_which(project, record, name)}"
    return None


def _changes(before: dict[str, Any], now: dict[str, Any]) -> list[tuple[str, tuple[Any, Any]]]:
    names = dict.fromkeys((*now, *before))
    pairs = {name: (before.get(name, "unset"), now.get(name, "unset")) for name in names}
    return [(name, pair) for name, pair in pairs.items() if pair[0] != pair[1]]


def _which(project: Project, record: dict[str, Any], name: str) -> str:
    """The first file that is new, gone or another than the record says, in brackets."""
    if name == "records":
        return ""
    found = {
        entry["path"]: entry["hash"]
        for entry in record.get("inputs", [])
        if entry["artefact"] == name
    }
    now = {entry["path"]: entry["hash"] for entry in file_entries(project, [name])}
    for path, (old, new) in _changes(found, now):
        what = "is new" if old == "unset" else "is gone" if new == "unset" else "changed"
        return f" ({Path(path).name} {what})"
    return ""
