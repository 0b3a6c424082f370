"""Surfaces as binary glTF.

Source: Khronos Group, *glTF 2.0 Specification* (2021): 3.6.2 (accessors, alignment), 3.7.2.1
(attributes; vertex colours are linear, application-specific names start with ``_``), 4.4
(GLB container).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.geometry.mesh import TriangleMesh

_BYTE, _UINT, _FLOAT = 5121, 5125, 5126
_VERTICES, _INDICES = 34962, 34963
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_MODEST = 1000.0
"""Node translations up to this many diagonals; float32 viewers then keep 10⁻⁴ of the size."""


def linear_from_srgb(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """sRGB-encoded bytes as linear values in 0…1 (IEC 61966-2-1)."""
    encoded = np.arange(256) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    values: NDArray[np.float32] = linear.astype(np.float32)[color]
    return values


def srgb_from_linear(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Linear values in 0…1 as sRGB-encoded bytes; the inverse of `linear_from_srgb`."""
    value = np.clip(linear.astype(np.float64), 0, 1)
    encoded = np.where(value <= 0.0031308, value * 12.92, 1.055 * value ** (1 / 2.4) - 0.055)
    bytes_: NDArray[np.uint8] = np.rint(encoded * 255).astype(np.uint8)
    return bytes_


def write_surface_glb(
    path: Path,
    mesh: TriangleMesh,
    world_from_local_origin: Sequence[float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
) -> None:
    """Write a surface as one GLB file; same mesh, same bytes.

    Positions are float32 around the centre of the bounding box, so that a model in national
    coordinates keeps its detail. ``asset.extras`` and the node's ``extras`` hold, in float64,
    ``world_from_local_origin`` and ``world_from_positions``, which added to a position gives
    world coordinates; the node is translated by the latter when that is at most a thousand
    bounding-box diagonals, since viewers compute in float32. Normals, linear vertex colours,
    and ``provenance`` and ``color_provenance`` as ``_PROVENANCE`` and ``_COLOR_PROVENANCE``
    are written when the mesh has them. The axes stay those of the mesh.

    Parameters
    ----------
    path
        The file to write.
    mesh
        Vertices in the local frame; attributes ``normal`` (n, 3), ``color`` (n, 3) uint8
        sRGB, ``provenance`` and ``color_provenance`` (n,) uint8.
    world_from_local_origin
        (3,) where the zero of the local frame lies in the world.

    Raises
    ------
    InputError
        The mesh has no triangles: glTF cannot say that.
    """
    if not len(mesh.triangles):
        raise InputError(
            "A surface without triangles cannot be written as GLB.",
            file=path,
            fix="Check the stage that made the surface.",
        )
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    centre = (low + high) / 2
    offset = centre + np.asarray(world_from_local_origin, np.float64)
    extras = {
        "world_from_local_origin": [float(value) for value in world_from_local_origin],
        "world_from_positions": offset.tolist(),
    }
    node: dict[str, Any] = {"mesh": 0, "extras": extras}
    if np.abs(offset).max() <= _MODEST * float(np.linalg.norm(high - low)):
        node["translation"] = offset.tolist()
    parts = _Parts()
    attributes = _attributes(mesh, centre, parts)
    indices = parts.add(mesh.triangles.reshape(-1, 1).astype("<u4"), _UINT, "SCALAR", _INDICES)
    document = {
        "asset": {"version": "2.0", "generator": "scan workbench", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        # Without a material the default applies, which is polished metal.
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}],
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


def _attributes(mesh: TriangleMesh, centre: NDArray[np.float64], parts: _Parts) -> dict[str, int]:
    given = mesh.vertex_attributes
    positions = (mesh.vertices - centre).astype("<f4")
    attributes = {"POSITION": parts.add(positions, _FLOAT, "VEC3", _VERTICES, bounds=True)}
    if "normal" in given:
        normal = np.asarray(given["normal"], np.float64)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        # glTF allows unit normals only; a vertex without area has none, and any will do.
        unit = np.where(length > 0, normal / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
        attributes["NORMAL"] = parts.add(unit.astype("<f4"), _FLOAT, "VEC3", _VERTICES)
    if "color" in given:
        linear = linear_from_srgb(np.asarray(given["color"], np.uint8))
        attributes["COLOR_0"] = parts.add(linear.astype("<f4"), _FLOAT, "VEC3", _VERTICES)
    for name in ("provenance", "color_provenance"):
        if name in given:
            # Every vertex must start at a multiple of four bytes, hence three bytes of padding.
            padded = np.zeros((len(positions), 4), np.uint8)
            padded[:, 0] = given[name]
            accessor = parts.add(padded, _BYTE, "SCALAR", _VERTICES, stride=4)
            attributes[f"_{name.upper()}"] = accessor
    return attributes


class _Parts:
    """The binary chunk and the descriptions of its pieces; every piece is a multiple of 4."""

    def __init__(self) -> None:
        self.blocks: list[bytes] = []
        self.size = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
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
