"""Making a project folder."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.photos.exif import sidecar_files
from workbench.project.project import (
    PROJECT_FILE,
    SCHEMA,
    Project,
    absolute,
    find_calibration,
    find_photos,
    visible_files,
)
from workbench.project.settings import load_preset

_SURFACES = frozenset((".ply", ".obj", ".stl", ".glb"))

# From an input and the kind it is of to where the project finds it.
_Placement = Callable[[Path, str], Path]


def create_project(
    root: Path,
    *,
    scans: Sequence[Path] = (),
    photos: Sequence[Path] = (),
    geometry: Path | None = None,
    cameras: Path | None = None,
    reference: Path | None = None,
    calibration: Sequence[Path] = (),
    preset: str = "default",
    copy: bool = False,
) -> Project:
    """Make a project folder that refers to inputs where they lie, or holds copies of them.

    Without ``reference``, the one surface in a ``reference/`` folder inside a scan folder is
    taken: such sets (the Stanford repository, for one) bring what to compare with.

    Raises
    ------
    InputError
        When the folder already holds a project, an input is missing or nothing was given;
        no folder is made then.
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
            raise InputError("There is no such file or folder", file=path, fix="check the path")
    if scans:
        from workbench.formats.scans import find_scans

        find_scans(scans)
    find_photos(photos)
    find_calibration(calibration)
    made = not root.exists()
    try:
        root.mkdir(parents=True, exist_ok=True)
        place = _copies_in(root / "inputs") if copy else _where_it_lies
        text = _project_toml(
            root, preset, scans, photos, geometry, cameras, reference, calibration, place
        )
        with replacing(root / PROJECT_FILE) as temporary:
            temporary.write_bytes(text)
    except BaseException as error:
        if made:
            shutil.rmtree(root, ignore_errors=True)
        if isinstance(error, OSError):
            raise InputError(
                "The project folder cannot be written",
                file=root,
                found=str(error),
                fix="choose another place, or make room",
            ) from error
        raise
    return Project(root)


def _project_toml(
    root: Path,
    preset: str,
    scans: Sequence[Path],
    photos: Sequence[Path],
    geometry: Path | None,
    cameras: Path | None,
    reference: Path | None,
    calibration: Sequence[Path],
    place: _Placement,
) -> bytes:
    def entry(path: Path, kind: str) -> str:
        return os.path.relpath(place(path, kind), root)

    lines = [f"schema = {SCHEMA}", f"name = {_toml(root.name)}", f"preset = {_toml(preset)}"]
    lines += ["", "[inputs]", "# relative to this folder"]
    lines += [f"scans = {_toml([entry(path, 'scans') for path in scans])}"]
    lines += [f"photos = {_toml([entry(path, 'photos') for path in photos])}"]
    if calibration:
        lines += [f"calibration = {_toml([entry(path, 'calibration') for path in calibration])}"]
    for kind, path in (("geometry", geometry), ("cameras", cameras), ("reference", reference)):
        if path is not None:
            lines += [f"{kind} = {_toml(entry(path, kind))}"]
    lines += [
        "",
        "# What the preset does not say, stage by stage:",
        "# [stages.infill]",
        "# depth = 9",
        "",
    ]
    try:
        return "\n".join(lines).encode()
    except UnicodeEncodeError as error:
        raise InputError(
            "A name is not valid UTF-8 and cannot be noted in project.toml",
            found=ascii(error.object[max(error.start - 40, 0) : error.end]),
            fix="rename the file or the folder",
        ) from error


def _where_it_lies(path: Path, kind: str) -> Path:
    return absolute(path)


def _copies_in(inputs: Path) -> _Placement:
    """A placement that copies; inputs of one name all keep their name and content.

    Of a folder its visible files are taken. Files given one by one lie together again where
    they lay together before.
    """
    folders: dict[tuple[str, Path], Path] = {}

    def place(path: Path, kind: str) -> Path:
        source = absolute(path)
        folder = source if source.is_dir() else source.parent
        if (kind, folder) not in folders:
            folders[kind, folder] = _free(inputs / kind, folder.name or kind)
        target = folders[kind, folder]
        target.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            for file in visible_files(source):
                shutil.copy2(file, target)
            return target
        shutil.copy2(source, target)
        if kind == "scans":
            _copy_poses(source, target)
        for beside in sidecar_files(source) if kind in ("photos", "calibration") else ():
            shutil.copy2(beside, target)
        return target / source.name

    return place


def _copy_poses(scan: Path, target: Path) -> None:
    """Take along what the pose files beside a scan say of the scans copied so far.

    As a new file: one that names scans left behind would be refused.
    """
    from workbench.formats.poses import write_scan_poses_json
    from workbench.formats.scans import (
        ScanListing,
        find_scans,
        read_pose_files,
        unmatched_poses,
    )

    pose_files = find_scans([scan]).pose_files
    if not pose_files or scan in pose_files:
        return
    poses = read_pose_files(pose_files)
    written = target / "scan_poses.json"
    strangers = unmatched_poses(ScanListing(find_scans([target]).files, (written,)), poses)
    kept = {name: pose for name, pose in poses.items() if name not in strangers}
    if kept:
        write_scan_poses_json(written, kept, [0.0, 0.0, 0.0])


def _free(folder: Path, name: str) -> Path:
    """``folder/name``, or ``folder/name-2`` and so on where that is taken."""
    number, path = 1, folder / name
    while path.exists():
        number += 1
        path = folder / f"{name}-{number}"
    return path


def _reference_beside(scans: Sequence[Path]) -> Path | None:
    folders = [path / "reference" for path in scans if (path / "reference").is_dir()]
    found = [
        p for folder in folders for p in visible_files(folder) if p.suffix.lower() in _SURFACES
    ]
    return found[0] if len(found) == 1 else None


def _toml(value: str | list[str]) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    escaped = re.sub(r"[\x00-\x1f\x7f\"\\]", lambda m: f"\\u{ord(m.group()):04x}", value)
    return f'"{escaped}"'
