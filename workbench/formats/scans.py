"""The scans of a project: which files there are, what they are called, where they stand."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

import numpy as np

from workbench.errors import InputError
from workbench.formats.e57 import e57_readings
from workbench.formats.pcd import pcd_reading
from workbench.formats.poses import read_aln, read_conf, read_scan_poses_json
from workbench.formats.ptx import ptx_readings
from workbench.formats.range_ply import range_ply_reading
from workbench.formats.scan_reading import ScanReading, sanitised_name
from workbench.formats.xyz import holds_points, xyz_reading
from workbench.geometry.transforms import Matrix4

__all__ = [
    "SCAN_SUFFIXES",
    "ScanListing",
    "ScanReading",
    "find_scans",
    "read_pose_files",
    "read_scans",
    "require_matching_poses",
    "unmatched_poses",
]

_READERS: Mapping[str, Callable[[Path], list[ScanReading]]] = {
    ".ply": lambda path: [range_ply_reading(path)],
    ".e57": e57_readings,
    ".ptx": ptx_readings,
    ".pcd": lambda path: [pcd_reading(path)],
    ".xyz": lambda path: [xyz_reading(path)],
    ".pts": lambda path: [xyz_reading(path)],
    ".txt": lambda path: [xyz_reading(path)],
    ".asc": lambda path: [xyz_reading(path)],
}
_OF_SEVERAL_SCANS = frozenset({".e57", ".ptx"})
_POSE_SUFFIXES = frozenset({".conf", ".aln"})
_POSE_JSON = "scan_poses.json"
SCAN_SUFFIXES = tuple(_READERS)
"""The extensions of scan files, in lower case."""

_SAME_POSE = 1e-9


@dataclass(frozen=True)
class ScanListing:
    """The scan files of a project and the pose files found with them.

    Attributes
    ----------
    files : in the order given, folders sorted by name; no file twice.
    pose_files : likewise.
    """

    files: tuple[Path, ...]
    pose_files: tuple[Path, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """A name for every file: letters, digits, ``.``, ``_`` and ``-``; all different.

        It is the file's stem, with ``-2``, ``-3``, … where that name, or one of a file with
        several scans (``<name>_000``), is taken; upper and lower case count as the same,
        since some file systems think so.
        """
        taken: list[tuple[str, bool]] = []
        names = []
        for path in self.files:
            several = path.suffix.lower() in _OF_SEVERAL_SCANS
            stem = name = sanitised_name(path.stem)
            number = 1
            while any(_clash(name.casefold(), several, *other) for other in taken):
                number += 1
                name = f"{stem}-{number}"
            taken.append((name.casefold(), several))
            names.append(name)
        return tuple(names)


def _clash(name: str, several: bool, other: str, other_several: bool) -> bool:
    return (
        name == other
        or (other_several and re.fullmatch(re.escape(other) + r"_\d{3,}", name) is not None)
        or (several and re.fullmatch(re.escape(name) + r"_\d{3,}", other) is not None)
    )


def find_scans(paths: Sequence[Path]) -> ScanListing:
    """List scan files and the pose files beside them, without reading scans.

    Parameters
    ----------
    paths
        Scan files, pose files, and folders, of which the files directly inside count:
        subfolders such as ``reference/``, hidden files and other extensions are passed
        over, and of ``.txt`` files those that do not begin like a list of points.

    Raises
    ------
    InputError
        A path that does not exist, a folder without scans, an extension that is not
        supported, no scan at all.
    """
    files: dict[Path, None] = {}
    pose_files: dict[Path, None] = {}
    folders: dict[Path, None] = {}
    for given in paths:
        path = Path(given)
        if path.is_dir():
            inside = [entry for entry in _entries(path) if _is_scan_in_folder(entry)]
            if not inside:
                raise _no_scans(path, "The folder holds no scans.", _names_in(path))
            files.update(dict.fromkeys(map(_absolute, inside)))
            folders[_absolute(path)] = None
        elif not path.exists():
            raise InputError(
                "The scan file or folder does not exist.", file=path, fix="Check the path."
            )
        elif _is_pose_file(path) or path.suffix.lower() == ".json":
            pose_files[_absolute(path)] = None
        elif path.suffix.lower() in _READERS:
            files[_absolute(path)] = None
            folders[_absolute(path).parent] = None
        else:
            raise _no_scans(path, "This kind of file is not read as a scan.", path.suffix)
    if not files:
        shown = paths[0] if paths else Path()
        raise _no_scans(Path(shown), "No scans were given.", f"{len(pose_files)} pose files")
    for folder in folders:
        beside = filter(_is_pose_file, _entries(folder))
        pose_files.update(dict.fromkeys(map(_absolute, beside)))
    return ScanListing(tuple(files), tuple(pose_files))


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputError(
            "The folder cannot be listed.",
            file=folder,
            found=str(error),
            fix="Check its permissions.",
        ) from error


def _absolute(path: Path) -> Path:
    # Links are not followed: in annexed archives they lead to files named by their hash.
    return Path(os.path.abspath(path))


def _is_scan_in_folder(path: Path) -> bool:
    suffix = path.suffix.lower()
    if path.name.startswith(".") or suffix not in _READERS or not path.is_file():
        return False
    return suffix != ".txt" or holds_points(path)


def _is_pose_file(path: Path) -> bool:
    if path.name.startswith(".") or not path.is_file():
        return False
    return path.suffix.lower() in _POSE_SUFFIXES or path.name == _POSE_JSON


def _names_in(folder: Path) -> str:
    names = [path.name for path in _entries(folder)]
    return (", ".join(names[:5]) + (", …" if len(names) > 5 else "")) or "nothing"


def _no_scans(path: Path, message: str, found: str) -> InputError:
    return InputError(
        message,
        file=path,
        expected=f"files that end in {', '.join(SCAN_SUFFIXES)}",
        found=found,
        fix="Name a scan file or a folder that directly holds some, or export to one of these.",
    )


def read_scans(
    path: Path, poses: Mapping[str, Matrix4], name: str | None = None
) -> list[ScanReading]:
    """Read every scan of a file; a pose from ``poses`` wins over the one in the file.

    Parameters
    ----------
    path
        A file of a `ScanListing`.
    poses
        From `read_pose_files`; the key is the file's name (a folder before it is ignored) or
        the scan's name.
    name
        The file's name in `ScanListing.names`; by default its stem. Scans of a file with
        several are called ``<name>_000``, ``<name>_001``, …

    Raises
    ------
    InputError
        The file cannot be read; two different poses for a scan; one pose for a file with
        several scans.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise _no_scans(path, "This kind of file is not read as a scan.", path.suffix)
    readings = reader(path)
    name = sanitised_name(path.stem) if name is None else name
    prefix = sanitised_name(path.stem)
    # The readers number the scans they find after the stem; only the stem is ours to change.
    named = [
        replace(
            reading,
            range_map=replace(
                reading.range_map, name=name + reading.range_map.name.removeprefix(prefix)
            ),
        )
        for reading in readings
    ]
    by_name: dict[str, dict[str, Matrix4]] = {}
    for key, pose in poses.items():
        by_name.setdefault(_last_part(key), {})[key] = pose
    return [_placed(reading, path, by_name, len(named)) for reading in named]


def _last_part(key: str) -> str:
    # Splits at both kinds of slash: the file may come from another system.
    return PureWindowsPath(key).name


def _placed(
    reading: ScanReading, path: Path, poses: Mapping[str, Mapping[str, Matrix4]], scans: int
) -> ScanReading:
    scan = reading.range_map
    if scans > 1 and path.name in poses:
        raise InputError(
            f"A pose file gives one pose for '{path.name}', which holds {scans} scans.",
            file=path,
            fix=f"Give each scan its pose, by names such as '{scan.name}'.",
        )
    found = {**poses.get(path.name, {}), **poses.get(scan.name, {})}
    if not found:
        return reading
    (first, pose), *others = found.items()
    for other, other_pose in others:
        if not _same(pose, other_pose):
            raise _conflict(path, first, other)
    notes = reading.notes
    if scan.world_from_scan is not None and not _same(scan.world_from_scan, pose):
        notes = (*notes, "the pose in the scan file gives way to the one in the pose file")
    else:
        notes = (*notes, "the pose is from the pose file")
    return replace(reading, range_map=replace(scan, world_from_scan=pose), notes=notes)


def _same(a: Matrix4, b: Matrix4) -> bool:
    return bool(np.allclose(a, b, rtol=_SAME_POSE, atol=_SAME_POSE))


def _conflict(path: Path, first: str, second: str) -> InputError:
    return InputError(
        "A scan has two different poses.",
        file=path,
        found=f"one as '{first}', another as '{second}'",
        fix="Remove one of them from the pose files.",
    )


def read_pose_files(paths: Sequence[Path]) -> dict[str, Matrix4]:
    """All poses of several pose files, ``world_from_scan`` by the names the files use.

    Raises
    ------
    InputError
        A file cannot be read, or two give different poses for one name.
    """
    poses: dict[str, Matrix4] = {}
    source: dict[str, Path] = {}
    for path in map(Path, paths):
        for name, pose in _poses_of(path).items():
            if name in poses and not _same(poses[name], pose):
                raise _conflict(path, f"{name} in {source[name].name}", f"{name} in {path.name}")
            poses.setdefault(name, pose)
            source.setdefault(name, path)
    return poses


def _poses_of(path: Path) -> dict[str, Matrix4]:
    match path.suffix.lower():
        case ".conf":
            return read_conf(path)
        case ".aln":
            return read_aln(path)
        case ".json":
            return read_scan_poses_json(path).world_from_scan
    raise InputError(
        "This kind of file is not read as poses.",
        file=path,
        expected=f".conf, .aln or {_POSE_JSON}",
        found=path.suffix,
        fix="Write the poses in one of these formats.",
    )


def unmatched_poses(listing: ScanListing, poses: Mapping[str, Matrix4]) -> tuple[str, ...]:
    """The names of ``poses`` that belong to no scan, in order.

    A name belongs when it is that of a listed file or scan (scans inside a file with several
    are not counted: any ``<name>_000`` will do), or of a file beside the pose files that was
    left out on purpose.
    """
    known = {path.name for path in listing.files} | set(listing.names)
    several = [
        name
        for name, path in zip(listing.names, listing.files, strict=True)
        if path.suffix.lower() in _OF_SEVERAL_SCANS
    ]
    folders = {path.parent for path in listing.pose_files}

    def belongs(name: str) -> bool:
        prefix = re.fullmatch(r"(.+)_\d{3,}", name)
        return (
            name in known
            or (prefix is not None and prefix.group(1) in several)
            or any(name and (folder / name).is_file() for folder in folders)
        )

    return tuple(name for name in poses if not belongs(_last_part(name)))


def require_matching_poses(listing: ScanListing, poses: Mapping[str, Matrix4]) -> None:
    """Check that every pose belongs to a scan; see `unmatched_poses`.

    Raises
    ------
    InputError
        Some do not.
    """
    unmatched = unmatched_poses(listing, poses)
    if unmatched:
        raise InputError(
            f"{len(unmatched)} of {len(poses)} poses match no scan.",
            file=listing.pose_files[0] if len(listing.pose_files) == 1 else None,
            expected=", ".join(path.name for path in listing.files[:10]),
            found=", ".join(unmatched[:10]),
            fix="Correct the names in the pose file, or add the missing scans.",
        )
