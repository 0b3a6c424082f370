"""ASTM E57 scans through libE57Format.

Source: ASTM E2807-11, *Standard Specification for 3D Imaging Data Exchange*. A point is
``x = r cos(elevation) cos(azimuth)``, ``y = r cos(elevation) sin(azimuth)``,
``z = r sin(elevation)``; the pose takes points of a scan to the file's frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pye57
from numpy.typing import NDArray
from pye57 import libe57

from workbench.errors import InputError
from workbench.formats.scan_reading import GridCells, ScanReading, scan_reading
from workbench.formats.whole_file import whole_file
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import Matrix4, from_quaternion_xyzw

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
_OTHERS = (
    "intensity",
    "rowIndex",
    "columnIndex",
    "cartesianInvalidState",
    "sphericalInvalidState",
)
_POINTS_AT_ONCE = 1 << 18


def read_e57(path: Path) -> list[RangeMap]:
    """Read every scan of an E57 file; see `e57_readings`.

    Raises
    ------
    InputError
        No E57, a wrong checksum, no scans, no points.
    """
    return [reading.range_map for reading in e57_readings(path)]


def e57_readings(path: Path) -> list[ScanReading]:
    """Read every scan of an E57 file that has points.

    Points stay in the scan's frame, float64, Cartesian or converted from spherical; samples
    flagged invalid are left out. A pose becomes ``world_from_scan``. ``rowIndex`` and
    ``columnIndex`` make the grid. The scanner is at the origin when the scan has a grid,
    spherical coordinates or a pose other than the identity, else by `assumed_viewpoint`.
    Scans of a file with several are named ``<stem>_000``, ``<stem>_001``, …

    Raises
    ------
    InputError
        No E57, a wrong checksum, no scans, no points.
    """
    path = Path(path)
    # libE57 tells neither an absent file from a damaged one, nor an empty one.
    size = len(whole_file(path))
    try:
        with pye57.E57(str(path)) as file:
            readings = _readings(file, path, size)
    except InputError:
        raise
    except Exception as error:
        # The library throws its own, pybind11's and Python's exceptions, all for bad files.
        raise InputError(
            "The E57 file cannot be read.",
            file=path,
            found=(str(error).splitlines() or [type(error).__name__])[0],
            fix="The file is damaged or no E57: copy or export it again.",
        ) from error
    if not readings:
        raise InputError(
            "The E57 file has no points.",
            file=path,
            found="only scans without points",
            fix="Export it again with its point data.",
        )
    return readings


def _readings(file: Any, path: Path, size: int) -> list[ScanReading]:
    if not file.root.isDefined("data3D") or not file.scan_count:
        raise InputError(
            "The E57 file holds no scans.",
            file=path,
            found="images only, or nothing",
            fix="Export it again with its point data.",
        )
    headers = [file.get_header(k) for k in range(file.scan_count)]
    names = [path.stem]
    if len(headers) > 1:
        names = [f"{path.stem}_{k:03d}" for k in range(len(headers))]
    empty = [name for name, header in zip(names, headers, strict=True) if not header.point_count]
    notes = [f"left out, as they have no points: {', '.join(empty)}"] if empty else []
    return [
        _reading(file, header, path, name, size, notes)
        for name, header in zip(names, headers, strict=True)
        if header.point_count
    ]


def _reading(
    file: Any, header: Any, path: Path, name: str, size: int, notes: list[str]
) -> ScanReading:
    present = set(header.point_fields)
    spherical = not present.issuperset(_CARTESIAN)
    if spherical and not present.issuperset(_SPHERICAL):
        raise InputError(
            f"The scan '{name}' has neither Cartesian nor spherical coordinates.",
            file=path,
            expected=", ".join((*_CARTESIAN, *_SPHERICAL)),
            found=", ".join(header.point_fields),
            fix="Export it with complete coordinates.",
        )
    columns = _columns(file, header, present, path, name, size)
    state = columns.get("sphericalInvalidState" if spherical else "cartesianInvalidState")
    notes = list(notes)
    if state is not None:
        valid = state == 0
        if not valid.all():
            notes.append(f"{int((~valid).sum())} samples are flagged invalid and were left out")
            columns = {field: values[valid] for field, values in columns.items()}
    cells = None
    if "rowIndex" in columns and "columnIndex" in columns:
        cells = GridCells(
            columns["rowIndex"].astype(np.int64), columns["columnIndex"].astype(np.int64)
        )
    pose = _pose(header, path, name)
    placed = pose is not None
    if pose is not None and np.array_equal(pose, np.eye(4)):
        notes.append("the file gives the identity as pose: the scan may never have been registered")
        placed = False
    # Programs that export merged clouds write the identity too: it says nothing of a scanner.
    at_origin = spherical or cells is not None or placed
    return scan_reading(
        path,
        name,
        _points(columns, spherical),
        cells=cells,
        viewpoint=np.zeros(3) if at_origin else None,
        viewpoint_known=at_origin,
        reflectance=columns.get("intensity"),
        color=_color(header, columns),
        world_from_scan=pose,
        notes=notes,
    )


def _columns(
    file: Any, header: Any, present: set[str], path: Path, name: str, size: int
) -> dict[str, NDArray[np.float64]]:
    """The fields that are used, (n,) float64 each; pye57's own buffers cut rows at 65 535."""
    count = header.point_count
    # No point with coordinates takes less than a bit, so a larger count is a damaged one.
    if count > 8 * size:
        raise InputError(
            f"The scan '{name}' declares more points than the file can hold.",
            file=path,
            expected=f"{count} points",
            found=f"{size} bytes",
            fix="The file is damaged: copy or export it again.",
        )
    fields = [f for f in (*_CARTESIAN, *_SPHERICAL, *_COLORS, *_OTHERS) if f in present]
    capacity = min(count, _POINTS_AT_ONCE)
    pieces: dict[str, list[NDArray[np.float64]]] = {field: [] for field in fields}
    arrays = {field: np.empty(capacity, np.float64) for field in fields}
    buffers = libe57.VectorSourceDestBuffer()
    for field, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, field, array, capacity, True, True))
    reader = header.points.reader(buffers)
    while read := reader.read():
        for field, array in arrays.items():
            pieces[field].append(array[:read].copy())
    reader.close()
    columns = {field: np.concatenate([np.empty(0), *parts]) for field, parts in pieces.items()}
    if any(len(column) != count for column in columns.values()):
        raise InputError(
            f"The scan '{name}' ends early.",
            file=path,
            expected=f"{count} points",
            found=f"{len(columns[fields[0]])} points",
            fix="The file is damaged: copy or export it again.",
        )
    return columns


def _points(columns: dict[str, NDArray[np.float64]], spherical: bool) -> NDArray[np.float64]:
    if not spherical:
        return np.stack([columns[field] for field in _CARTESIAN], axis=1)
    distance, azimuth, elevation = (columns[field] for field in _SPHERICAL)
    level = distance * np.cos(elevation)
    return np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1
    )


def _color(header: Any, columns: dict[str, NDArray[np.float64]]) -> NDArray[np.uint8] | None:
    if any(field not in columns for field in _COLORS):
        return None
    prototype = libe57.StructureNode(header.points.prototype())
    channels = []
    for field in _COLORS:
        top = _color_maximum(header, prototype, field)
        values = np.nan_to_num(columns[field], nan=0.0)
        # Limits below 255 in an 8-bit field are what occurs in the picture, not its white.
        scale = 255 / top if top <= 1 or top > 255 else 1.0
        channels.append(np.clip(np.rint(values * scale), 0, 255))
    return np.stack(channels, axis=1).astype(np.uint8)


def _color_maximum(header: Any, prototype: Any, field: str) -> float:
    """The value of white: from the limits of the scan, else from those of the field."""
    node = prototype[field]
    largest = 0.0
    if header.node.isDefined("colorLimits"):
        limits = header["colorLimits"]
        if limits.isDefined(f"{field}Maximum"):
            largest = _number(limits[f"{field}Maximum"])
    if not 0 < largest < 1e9:
        largest = float(node.scaledMaximum() if hasattr(node, "scaledMaximum") else node.maximum())
    return largest if 0 < largest < 1e9 else 255.0


def _pose(header: Any, path: Path, name: str) -> Matrix4 | None:
    if not header.has_pose():
        return None
    node = header["pose"]
    # By name: the standard lets the four components stand in any order.
    quaternion = [0.0, 0.0, 0.0, 1.0]
    if node.isDefined("rotation"):
        quaternion = [_number(node["rotation"][k]) for k in ("x", "y", "z", "w")]
    translation = [0.0, 0.0, 0.0]
    if node.isDefined("translation"):
        translation = [_number(node["translation"][k]) for k in ("x", "y", "z")]
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite([*quaternion, *translation]).all() or not 0.9 < length < 1.1:
        raise InputError(
            f"The pose of the scan '{name}' cannot be used.",
            file=path,
            expected="a unit quaternion and a finite translation",
            found=f"(x, y, z, w) = {quaternion}, translation {translation}",
            fix="Correct the pose, or export the scan without it.",
        )
    return from_quaternion_xyzw(quaternion, translation)


def _number(node: Any) -> float:
    return float(node.scaledValue() if hasattr(node, "scaledValue") else node.value())
