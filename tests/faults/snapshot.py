"""What lies in a project folder, and what of it was finished."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from stages.main import PIPELINE
from workbench.pipeline.planner import make_plan
from workbench.project.project import Project

#: Files that belong to a run and not to its result.
_OF_THE_RUN = ("lock.json", "hashes.json", "running.json", ".lock", "samples.cloud-lock")
#: Folders of what goes once the record is written: killed just then, a run leaves it there.
PASSING = ("blocks", "parts")
#: ``verify`` writes the date and the seconds of every stage into all it makes.
NOT_REPEATED = ("verify",)

Stamps = dict[str, tuple[int, int, int]]


def stage_named(name: str):
    """The stage of this name."""
    return next(stage for stage in PIPELINE if stage.name == name)


def product_hashes(root: Path, stages: Iterable[str]) -> dict[str, str]:
    """Path → content of every product of some stages."""
    store = Project(root).store
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for name in stages
        for artefact in stage_named(name).writes
        for path in store.paths(artefact)
        if path.parent.name not in PASSING
    }


def stray_files(root: Path, reference: Path) -> list[str]:
    """Files of ``root`` that the reference has not, and the other way round."""

    def files(folder: Path) -> set[str]:
        found = (path for path in folder.rglob("*") if path.is_file())
        return {
            str(path.relative_to(folder))
            for path in found
            if path.name not in _OF_THE_RUN and path.parent.name not in PASSING
        }

    return sorted(files(root) ^ files(reference))


def stamps(paths: Iterable[Path]) -> Stamps:
    """Path → inode, size and time: another inode is another writing."""
    found = {}
    for path in paths:
        status = path.stat()
        found[str(path)] = (status.st_ino, status.st_size, status.st_mtime_ns)
    return found


def finished_items(root: Path, stage: str) -> Stamps:
    """Notes of a stage's items whose products are as they say, with those products."""
    found: list[Path] = []
    for note in (root / "work" / stage / "items").rglob("*.json"):
        if note.name.startswith("."):
            continue
        written = json.loads(note.read_text("utf-8"))["written"]
        products = [root / path for path, _ in written]
        if all(_content(p) == told for p, (_, told) in zip(products, written, strict=True)):
            found += [note, *products]
    return stamps(found)


def records(root: Path) -> Stamps:
    """The records of all stages."""
    return stamps((root / "work").glob("*/record.json"))


def states(root: Path) -> dict[str, tuple[str, str]]:
    """Stage → state and reason, as ``workbench status`` would tell."""
    plan = make_plan(PIPELINE, Project(root))
    return {p.stage.name: (p.state.state, p.state.reason) for p in plan if p.state}


def _content(path: Path) -> str | None:
    if not path.is_file():
        return None
    digest = hashlib.blake2b(path.read_bytes(), digest_size=20).hexdigest()
    return f"blake2b:{digest}"


def without_stages(root: Path, names: Iterable[str]) -> None:
    """Take everything away that some stages made."""
    store = Project(root).store
    for name in names:
        for artefact in stage_named(name).writes:
            for path in store.paths(artefact):
                path.unlink()
        folder = root / "work" / name
        for path in sorted(folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
