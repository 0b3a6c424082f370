"""Loading and saving the artefacts of a project folder.

Every save writes beside, syncs and renames, so a reader never meets half a file.
"""

from __future__ import annotations

import io
import json
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.formats.atomic import remove_unfinished, replacing
from workbench.formats.color_png import read_color_png, write_color_png
from workbench.formats.linear_tiff import read_linear_tiff, write_linear_tiff
from workbench.formats.mask_png import read_mask_png, write_mask_png
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.rangemap import RangeMap
from workbench.project.artefacts import ARTEFACTS, Artefact

_RANGE_MAP_FIELDS = (
    "points_in_scan",
    "grid",
    "viewpoint_in_scan",
    "reflectance",
    "color",
    "world_from_scan",
    "sigma_m",
)


# All that NumPy, zipfile and the value types raise on bytes nobody wrote.
_DAMAGE = (
    *(ValueError, TypeError, KeyError, EOFError, OSError, SyntaxError, MemoryError),
    *(NotImplementedError, RuntimeError, struct.error, zipfile.BadZipFile, zlib.error),
    *(AttributeError, IndexError, OverflowError),
    tokenize.TokenError,
)


class ItemNameError(InputError, ValueError):
    """An item is called by what is no name of a file, as only damaged notes do."""

    def __init__(self, artefact: str, item: str, root: Path) -> None:
        super().__init__(
            f"{artefact}: {item[:80]!r} cannot be the name of a file",
            file=root / "work",
            fix="run the stages again with --force",
        )


def is_file_name(text: str) -> bool:
    """Whether a text names a file in a folder, and no other place."""
    return text not in ("", ".", "..") and not any(sign in text for sign in "/\\\0")


@dataclass(frozen=True)
class ProductStore:
    """The artefacts below one project root."""

    root: Path

    def path(self, name: str, item: str | None = None) -> Path:
        """Where an artefact (or one item of it) lies, whether or not it exists."""
        artefact = _artefact(name)
        if artefact.format == "input":
            raise ValueError(f"{name} is brought by the user and has no fixed place")
        if artefact.per_item != (item is not None):
            raise ValueError(f"{name}: item {'missing' if item is None else 'not expected'}")
        if item is not None and not is_file_name(item):
            raise ItemNameError(name, item, self.root)
        return self.root / artefact.path.format(item=item)

    def items(self, name: str) -> tuple[str, ...]:
        """The items of a per-item artefact that exist, sorted."""
        pattern = _artefact(name).path
        position = Path(pattern).parts.index(next(p for p in Path(pattern).parts if "{item}" in p))
        before, after = pattern.split("{item}")
        suffix = after.split("/")[0]
        found = self.root.glob(f"{before}*{after}")
        names = (path.relative_to(self.root).parts[position] for path in found)
        return tuple(sorted(name.removesuffix(suffix) for name in names))

    def paths(self, name: str) -> tuple[Path, ...]:
        """Every existing file of an artefact, sorted."""
        if _artefact(name).per_item:
            return tuple(self.path(name, item) for item in self.items(name))
        path = self.path(name)
        return (path,) if path.exists() else ()

    def exists(self, name: str, item: str | None = None) -> bool:
        """Whether the artefact (or one item of it) is there."""
        return self.path(name, item).exists()

    def load(self, name: str, item: str | None = None, only: Sequence[str] | None = None) -> Any:
        """The value of an artefact: dict, arrays, a value type, mask or a path.

        Of ``arrays``, ``only`` those that are named are read; what is not there is damage.
        """
        artefact, path = _artefact(name), self.path(name, item)
        if not path.exists():
            raise InputError(f"{artefact.description}: not there", file=path, fix="run the stages")
        try:
            if artefact.format == "json":
                return json.loads(path.read_text(encoding="utf-8"))
            if artefact.format == "file":
                return path
            if artefact.format == "mask":
                return read_mask_png(path)
            if artefact.format == "picture":
                return read_color_png(path)
            if artefact.format == "linear-picture":
                return read_linear_tiff(path)
            with np.load(path, allow_pickle=False) as archive:
                arrays = {key: archive[key] for key in only or archive.files}
            if artefact.format == "range-map":
                fields: dict[str, Any] = {key: arrays.get(key) for key in _RANGE_MAP_FIELDS}
                return _sound_range_map(RangeMap(name=item or "", **fields))
            if artefact.format == "mesh":
                return _sound_mesh(TriangleMesh.from_arrays(arrays))
            return arrays
        except _DAMAGE as error:
            raise InputError(
                f"{artefact.description}: damaged",
                file=path,
                found=str(error) or type(error).__name__,
                fix="run the stage that writes it again with --force",
            ) from error

    def save(
        self,
        name: str,
        value: Any,
        item: str | None = None,
        at_last: Callable[[], None] = lambda: None,
    ) -> Path:
        """Store a value as the artefact; the same value gives the same bytes.

        ``at_last`` is called before the file takes its place; what it raises keeps it from that.
        """
        artefact = _artefact(name)
        with self.writing(name, item) as path:
            if artefact.format == "json":
                path.write_text(
                    json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8"
                )
            elif artefact.format == "range-map":
                fields = {k: getattr(value, k) for k in _RANGE_MAP_FIELDS}
                _write_arrays(path, {k: v for k, v in fields.items() if v is not None})
            elif artefact.format == "mesh":
                _write_arrays(path, value.arrays())
            elif artefact.format == "mask":
                write_mask_png(path, value)
            elif artefact.format == "picture":
                write_color_png(path, value)
            elif artefact.format == "linear-picture":
                write_linear_tiff(path, value)
            elif artefact.format == "arrays":
                _write_arrays(path, value)
            else:
                raise ValueError(f"{name} is written through writing()")
            at_last()
        return self.path(name, item)

    @contextmanager
    def writing(self, name: str, item: str | None = None) -> Iterator[Path]:
        """A temporary path that takes the artefact's place when the block ends well.

        Raises
        ------
        InputError
            A folder on the way is a link that leads out of the project.
        """
        path = self.path(name, item)
        require_inside(self.root, path.parent)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            yield temporary

    def remove_unfinished(self, name: str) -> None:
        """Take away what killed runs left beside an artefact; who holds the project may."""
        place = self.root / _artefact(name).path.replace("{item}", "*")
        if place.parent.is_dir():
            remove_unfinished(place.parent, place.name)


def require_inside(root: Path, folder: Path) -> None:
    """Refuse a folder to write to that a link takes out of the project.

    Raises
    ------
    InputError
        It lies elsewhere.
    """
    place = folder.resolve()
    if not place.is_relative_to(root.resolve()):
        raise InputError(
            "A folder of the project is a link that leads out of it: nothing is written there",
            file=folder,
            found=str(place),
            fix="put a folder in its place, or move the whole project to where there is room",
        )


def _sound_range_map(scan: RangeMap) -> RangeMap:
    """The range map, whose arrays are of the shapes and kinds it says; else ValueError."""
    grid, place, pose = scan.grid, scan.viewpoint_in_scan, scan.world_from_scan
    if grid is not None and not (grid.ndim == 2 and grid.dtype == np.int32):
        raise ValueError(f"a grid of shape {grid.shape}, {grid.dtype}")
    if grid is not None and grid.size and grid.min() < -1:
        raise ValueError("the grid points before the first sample")
    if place is not None and not (place.shape == (3,) and place.dtype == np.float64):
        raise ValueError(f"a viewpoint of shape {place.shape}, {place.dtype}")
    if pose is not None and not (pose.shape == (4, 4) and pose.dtype == np.float64):
        raise ValueError(f"a pose of shape {pose.shape}, {pose.dtype}")
    return scan


def _sound_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh, whose triangles are of its vertices; else ValueError."""
    vertices, triangles = mesh.vertices, mesh.triangles
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind != "f":
        raise ValueError(f"vertices of shape {vertices.shape}, {vertices.dtype}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind != "i":
        raise ValueError(f"triangles of shape {triangles.shape}, {triangles.dtype}")
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
        raise ValueError("a triangle names a vertex that does not exist")
    for name, values in mesh.vertex_attributes.items():
        if values.shape[:1] != (len(vertices),):
            raise ValueError(f"{name} of shape {values.shape} for {len(vertices)} vertices")
    return mesh


def _artefact(name: str) -> Artefact:
    try:
        return ARTEFACTS[name]
    except KeyError:
        raise ValueError(f"{name!r} is not in the artefact table") from None


def _write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    # Through an open file, for numpy would append ".npz" to the temporary name.
    with io.FileIO(path, "w") as raw, io.BufferedWriter(raw) as file:
        plain = {key: np.asarray(value) for key, value in arrays.items()}
        np.savez(file, allow_pickle=False, **plain)
