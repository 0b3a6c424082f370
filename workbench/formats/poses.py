"""Poses of scans: Stanford ``.conf``, MeshLab ``.aln``, the workbench's ``scan_poses.json``.

All are given as ``world_from_scan``, 4×4 float64, by the scan file's name as it is written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.whole_file import whole_file
from workbench.geometry.transforms import (
    Matrix4,
    from_quaternion_xyzw,
    is_rigid,
    nearest_rigid,
    rigid,
)

_ROUNDED = 1e-3
"""Poses written with few digits are this far from rigid; they are projected."""


@dataclass(frozen=True)
class ScanPoses:
    """What ``scan_poses.json`` holds.

    Attributes
    ----------
    world_from_scan : scan name → 4×4 float64, into the user's own world coordinates.
    origin : (3,) float64, the point of that world the project computes around.
    """

    world_from_scan: dict[str, Matrix4]
    origin: NDArray[np.float64]


def read_conf(path: Path) -> dict[str, Matrix4]:
    """Read a Stanford ``.conf`` file.

    A line ``bmesh name tx ty tz qx qy qz qw`` means ``p_world = R(q)ᵀ p_scan + t`` (zipper
    and VripPack, Stanford 3D Scanning Repository). ``camera`` and ``mesh`` lines place a
    view and finished meshes, not scans, and are passed over.

    Raises
    ------
    InputError
        A line that is not understood, or a name twice (line number); no ``bmesh`` at all.
    """
    path = Path(path)
    poses: dict[str, Matrix4] = {}
    for number, line in enumerate(_lines(path), start=1):
        words = line.split()
        if not words or words[0].startswith("#") or words[0] in ("camera", "mesh"):
            continue
        if words[0] != "bmesh" or len(words) < 9:
            _refuse(path, number, "bmesh name tx ty tz qx qy qz qw", line)
        values = _numbers(words[-7:], path, number)
        quaternion = values[3:]
        if not 0.9 < float(np.linalg.norm(quaternion)) < 1.1:
            _refuse(path, number, "a quaternion of length 1", line)
        name = " ".join(words[1:-7]).strip('"')
        turned = from_quaternion_xyzw(quaternion, [0, 0, 0])[:3, :3].T
        _add(poses, name, rigid(turned, values[:3]), path, number)
    return _some(poses, path, "bmesh lines")


def read_aln(path: Path) -> dict[str, Matrix4]:
    """Read a MeshLab alignment project.

    The number of scans; for each its file name, a line ``#`` and the four rows of
    ``world_from_scan`` (column vectors); then ``0``.

    Raises
    ------
    InputError
        A line that is not understood, a matrix that is not rigid, a name twice (line
        number); fewer scans than announced.
    """
    path = Path(path)
    lines = [(number, line.strip()) for number, line in enumerate(_lines(path), start=1)]
    lines = [(number, line) for number, line in lines if line]
    number, first = lines[0] if lines else (1, "")
    if re.fullmatch("[0-9]{1,9}", first) is None:
        _refuse(path, number, "the number of scans", first)
    # Six lines per scan; fewer are told below, where the line is known.
    scans = [lines[at : at + 6] for at in range(1, 1 + 6 * min(int(first), len(lines)), 6)]
    poses: dict[str, Matrix4] = {}
    for block in scans:
        if len(block) < 6 or not block[1][1].startswith("#"):
            number, line = block[min(1, len(block) - 1)] if block else lines[-1]
            _refuse(path, number, "a file name, '#' and four rows of a matrix", line)
        rows = []
        for number, line in block[2:]:
            if len(line.split()) != 4:
                _refuse(path, number, "four numbers", line)
            rows.append(_numbers(line.split(), path, number))
        number, name = block[0]
        _add(poses, name, _rigid(np.array(rows), path, number), path, number)
    return _some(poses, path, "scans")


def read_scan_poses_json(path: Path) -> ScanPoses:
    """Read the workbench's own pose file.

    ``{"origin": [x, y, z], "scans": {name: {"world_from_scan": 4×4}}}``; the origin may be
    absent and is then zero.

    Raises
    ------
    InputError
        No such JSON, or a matrix that is not rigid (scan name).
    """
    path = Path(path)
    try:
        content = json.loads(whole_file(path), object_pairs_hook=_without_repeats)
    except (ValueError, RecursionError) as error:
        raise InputError(
            "The pose file is not JSON, or not unambiguous.",
            file=path,
            where=f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else None,
            found=str(error)[:120],
            fix="Let the workbench write it again, or correct that line.",
        ) from error
    scans = content.get("scans") if isinstance(content, dict) else None
    if not isinstance(scans, dict):
        _refuse(path, None, 'an object with the key "scans"', str(content))
    origin = _array(content.get("origin", [0, 0, 0]), (3,), path, '"origin"')
    poses: dict[str, Matrix4] = {}
    for name, entry in scans.items():
        place = f'"scans" → "{name}"'
        if not isinstance(entry, dict) or "world_from_scan" not in entry:
            _refuse(path, place, 'an object with the key "world_from_scan"', str(entry))
        matrix = _array(entry["world_from_scan"], (4, 4), path, place)
        _add(poses, name, _rigid(matrix, path, place), path, place)
    return ScanPoses(_some(poses, path, "scans"), origin)


def write_conf(path: Path, poses: Mapping[str, Matrix4]) -> None:
    """Write poses as a Stanford ``.conf`` file, in their order, with full precision.

    Raises
    ------
    InputError
        A name the format cannot hold.
    """
    lines = []
    for name, world_from_scan in poses.items():
        if name != " ".join(name.split()) or not name:
            raise InputError(
                "A .conf file cannot hold this scan name.",
                file=path,
                found=repr(name),
                fix="Rename the scan without line breaks and repeated blanks, or write .aln.",
            )
        quaternion = Rotation.from_matrix(world_from_scan[:3, :3].T).as_quat()
        numbers = [*world_from_scan[:3, 3].tolist(), *quaternion.tolist()]
        lines.append(f"bmesh {name} {' '.join(map(repr, numbers))}\n")
    _write_text(path, "".join(lines))


def write_aln(path: Path, poses: Mapping[str, Matrix4]) -> None:
    """Write poses as a MeshLab alignment project, in their order, with full precision.

    Raises
    ------
    InputError
        A name the format cannot hold.
    """
    lines = [f"{len(poses)}\n"]
    for name, world_from_scan in poses.items():
        if name != name.strip() or not name or len(name.splitlines()) != 1:
            raise InputError(
                "An .aln file cannot hold this scan name.",
                file=path,
                found=repr(name),
                fix="Rename the scan without line breaks and blanks at its ends.",
            )
        rows = [" ".join(map(repr, row)) for row in world_from_scan.tolist()]
        lines.append("\n".join([name, "#", *rows, ""]))
    _write_text(path, "".join(lines) + "0\n")


def write_scan_poses_json(
    path: Path, poses: Mapping[str, Matrix4], origin: Sequence[float] | NDArray[np.float64]
) -> None:
    """Write the workbench's own pose file, in the order of ``poses``, with full precision.

    Parameters
    ----------
    path
        The file to write.
    poses
        Scan name → ``world_from_scan``, into the project's world.
    origin
        (3,), the point of the world the project computes around.
    """
    content = {
        "origin": [float(value) for value in origin],
        "scans": {
            name: {"world_from_scan": np.asarray(matrix, float).tolist()}
            for name, matrix in poses.items()
        },
    }
    _write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _without_repeats(pairs: list[tuple[str, object]]) -> dict[str, object]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{max(names, key=names.count)!r} occurs twice")
    return content


def _write_text(path: Path, text: str) -> None:
    with replacing(path) as partial:
        partial.write_bytes(text.encode())


def _lines(path: Path) -> list[str]:
    return re.split(r"\r\n|\n|\r", whole_file(path).decode("utf-8-sig", "replace"))


def _numbers(words: Sequence[str], path: Path, line: int) -> NDArray[np.float64]:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        _refuse(path, line, f"{len(words)} numbers", " ".join(words))
    if not np.isfinite(values).all():
        _refuse(path, line, "finite numbers", " ".join(words))
    return values


def _array(value: object, shape: tuple[int, ...], path: Path, where: str) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        _refuse(path, where, f"numbers, {' × '.join(map(str, shape))}", str(value))
    if array.shape != shape or not np.isfinite(array).all():
        _refuse(path, where, f"finite numbers, {' × '.join(map(str, shape))}", str(value))
    return array


def _rigid(matrix: NDArray[np.float64], path: Path, where: int | str) -> Matrix4:
    if not is_rigid(matrix, _ROUNDED):
        _refuse(
            path,
            where,
            "a rigid transform: a rotation and a translation, last row 0 0 0 1",
            f"rotation part with determinant {np.linalg.det(matrix[:3, :3]):.6g}",
        )
    # A matrix that is rigid to the last digits stays as it was written.
    return matrix if is_rigid(matrix, 1e-12) else nearest_rigid(matrix)


def _add(poses: dict[str, Matrix4], name: str, pose: Matrix4, path: Path, where: int | str) -> None:
    if not name or name in poses:
        _refuse(path, where, "a scan name that occurs once", repr(name))
    poses[name] = pose


def _some(poses: dict[str, Matrix4], path: Path, what: str) -> dict[str, Matrix4]:
    if not poses:
        raise InputError(
            f"The pose file holds no {what}.",
            file=path,
            fix="Leave the file out, or write the poses again.",
        )
    return poses


def _refuse(path: Path, where: int | str | None, expected: str, found: str) -> NoReturn:
    raise InputError(
        "The pose file cannot be used.",
        file=path,
        where=f"line {where}" if isinstance(where, int) else where,
        expected=expected,
        found=found.strip()[:120],
        fix="Correct it there, or leave the file out and let the scans be registered.",
    )
