"""Meshes in the container of binary glTF: the parts, the place in the world, the file.

Source: Khronos Group, *glTF 2.0 Specification* (2021): 3.6.2 (accessors, alignment), 4.4 (GLB
container).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing

_BYTE, _UINT, _FLOAT = 5121, 5125, 5126
_VERTICES, _INDICES = 34962, 34963
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_MODEST = 1000.0
"""Node translations up to this many diagonals; float32 viewers then keep 10⁻⁴ of the size."""


class MeshPlace:
    """Where float32 positions around a mesh's middle lie in the world.

    Attributes
    ----------
    centre : (3,) float64 middle of the bounding box, to be taken from the vertices.
    extras : ``world_from_local_origin`` and ``world_from_positions``, which added to a position
        gives world coordinates.
    node : of the scene; translated by the latter when that is at most a thousand diagonals.
    """

    def __init__(
        self,
        vertices: NDArray[np.float64],
        world_from_local_origin: Sequence[float] | NDArray[np.float64],
    ) -> None:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.centre = (low + high) / 2
        offset = self.centre + np.asarray(world_from_local_origin, np.float64)
        self.extras = {
            "world_from_local_origin": [float(value) for value in world_from_local_origin],
            "world_from_positions": offset.tolist(),
        }
        self.node: dict[str, Any] = {"mesh": 0, "extras": self.extras}
        if np.abs(offset).max() <= _MODEST * float(np.linalg.norm(high - low)):
            self.node["translation"] = offset.tolist()


def unit_normals(normals: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Normals (n, 3) as glTF allows them, of unit length."""
    normal = np.asarray(normals, np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    # A vertex without area has none, and any will do.
    return np.where(length > 0, normal / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])


def write_glb(
    path: Path,
    place: MeshPlace,
    primitives: Sequence[Mapping[str, Any]],
    further: Mapping[str, Any],
    parts: GlbParts,
) -> None:
    """Write one mesh as a GLB file; ``further`` are the properties beside those it takes."""
    document = {
        "asset": {"version": "2.0", "generator": "scan workbench", "extras": place.extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [place.node],
        "meshes": [{"primitives": list(primitives)}],
        **further,
        "accessors": parts.accessors,
        "bufferViews": parts.views,
        "buffers": [{"byteLength": parts.size}],
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + parts.size))
        file.write(struct.pack("<II", len(text), _JSON_CHUNK) + text)
        file.write(struct.pack("<II", parts.size, _BINARY_CHUNK))
        for block in parts.blocks:
            file.write(block)


def read_glb_description(path: Path) -> dict[str, Any]:
    """The JSON part of a GLB file.

    Raises
    ------
    InputError
        It is none, or its end is missing.
    """
    try:
        with open(path, "rb") as file:
            magic, _, total, size, kind = struct.unpack("<4sIIII", file.read(20))
            text = file.read(min(size, path.stat().st_size))
        if magic != b"glTF" or kind != _JSON_CHUNK or len(text) < size:
            raise ValueError("it does not begin as one")
        if total > path.stat().st_size:
            raise ValueError("its end is missing")
        told: dict[str, Any] = json.loads(text)
        if not isinstance(told, dict):
            raise ValueError("its description is no object")
    except (OSError, ValueError, RecursionError, struct.error) as error:
        raise InputError(
            "The file is no GLB.", file=path, found=str(error), fix="export the surface again"
        ) from error
    return told


class GlbParts:
    """The binary chunk and the descriptions of its pieces; every piece is a multiple of 4."""

    def __init__(self) -> None:
        self.blocks: list[bytes] = []
        self.size = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def vertices(self, rows: NDArray[np.floating[Any]], *, bounds: bool = False) -> int:
        """Append float32 numbers or vectors (count, 1 to 3) and return their accessor."""
        kind = f"VEC{rows.shape[1]}" if rows.shape[1] > 1 else "SCALAR"
        return self._add(rows.astype("<f4"), _FLOAT, kind, _VERTICES, bounds=bounds)

    def vertex_bytes(self, rows: NDArray[np.uint8]) -> int:
        """Append one number each, the first of rows (count, 4), and return their accessor."""
        return self._add(rows, _BYTE, "SCALAR", _VERTICES, stride=4)

    def indices(self, triangles: NDArray[np.int32]) -> int:
        """Append triangles (count, 3) and return their accessor."""
        return self._add(triangles.reshape(-1, 1).astype("<u4"), _UINT, "SCALAR", _INDICES)

    def file(self, content: bytes) -> int:
        """Append a file, such as a picture, and return its buffer view."""
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(content)})
        block = content + bytes(-len(content) % 4)
        self.blocks.append(block)
        self.size += len(block)
        return len(self.views) - 1

    def _add(
        self,
        rows: NDArray[Any],
        component: int,
        kind: str,
        target: int,
        *,
        stride: int | None = None,
        bounds: bool = False,
    ) -> int:
        """Append an array (count, components) and return its accessor."""
        block = np.ascontiguousarray(rows).tobytes()
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": len(block)}
        if stride is not None:
            view["byteStride"] = stride
        view["target"] = target
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": component,
            "count": len(rows),
            "type": kind,
        }
        if bounds:
            accessor["min"] = rows.min(axis=0).astype(np.float64).tolist()
            accessor["max"] = rows.max(axis=0).astype(np.float64).tolist()
        self.blocks.append(block)
        self.size += len(block)
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1
