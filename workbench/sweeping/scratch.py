"""A project beside the user's, where stages are tried without touching what is finished."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from workbench.pipeline.stage import Stage
from workbench.project.artefacts import ARTEFACTS
from workbench.project.project import PROJECT_FILE, Project
from workbench.project.store import ProductStore

SWEEP_FOLDER = Path("work") / "sweep"
_MADE = frozenset(("work", "exports", "report", "provenance.json", PROJECT_FILE))
_LEAST_SCANS = 3


@contextmanager
def scratch_project(project: Project) -> Iterator[Path]:
    """A folder that is a project of the same inputs, gone when the block ends.

    Inputs, truth and finished stages are links to the user's; only what is tried is written,
    into folders of the scratch project's own.
    """
    root = project.root / SWEEP_FOLDER / "scratch"
    shutil.rmtree(root, ignore_errors=True)  # of a sweep that was stopped
    (root / "work").mkdir(parents=True)
    try:
        for entry in sorted(project.root.iterdir()):
            if entry.name not in _MADE and not entry.name.startswith("."):
                (root / entry.name).symlink_to(entry)
        (root / PROJECT_FILE).write_text(_project_toml(project), encoding="utf-8")
        _link_finished(project.root, root, {"sweep"})
        yield root
    finally:
        shutil.rmtree(root, ignore_errors=True)


def emptied_for(root: Path, stage: Stage[Any]) -> None:
    """Make room for a stage: folders it writes are its own and empty, others as before."""
    for folder in _folders(stage):
        place = root / folder
        if place.is_symlink():
            place.unlink()
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)


def restored(root: Path, original: Path, stages: Iterable[Stage[Any]]) -> None:
    """Link what stages had finished in the project again, after they were tried."""
    for stage in stages:
        for folder in _folders(stage):
            place, source = root / folder, original / folder
            if place.is_symlink():
                continue
            shutil.rmtree(place, ignore_errors=True)
            if source.exists():
                place.symlink_to(source)


def without_scan(root: Path, project: Project, register: Stage[Any]) -> str | None:
    """Give the scratch project scan poses that lack one scan; its name, None for too few scans.

    The one that shares most with the others is left out, for they can tell where it should be.
    """
    poses = project.store.load("scan_poses")
    names = sorted(poses["scans"])
    if len(names) < _LEAST_SCANS:
        return None
    order = [entry["name"] for entry in project.store.load("scan_inventory")["scans"]]
    shared = project.store.load("registration", only=["overlap"])["overlap"].sum(axis=1)
    name = max(names, key=lambda name: shared[order.index(name)])
    emptied_for(root, register)
    # Copies: the pose that is taken out must stay in the user's own.
    for folder in _folders(register):
        shutil.copytree(project.root / folder, root / folder, dirs_exist_ok=True)
    poses["held_out"] = {name: poses["scans"].pop(name)}
    ProductStore(root).save("scan_poses", poses)
    return str(name)


def _folders(stage: Stage[Any]) -> set[Path]:
    """Folders of a stage's products and records, no deeper than ``work/<stage>``."""
    paths = [Path(ARTEFACTS[name].path) for name in stage.writes]
    found = {Path(*path.parts[: 2 if path.parts[0] == "work" else 1]) for path in paths}
    return {Path("work") / stage.name} | {f for f in found if f.suffix == ""}


def _link_finished(original: Path, root: Path, apart: set[str]) -> None:
    for entry in sorted((original / "work").iterdir()):
        if entry.is_dir() and entry.name not in apart:
            (root / "work" / entry.name).symlink_to(entry)
    for name in ("exports", "report"):
        if (original / name).is_dir():
            (root / name).symlink_to(original / name)


def _project_toml(project: Project) -> str:
    """The project file with inputs where they lie; options of stages come by way of the run."""
    file = project.file
    lines = [f"schema = {file.schema_version}", f"name = {json.dumps(file.name)}"]
    lines += [f"preset = {json.dumps(file.preset)}", "[inputs]"]
    for name, value in file.inputs.model_dump().items():
        if value:
            entries = [value] if isinstance(value, str) else list(value)
            placed = [os.path.join(project.root, entry) for entry in entries]
            shown = placed[0] if isinstance(value, str) else placed
            lines.append(f"{name} = {json.dumps(shown)}")
    return "\n".join(lines) + "\n"
