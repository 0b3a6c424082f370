"""Surfaces as binary glTF.

Source: Khronos Group, *glTF 2.0 Specification* (2021): 3.7.2.1 (attributes; vertex colours are
linear, application-specific names start with ``_``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.glb_container import GlbParts, MeshPlace, unit_normals, write_glb
from workbench.geometry.mesh import TriangleMesh


def linear_from_srgb(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """sRGB-encoded bytes as linear values in 0…1 (IEC 61966-2-1)."""
    encoded = np.arange(256) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    values: NDArray[np.float32] = linear.astype(np.float32)[color]
    return values


def srgb_from_linear(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Linear values in 0…1 as sRGB-encoded bytes; the inverse of `linear_from_srgb`."""
    bytes_: NDArray[np.uint8] = np.rint(encoded_from_linear(linear) * 255).astype(np.uint8)
    return bytes_


def encoded_from_linear(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """Linear values as sRGB-encoded ones, both in 0…1; what is outside is cut off."""
    value = np.clip(linear.astype(np.float64), 0, 1)
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * value ** (1 / 2.4) - 0.055)


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
    ``provenance`` and ``color_provenance`` as ``_PROVENANCE`` and ``_COLOR_PROVENANCE``, and
    ``distance_to_samples_m`` as ``_DISTANCE_TO_SAMPLES_M``, −1 where there is no sample, are
    written when the mesh has them. The axes stay those of the mesh.

    Parameters
    ----------
    path
        The file to write.
    mesh
        Vertices in the local frame; attributes ``normal`` (n, 3), ``color`` (n, 3) uint8
        sRGB, ``provenance`` and ``color_provenance`` (n,) uint8, ``distance_to_samples_m`` (n,).
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
    place = MeshPlace(mesh.vertices, world_from_local_origin)
    parts = GlbParts()
    attributes = _attributes(mesh, place.centre, parts)
    primitive = {"attributes": attributes, "indices": parts.indices(mesh.triangles), "material": 0}
    # Without a material the default applies, which is polished metal.
    material = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}
    write_glb(path, place, [primitive], {"materials": [material]}, parts)


def _attributes(mesh: TriangleMesh, centre: NDArray[np.float64], parts: GlbParts) -> dict[str, int]:
    given = mesh.vertex_attributes
    positions = mesh.vertices - centre
    attributes = {"POSITION": parts.vertices(positions, bounds=True)}
    if "normal" in given:
        attributes["NORMAL"] = parts.vertices(unit_normals(given["normal"]))
    if "color" in given:
        linear = linear_from_srgb(np.asarray(given["color"], np.uint8))
        attributes["COLOR_0"] = parts.vertices(linear)
    for name in ("provenance", "color_provenance"):
        if name in given:
            # Every vertex must start at a multiple of four bytes, hence three bytes of padding.
            padded = np.zeros((len(positions), 4), np.uint8)
            padded[:, 0] = given[name]
            attributes[f"_{name.upper()}"] = parts.vertex_bytes(padded)
    if "distance_to_samples_m" in given:
        distance = np.asarray(given["distance_to_samples_m"], np.float64)
        # glTF knows no infinity; no sample at all is −1.
        known = np.where(np.isfinite(distance), distance, -1.0)
        attributes["_DISTANCE_TO_SAMPLES_M"] = parts.vertices(known[:, None])
    return attributes
