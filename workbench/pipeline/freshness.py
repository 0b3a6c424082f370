"""Whether what lies there is still what would be made now — derived, never listed by hand."""

from __future__ import annotations

from dataclasses import dataclass
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
        "options": options.result_options(),
        "libraries": library_versions(stage.libraries),
        "inputs": {
            name: "left out" if name in absent else _input_hash(project, stage, name)
            for name in stage.reads
        },
    }


def settings_hash(stage: Stage[Any], options: StageOptions) -> str:
    """The part of the fingerprint that is the same for all items of the stage."""
    return hash_of_value(
        [stage.version, options.result_options(), library_versions(stage.libraries)]
    )


def output_hashes(project: Project, stage: Stage[Any]) -> dict[str, str]:
    """Artefact → hash of every product that is there."""
    found = {name: project.store.paths(name) for name in stage.writes}
    return {name: project.hashes.of_files(paths) for name, paths in found.items() if paths}


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
    if record is None:
        return State("missing", "not run yet")
    if record.get("state") == "failed":
        return State("failed", str(record.get("reason")).splitlines()[0])
    outputs = output_hashes(project, stage)
    for name, content in record.get("output_hashes", {}).items():
        if name not in outputs:
            return State("stale", f"missing output: {ARTEFACTS[name].description}")
        if outputs[name] != content:
            return State("stale", f"output changed since: {ARTEFACTS[name].description}")
    reason = _difference(record.get("fingerprint", {}), fingerprint(project, stage, options, absent))
    return State("stale", reason) if reason else State("fresh", f"done {record.get('ended')}")


def _input_hash(project: Project, stage: Stage[Any], name: str) -> str:
    artefact = ARTEFACTS[name]
    if artefact.format == "input":
        return project.hashes.of_files(project.input_paths(name))
    if name == "records":
        # What every other stage did: item name matters, for all files have one name.
        others = [item for item in project.store.items(name) if item != stage.name]
        paths = [project.store.path(name, item) for item in others]
        return hash_of_value([[i, project.hashes.of_file(p)] for i, p in zip(others, paths)])
    return project.hashes.of_files(project.store.paths(name))


def _difference(before: dict[str, Any], now: dict[str, Any]) -> str | None:
    """What changed between two fingerprints, in words; None when nothing did."""
    if before.get("version") != now["version"]:
        return f"code changed: version {before.get('version')} to {now['version']}"
    old_options = before.get("options", {})
    for name, value in now["options"].items():
        if name not in old_options or old_options[name] != value:
            return f"options changed: {name} from {old_options.get(name, 'unset')} to {value}"
    if set(old_options) != set(now["options"]):
        return "options changed"
    for name, value in now["libraries"].items():
        if before.get("libraries", {}).get(name) != value:
            return f"library changed: {name} is now {value}"
    for name, value in now["inputs"].items():
        if before.get("inputs", {}).get(name) != value:
            return f"input changed: {ARTEFACTS[name].description}"
    return None if set(before.get("inputs", {})) == set(now["inputs"]) else "inputs changed"
