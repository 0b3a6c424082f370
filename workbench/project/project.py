"""The project folder: what the user brought, what was made of it, and where it lies."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from workbench.errors import InputError, SettingsError
from workbench.formats.atomic import replacing
from workbench.formats.scans import ScanListing, find_scans
from workbench.project.hashing import FileHashes
from workbench.project.settings import (
    StageSettings,
    load_preset,
    merged,
    read_stage_tables,
    read_toml,
)
from workbench.project.store import ProductStore

PROJECT_FILE = "project.toml"
SCHEMA = 1
PHOTO_SUFFIXES = frozenset(
    ".nef .cr2 .cr3 .crw .arw .dng .raf .orf .rw2 .pef .kdc .jpg .jpeg .png .tif .tiff".split()
)

_SURFACES = frozenset((".ply", ".obj", ".stl", ".glb"))


class Inputs(BaseModel):
    """Where the user's files lie, relative to the project folder."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    scans: tuple[str, ...] = ()
    photos: tuple[str, ...] = ()
    geometry: str | None = None
    cameras: str | None = None
    reference: str | None = None


class ProjectFile(BaseModel):
    """``project.toml``."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    schema_version: int = Field(SCHEMA, alias="schema")
    name: str
    preset: str = "default"
    inputs: Inputs = Inputs()
    stages: Mapping[str, Mapping[str, Any]] = {}


@dataclass(frozen=True)
class Scene:
    """What is known of a project before any stage ran: enough to say what it needs."""

    scans: int
    poses: bool
    photos: int
    cameras: bool
    geometry: bool
    reference: bool
    truth: bool
    scan_bytes: int


class Project:
    """An opened project folder.

    Parameters
    ----------
    root : the folder that holds ``project.toml``.

    Raises
    ------
    InputError
        When it is not a project, or one of a newer schema.

    Examples
    --------
    >>> project = Project("projects/bunny")           # doctest: +SKIP
    >>> mesh = project.store.load("surface")          # doctest: +SKIP
    """

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root).resolve()
        path = self.root / PROJECT_FILE
        if not path.is_file():
            raise InputError(
                "This folder is not a project",
                file=self.root,
                expected=PROJECT_FILE,
                fix=f"workbench new {root} --scans FOLDER",
            )
        document = read_toml(path)
        read_stage_tables(document, path)
        try:
            self.file = ProjectFile.model_validate(document)
        except ValidationError as error:
            first = error.errors()[0]
            raise SettingsError(
                f"project.toml: {'.'.join(map(str, first['loc']))}: {first['msg']}",
                file=path,
                found=repr(first["input"]),
            ) from error
        if self.file.schema_version != SCHEMA:
            raise InputError(
                "The project was made by another version of the workbench",
                file=path,
                expected=f"schema {SCHEMA}",
                found=f"schema {self.file.schema_version}",
                fix="open it with that version, or make a new project from the same inputs",
            )
        self.store = ProductStore(self.root)

    @property
    def name(self) -> str:
        return self.file.name

    @cached_property
    def hashes(self) -> FileHashes:
        return FileHashes(self.root / "work" / "hashes.json", self.root)

    @cached_property
    def scan_listing(self) -> ScanListing | None:
        """The scan and pose files; None where the project has no scans."""
        if not self.file.inputs.scans:
            return None
        return find_scans([self._input_path(entry) for entry in self.file.inputs.scans])

    @cached_property
    def photo_files(self) -> tuple[Path, ...]:
        return find_photos([self._input_path(entry) for entry in self.file.inputs.photos])

    def input_paths(self, artefact: str) -> tuple[Path, ...]:
        """The user's files behind an artefact of format ``input``."""
        listing, inputs = self.scan_listing, self.file.inputs
        if artefact == "scan_files":
            return listing.files if listing else ()
        if artefact == "pose_files":
            return listing.pose_files if listing else ()
        if artefact == "photo_files":
            return self.photo_files
        entry = {
            "geometry_file": inputs.geometry,
            "camera_files": inputs.cameras,
            "reference_file": inputs.reference,
        }[artefact]
        if entry is None:
            return ()
        path = self._input_path(entry)
        return tuple(sorted(p for p in path.iterdir() if p.is_file())) if path.is_dir() else (path,)

    def scene(self) -> Scene:
        """What the project holds, from its file listing alone."""
        listing, inputs = self.scan_listing, self.file.inputs
        files = listing.files if listing else ()
        return Scene(
            scans=len(files),
            poses=bool(listing and listing.pose_files),
            photos=len(self.photo_files),
            cameras=inputs.cameras is not None,
            geometry=inputs.geometry is not None,
            reference=inputs.reference is not None,
            truth=(self.root / "truth").is_dir(),
            scan_bytes=sum(path.stat().st_size for path in files),
        )

    def settings(self, overrides: StageSettings | None = None) -> StageSettings:
        """Preset, project file and ``overrides`` merged."""
        own = {stage: dict(table) for stage, table in self.file.stages.items()}
        return merged([load_preset(self.file.preset), own, overrides or {}])

    def _input_path(self, entry: str) -> Path:
        path = (self.root / entry).resolve()
        if not path.exists():
            raise InputError(
                "An input of the project is not there",
                file=path,
                found=f"project.toml names {entry!r}",
                fix="put it back, or correct [inputs] in project.toml "
                "(a moved project keeps its inputs relative to itself; --copy takes them along)",
            )
        return path


def find_photos(paths: Sequence[Path]) -> tuple[Path, ...]:
    """The photographs among ``paths``: files as they are, folders searched one level deep."""
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError("There is no such file or folder", file=path)
        candidates = sorted(path.iterdir()) if path.is_dir() else [path]
        photos = [p for p in candidates if p.suffix.lower() in PHOTO_SUFFIXES]
        if not photos:
            raise InputError(
                "No photographs found", file=path, expected=" ".join(sorted(PHOTO_SUFFIXES))
            )
        found += photos
    return tuple(found)


def create_project(
    root: Path,
    *,
    scans: Sequence[Path] = (),
    photos: Sequence[Path] = (),
    geometry: Path | None = None,
    cameras: Path | None = None,
    reference: Path | None = None,
    preset: str = "default",
    copy: bool = False,
) -> Project:
    """Make a project folder that refers to inputs where they lie, or holds copies of them.

    Without ``reference``, the one surface in a ``reference/`` folder inside a scan folder is
    taken: such sets (the Stanford repository, for one) bring what to compare with.

    Raises
    ------
    InputError
        When the folder already holds a project, an input is missing or nothing was given.
    """
    root = root.resolve()
    if (root / PROJECT_FILE).exists():
        raise InputError("There is a project already", file=root, fix="choose another folder")
    if not (scans or photos or geometry):
        raise InputError("A project needs scans, photographs or a surface", fix="give --scans PATH")
    load_preset(preset)
    reference = reference or _reference_beside(scans)
    for path in (geometry, cameras, reference):
        if path is not None and not path.exists():
            raise InputError("There is no such file or folder", file=path)
    if scans:
        find_scans(scans)
    find_photos(photos)
    root.mkdir(parents=True, exist_ok=True)

    def entry(path: Path, folder: str) -> str:
        if copy:
            target = root / "inputs" / folder / path.name
            target.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                shutil.copytree(path, target, dirs_exist_ok=True)
            else:
                shutil.copy2(path, target)
            path = target
        return os.path.relpath(path.resolve(), root)

    lines = [f"schema = {SCHEMA}", f"name = {_toml(root.name)}", f"preset = {_toml(preset)}"]
    lines += ["", "[inputs]", "# relative to this folder"]
    lines += [f"scans = {_toml([entry(p, 'scans') for p in scans])}"]
    lines += [f"photos = {_toml([entry(p, 'photos') for p in photos])}"]
    if geometry:
        lines += [f"geometry = {_toml(entry(geometry, 'geometry'))}"]
    if cameras:
        lines += [f"cameras = {_toml(entry(cameras, 'cameras'))}"]
    if reference:
        lines += [f"reference = {_toml(entry(reference, 'reference'))}"]
    lines += ["", "# What the preset does not say, stage by stage:", "# [stages.infill]", "# depth = 9", ""]
    with replacing(root / PROJECT_FILE) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")
    return Project(root)


def _reference_beside(scans: Sequence[Path]) -> Path | None:
    folders = [path / "reference" for path in scans if (path / "reference").is_dir()]
    found = [p for folder in folders for p in sorted(folder.iterdir()) if p.suffix in _SURFACES]
    return found[0] if len(found) == 1 else None


def _toml(value: str | list[str]) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    escaped = re.sub(r"[\x00-\x1f\x7f\"\\]", lambda m: f"\\u{ord(m.group()):04x}", value)
    return f'"{escaped}"'
