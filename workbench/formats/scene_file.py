"""Meshes of OBJ, STL, GLB and glTF files by way of trimesh, which believes what files declare.

Names inside a file lead to files beside it and nowhere else; counts are held against the bytes
there are before room is made for them.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.whole_file import whole_file

_FIX = "Check the file; the program that wrote it may offer another format."
_JSON_CHUNK = 0x4E4F534A
# A part drawn in many places is copied into each.
_MOST_BYTES_PER_BYTE, _ALWAYS_BYTES = 64, 1 << 24


@dataclass(frozen=True)
class SceneFile:
    """What a file holds.

    Attributes
    ----------
    parts : each mesh with its place (4, 4) in the world, once for every time it is drawn.
    file_bytes : of the file and of those beside it that were read.
    """

    parts: list[tuple[Any, NDArray[np.float64]]]
    file_bytes: int


def read_scene(path: Path, *, pictures: bool) -> SceneFile:
    """The meshes of a file.

    Parameters
    ----------
    path
        OBJ, STL, GLB or glTF.
    pictures
        Whether materials and their pictures are read, too.

    Raises
    ------
    InputError
        The file is damaged, or declares more than it can hold.
    """
    data = whole_file(path)
    suffix = path.suffix.lower()
    beside = FilesBeside(path)
    try:
        if suffix in (".glb", ".gltf"):
            _check_counts(_description(data, suffix), len(data) + beside.folder_bytes)
        options = {"skip_materials": True} if suffix == ".obj" and not pictures else {}
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=suffix[1:], resolver=beside, process=False, **options
        )
        parts = [
            (scene.geometry[name], np.asarray(world_from_node, np.float64))
            for world_from_node, name in map(scene.graph.get, scene.graph.nodes_geometry)
            if isinstance(scene.geometry[name], trimesh.Trimesh)
        ]
        size = len(data) + beside.read_bytes
        drawn = sum(24 * len(part.vertices) + 24 * len(part.faces) for part, _ in parts)
        if drawn > _MOST_BYTES_PER_BYTE * size + _ALWAYS_BYTES:
            raise ValueError(f"{drawn} bytes of meshes out of {size} of the file")
    except Exception as error:
        # The library throws whatever its parsers run into; all of it means a bad file.
        raise scene_refused(
            path, "The surface cannot be read.", f"{type(error).__name__}: {error}"[:200]
        ) from error
    return SceneFile(parts, size)


def scene_refused(path: Path, message: str, found: str) -> InputError:
    """The error of a file that cannot be used."""
    return InputError(message, file=path, found=found, fix=_FIX)


class FilesBeside(trimesh.resolvers.Resolver):  # type: ignore[misc]
    """The files in the folder of a file, and in folders below it.

    Parameters
    ----------
    path : of the file.

    Attributes
    ----------
    read_bytes : of all that was asked for.
    """

    def __init__(self, path: Path) -> None:
        self._folder = path.parent.resolve()
        self.read_bytes = 0

    @property
    def folder_bytes(self) -> int:
        """Of all files in the folder itself: more than any of them can hold."""
        return sum(entry.stat().st_size for entry in self._folder.iterdir() if entry.is_file())

    def get(self, name: str) -> bytes:
        """The bytes of a file.

        Raises
        ------
        ValueError
            Its name, or where a link leads, is outside the folder.
        InputError
            It is not there.
        """
        name = name.strip()
        parts = PureWindowsPath(name).parts
        place = self._folder.joinpath(*parts).resolve()
        if PureWindowsPath(name).anchor or ".." in parts or self._folder not in place.parents:
            raise ValueError(f"{name[:80]!r} is not beside the file")
        data = whole_file(place)
        self.read_bytes += len(data)
        return data

    def keys(self) -> Iterator[str]:
        """Names of the files in the folder."""
        return (entry.name for entry in self._folder.iterdir() if entry.is_file())

    def write(self, name: str, data: bytes) -> None:
        """Nothing is written."""
        raise ValueError("files beside a surface are only read")

    def namespaced(self, namespace: str) -> FilesBeside:
        """Files of a folder below, named by it."""
        return self


def _description(data: bytes, suffix: str) -> Any:
    if suffix == ".gltf":
        return json.loads(data)
    size, kind = struct.unpack_from("<II", data, 12)
    return json.loads(data[20 : 20 + size]) if kind == _JSON_CHUNK else {}


def _check_counts(told: Any, most: int) -> None:
    """No accessor has more elements than there are bytes, not even one without a buffer."""
    accessors = told.get("accessors", []) if isinstance(told, Mapping) else []
    for accessor in accessors:
        sparse = accessor.get("sparse", {})
        for counted in (accessor, sparse):
            count = counted.get("count", 0)
            if not isinstance(count, int) or not 0 <= count <= most:
                raise ValueError(f"an accessor of {count!r:.40} elements in {most} bytes")
