"""The project folder: what the user brought, what was made of it, and where it lies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from workbench.errors import InputError, SettingsError
from workbench.project.hashing import FileHashes
from workbench.project.settings import (
    StageSettings,
    first_problem,
    load_preset,
    merged,
    read_stage_tables,
    read_toml,
)
from workbench.project.store import ProductStore
from workbench.project.user_masks import Role, mask_folder

if TYPE_CHECKING:
    from workbench.formats.scans import ScanListing

PROJECT_FILE = "project.toml"
CALIBRATION_FOLDER = "calibration"
ALIGNMENT_FILE = "alignment.toml"
SCHEMA = 1
NO_SURFACE = "neither scans, geometry nor three photographs"
"""Why a `Scene` has no surface."""
_FEWEST_PHOTOS = 3
# As a scan's file would take them: a quarter of the pixels of a picture 1600 wide, 16 bytes each.
_DEPTH_MAP_BYTES = 7_000_000
_USER_MASKS: Mapping[str, Role] = {"training_masks": "training", "corrected_masks": "corrected"}
PHOTO_SUFFIXES = frozenset(
    (
        *(".nef", ".cr2", ".cr3", ".crw", ".arw", ".dng", ".raf", ".orf", ".rw2", ".pef", ".kdc"),
        *(".jpg", ".jpeg", ".png", ".tif", ".tiff"),
    )
)
_CALIBRATION_SUFFIXES = PHOTO_SUFFIXES | {".toml"}


class Inputs(BaseModel):
    """Where the user's files lie, relative to the project folder."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    scans: tuple[str, ...] = ()
    photos: tuple[str, ...] = ()
    geometry: str | None = None
    cameras: str | None = None
    reference: str | None = None
    calibration: tuple[str, ...] = ()


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
    """What is known of a project without reading scans or photographs: what it needs.

    ``reflectance_populations`` is 1 or 2, None before ``ingest`` and without reflectance;
    ``picks`` says whether there is a file of picked places, ``fill_missed`` whether photographs
    were asked to fill what scans missed.
    """

    scans: int
    poses: bool
    photos: int
    cameras: bool
    geometry: bool
    reference: bool
    truth: bool
    scan_bytes: int
    training_masks: int = 0
    corrected_masks: int = 0
    reflectance_populations: int | None = None
    calibration: int = 0
    picks: bool = False
    fill_missed: bool = False

    @property
    def photos_fill(self) -> bool:
        """Whether depth maps of photographs are to fill what the scans missed.

        The photographs have to be placed before there is a surface: by cameras that were
        brought along, or by places picked.
        """
        placed = self.photos >= _FEWEST_PHOTOS and (self.cameras or self.picks)
        return self.fill_missed and bool(self.scans) and placed and not self.geometry

    @property
    def shape_from_photos(self) -> bool:
        """Whether the surface comes of photographs alone: three or more, and nothing else."""
        return self.photos >= _FEWEST_PHOTOS and not (self.scans or self.geometry)

    @property
    def depth_maps(self) -> int:
        """How many depth maps of photographs tell the shape, alone or beside scans."""
        return self.photos if self.shape_from_photos or self.photos_fill else 0

    @property
    def shape_bytes(self) -> int:
        """Size of what tells the shape: the scans' files, or what depth maps would take."""
        return self.scan_bytes + self.depth_maps * _DEPTH_MAP_BYTES

    @property
    def shape_parts(self) -> int:
        """How many scans, or depth maps, tell the shape; 1 at least."""
        return max(self.scans + self.depth_maps, 1)

    @property
    def has_surface(self) -> bool:
        """Whether a surface was brought or can be made."""
        return bool(self.scans or self.geometry or self.shape_from_photos)


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
        self.file = _project_file(path)
        self.store = ProductStore(self.root)

    @property
    def name(self) -> str:
        """What the project is called."""
        return self.file.name

    @cached_property
    def hashes(self) -> FileHashes:
        """Content hashes of the project's files."""
        return FileHashes(self.root / "work" / "hashes.json", self.root)

    @cached_property
    def scan_listing(self) -> ScanListing | None:
        """The scan and pose files; None where the project has no scans."""
        if not self.file.inputs.scans:
            return None
        # Here and not above: the readers of scans load libraries that opening needs nothing of.
        from workbench.formats.scans import find_scans

        return find_scans([self._input_path(entry) for entry in self.file.inputs.scans])

    @cached_property
    def photo_files(self) -> tuple[Path, ...]:
        """The photographs the project names."""
        return find_photos([self._input_path(entry) for entry in self.file.inputs.photos])

    @cached_property
    def calibration_files(self) -> tuple[Path, ...]:
        """Frames of charts and even targets, and the notes beside them.

        Those that the project names; else what lies in its own ``calibration`` folder.
        """
        if self.file.inputs.calibration:
            entries = self.file.inputs.calibration
            return find_calibration([self._input_path(entry) for entry in entries])
        own = self.root / CALIBRATION_FOLDER
        return _calibration_in(own) if own.is_dir() else ()

    def input_paths(self, artefact: str) -> tuple[Path, ...]:
        """The user's files behind an artefact of format ``input``."""
        inputs = self.file.inputs
        if artefact in ("scan_files", "pose_files"):
            listing = self.scan_listing
            if listing is None:
                return ()
            return listing.files if artefact == "scan_files" else listing.pose_files
        if artefact == "photo_files":
            return self.photo_files
        if artefact == "photo_sidecars":
            # Here and not above, as for scans.
            from workbench.photos.exif import sidecar_files

            return tuple(beside for path in self.photo_files for beside in sidecar_files(path))
        if artefact == "alignment_file":
            path = self.root / ALIGNMENT_FILE
            return (path,) if path.is_file() else ()
        if artefact == "calibration_files":
            return self.calibration_files
        if artefact in _USER_MASKS:
            folder = mask_folder(self.root, _USER_MASKS[artefact])
            return visible_files(folder) if folder.is_dir() else ()
        entry = {
            "geometry_file": inputs.geometry,
            "camera_files": inputs.cameras,
            "reference_file": inputs.reference,
        }[artefact]
        if entry is None:
            return ()
        path = self._input_path(entry)
        return visible_files(path) if path.is_dir() else (path,)

    def scene(self, overrides: StageSettings | None = None) -> Scene:
        """What the project holds, from its listing of files; a missing input raises.

        ``overrides`` are settings beside those of the project.
        """
        listing = self.scan_listing
        files = listing.files if listing else ()
        return Scene(
            scans=len(files),
            poses=bool(listing and listing.pose_files),
            photos=len(self.photo_files),
            cameras=bool(self.input_paths("camera_files")),
            geometry=bool(self.input_paths("geometry_file")),
            reference=bool(self.input_paths("reference_file")),
            truth=(self.root / "truth").is_dir(),
            scan_bytes=sum(path.stat().st_size for path in files),
            training_masks=len(self.input_paths("training_masks")),
            corrected_masks=len(self.input_paths("corrected_masks")),
            reflectance_populations=self._reflectance_populations(),
            calibration=len(self.calibration_files),
            picks=bool(self.input_paths("alignment_file")),
            fill_missed=self.settings(overrides).get("densify", {}).get("fill") == "missed",
        )

    def _reflectance_populations(self) -> int | None:
        try:
            inventory = self.store.load("scan_inventory")
        except InputError:
            return None  # not there, or damaged: `ingest` will make it again
        try:
            told = [entry.get("reflectance_populations") for entry in inventory.get("scans", ())]
            return max((int(count) for count in told if count), default=None)
        except (AttributeError, TypeError, ValueError, OverflowError):
            return None  # likewise

    def settings(self, overrides: StageSettings | None = None) -> StageSettings:
        """Preset, project file and ``overrides`` merged."""
        own = {stage: dict(table) for stage, table in self.file.stages.items()}
        try:
            preset = load_preset(self.file.preset)
        except SettingsError as error:
            error.file = error.file or str(self.root / PROJECT_FILE)
            raise
        return merged([preset, own, overrides or {}])

    def _input_path(self, entry: str) -> Path:
        try:
            path = absolute(self.root / entry)
            there = path.exists()
        except (OSError, ValueError):  # no name a file can have
            path, there = self.root / PROJECT_FILE, False
        if not there:
            raise InputError(
                "An input of the project is not there",
                file=path,
                found=f"project.toml names {entry[:200]!r}",
                fix="put it back, or correct [inputs] in project.toml "
                "(a moved project keeps its inputs relative to itself; --copy takes them along)",
            )
        return path


def absolute(path: Path) -> Path:
    """The path from the root, its last part as the user sees it.

    A link is not followed there: archives keep large files under the hash of their content,
    and the name a scan is known by is the link's.
    """
    return path.resolve() if path.name in ("", "..") else path.parent.resolve() / path.name


def visible_files(folder: Path) -> tuple[Path, ...]:
    """The files directly in a folder, sorted, without hidden ones."""
    return tuple(p for p in sorted(folder.iterdir()) if p.is_file() and not p.name.startswith("."))


def find_photos(paths: Sequence[Path]) -> tuple[Path, ...]:
    """The photographs among ``paths``: files as they are, folders searched one level deep."""
    found: dict[Path, None] = {}
    for path in paths:
        if not path.exists():
            raise InputError("There is no such file or folder", file=path, fix="check the path")
        candidates = visible_files(path) if path.is_dir() else (path,)
        photos = [absolute(p) for p in candidates if p.suffix.lower() in PHOTO_SUFFIXES]
        if not photos:
            raise InputError(
                "No photographs found",
                file=path,
                expected=" ".join(sorted(PHOTO_SUFFIXES)),
                fix="name photographs, or a folder that directly holds some",
            )
        found |= dict.fromkeys(photos)
    return tuple(found)


def find_calibration(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Calibration frames and notes among ``paths``: files as they are, folders one level deep."""
    found: dict[Path, None] = {}
    for path in paths:
        if not path.exists():
            raise InputError("There is no such file or folder", file=path, fix="check the path")
        kept = _calibration_in(path)
        if not kept:
            raise InputError(
                "No calibration frames found",
                file=path,
                expected=" ".join(sorted(_CALIBRATION_SUFFIXES)),
                fix="name photographs of a chart or an even target, or a folder that holds some",
            )
        found |= dict.fromkeys(kept)
    return tuple(found)


def _calibration_in(path: Path) -> tuple[Path, ...]:
    candidates = visible_files(path) if path.is_dir() else (path,)
    return tuple(absolute(p) for p in candidates if p.suffix.lower() in _CALIBRATION_SUFFIXES)


def _project_file(path: Path) -> ProjectFile:
    document = read_toml(path)
    schema = document.get("schema", SCHEMA)
    # Before anything else is checked: another schema may know other keys.
    if isinstance(schema, int) and schema != SCHEMA:
        raise InputError(
            "The project was made by another version of the workbench",
            file=path,
            expected=f"schema {SCHEMA}",
            found=f"schema {schema}",
            fix="open it with that version, or make a new project from the same inputs",
        )
    read_stage_tables(document, path)
    try:
        return ProjectFile.model_validate(document)
    except ValidationError as error:
        problem = first_problem(error, ProjectFile)
        raise SettingsError(
            f"project.toml: {'unknown key' if problem.unknown else 'wrong or missing'} "
            f"{problem.name!r}",
            file=path,
            found=problem.found,
            expected=problem.expected,
            fix=problem.suggestion or "correct project.toml",
        ) from error
