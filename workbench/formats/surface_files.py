"""Surfaces on disk: PLY with everything, OBJ and GLB for other programs, and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.gltf import srgb_from_linear, write_surface_glb
from workbench.formats.obj_text import obj_faces, obj_origin, obj_rows
from workbench.formats.ply import ListColumn, PlyElement, PlyFile, read_ply, write_ply
from workbench.formats.scan_reading import eight_bit_color
from workbench.geometry.mesh import TriangleMesh

__all__ = ["read_surface", "write_surface_glb", "write_surface_obj", "write_surface_ply"]

SURFACE_SUFFIXES = (".ply", ".obj", ".glb", ".stl")

_COLUMNS_OF = {"normal": ("nx", "ny", "nz"), "color": ("red", "green", "blue")}
_FIX = "Check the file; the program that wrote it may offer another format."


def write_surface_ply(
    path: Path,
    mesh: TriangleMesh,
    *,
    world_from_local_origin: Sequence[float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
    unit: str = "metre",
) -> None:
    """Write a surface as binary little-endian PLY; same mesh, same bytes.

    Vertices are ``x y z`` (double), then as far as the mesh has them ``nx ny nz`` (float),
    ``red green blue`` (uchar, sRGB), ``provenance`` (uchar: 0 measured, 1 infilled),
    ``color_provenance`` (uchar: 0 photographed, 1 inpainted, 2 none) and every other
    attribute of one number per vertex, as float when it is floating-point. Faces are
    ``list uchar int vertex_indices``.

    Parameters
    ----------
    path
        The file to write.
    mesh
        Vertices in the project's local frame.
    world_from_local_origin
        (3,) where the zero of that frame lies in the world; kept as a comment, in float64.
    unit
        Name of the unit of length, kept as a comment.
    """
    columns: dict[str, NDArray[np.generic]] = {
        axis: mesh.vertices[:, k] for k, axis in enumerate("xyz")
    }
    given = dict(mesh.vertex_attributes)
    for name, kind in (("normal", np.float32), ("color", np.uint8)):
        if name in given:
            values = np.asarray(given.pop(name)).astype(kind)
            columns |= {column: values[:, k] for k, column in enumerate(_COLUMNS_OF[name])}
    for name in ("provenance", "color_provenance", *sorted(given)):
        if name in given:
            values = np.asarray(given.pop(name))
            if values.ndim != 1:
                raise ValueError(f"{name}: only normal and color may have several components")
            columns[name] = values.astype(_stored_type(name, values.dtype))
    corners = ListColumn(mesh.triangles.reshape(-1), np.full(len(mesh.triangles), 3, np.int64))
    write_ply(
        path,
        [
            PlyElement("vertex", len(mesh.vertices), columns),
            PlyElement("face", len(mesh.triangles), {"vertex_indices": corners}),
        ],
        [
            f"unit {unit}",
            f"world_from_local_origin {' '.join(repr(float(v)) for v in world_from_local_origin)}",
            "provenance 0 measured 1 infilled",
            "color_provenance 0 photographed 1 inpainted 2 none",
        ],
    )


def _stored_type(name: str, kind: np.dtype[Any]) -> np.dtype[Any]:
    if name.endswith("provenance") or kind == np.bool_:
        return np.dtype(np.uint8)
    if kind.kind == "f":
        return np.dtype(np.float32)
    return np.dtype(np.int32) if kind.itemsize == 8 else kind


def write_surface_obj(
    path: Path,
    mesh: TriangleMesh,
    *,
    world_from_local_origin: Sequence[float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
) -> None:
    """Write a surface as OBJ: ``v x y z [r g b]``, ``vn``, ``f``; same mesh, same bytes.

    Coordinates have as many digits as it takes to read the same float64 back. Colours are
    sRGB-encoded in 0…1, an extension that MeshLab, CloudCompare and Blender know. What marks
    infilled parts has no place in this format.

    Parameters
    ----------
    path
        The file to write.
    mesh
        Vertices in the project's local frame; ``normal`` and ``color`` are written.
    world_from_local_origin
        (3,) where the zero of that frame lies in the world; kept as a comment.
    """
    has = mesh.vertex_attributes
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(obj_origin(world_from_local_origin))
        if "color" in has:
            shades = np.array([f"{value / 255:.6g}" for value in range(256)], object)
            colors = shades[np.asarray(has["color"]).astype(np.uint8)]
            file.writelines(obj_rows("v %r %r %r %s %s %s", mesh.vertices, colors))
        else:
            file.writelines(obj_rows("v %r %r %r", mesh.vertices))
        if "normal" in has:
            file.writelines(obj_rows("vn %.6f %.6f %.6f", has["normal"]))
        file.writelines(obj_faces("%d//%d" if "normal" in has else "%d", mesh.triangles))


def read_surface(path: Path) -> TriangleMesh:
    """Read a triangle mesh from PLY, OBJ, GLB or STL.

    PLY keeps every vertex property: ``normal`` (n, 3) float64, ``color`` (n, 3) uint8 sRGB,
    ``provenance`` and other integers as they are, other floating-point ones as float64.
    Polygons are cut into fans. Of the other formats normals and colours are kept where
    there is one of each per vertex (linear colours of GLB become sRGB, and ``_PROVENANCE``
    ``provenance``); the nodes' transforms are applied; vertices of STL that are identical
    bit for bit become one.

    Raises
    ------
    InputError
        Another format, a damaged file, no triangles, coordinates that are not finite, or
        triangles that name vertices which do not exist.

    Notes
    -----
    A GLB of the workbench whose place in the world is too far for a node translation is read
    around its own centre; the place stays in its ``extras``.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SURFACE_SUFFIXES:
        raise InputError(
            "This kind of file is not read as a surface.",
            file=path,
            expected=", ".join(SURFACE_SUFFIXES),
            found=suffix,
            fix="Export it to one of these formats.",
        )
    mesh = _from_ply(read_ply(path), path) if suffix == ".ply" else _from_trimesh(path, suffix)
    if not len(mesh.triangles):
        raise _refused(path, "The surface has no triangles.", f"{len(mesh.vertices)} vertices")
    low, high = int(mesh.triangles.min()), int(mesh.triangles.max())
    if low < 0 or high >= len(mesh.vertices):
        wrong = ((mesh.triangles < 0) | (mesh.triangles >= len(mesh.vertices))).any(axis=1)
        raise _refused(
            path,
            "A triangle names a vertex that does not exist.",
            f"index {low if low < 0 else high} of {len(mesh.vertices)} vertices",
            f"triangle {int(np.argmax(wrong))}",
        )
    finite: NDArray[np.bool_] = np.all(np.isfinite(mesh.vertices), axis=1)
    if not finite.all():
        raise _refused(
            path,
            "The surface has vertices that are not finite.",
            f"{int((~finite).sum())} of {len(finite)}",
            f"vertex {int(np.argmin(finite))}",
        )
    return mesh


def _refused(path: Path, message: str, found: str, where: str | None = None) -> InputError:
    return InputError(message, file=path, where=where, found=found, fix=_FIX)


def _from_ply(file: PlyFile, path: Path) -> TriangleMesh:
    vertex, face = file.elements.get("vertex"), file.elements.get("face")
    axes = [] if vertex is None else [vertex.scalar(axis) for axis in "xyz"]
    corners = None
    for name in ("vertex_indices", "vertex_index"):
        column = face.columns.get(name) if face is not None else None
        corners = column if isinstance(column, ListColumn) else corners
    if vertex is None or any(axis is None for axis in axes) or corners is None:
        raise _refused(
            path, "The PLY file holds no triangle mesh.", ", ".join(file.elements) or "no elements"
        )
    vertices = np.stack([axis.astype(np.float64) for axis in axes if axis is not None], axis=1)
    attributes: dict[str, NDArray[np.generic]] = {}
    used = set("xyz")
    for name, columns in _COLUMNS_OF.items():
        parts = [part for part in map(vertex.scalar, columns) if part is not None]
        if len(parts) == 3:
            used |= set(columns)
            attributes[name] = (
                eight_bit_color(*parts)
                if name == "color"
                else np.stack([part.astype(np.float64) for part in parts], axis=1)
            )
    for name in vertex.columns:
        values = vertex.scalar(name)
        if values is not None and name not in used:
            attributes[name] = values.astype(np.float64) if values.dtype.kind == "f" else values
    return TriangleMesh(vertices, _fans(corners, path), attributes)


def _fans(corners: ListColumn, path: Path) -> NDArray[np.int32]:
    """Triangles of polygons: the first corner with every edge that does not touch it."""
    index = corners.values.astype(np.int64)
    if corners.values.dtype.kind == "f" or (np.abs(index) >= 2**31).any():
        raise _refused(path, "The faces of the PLY file are no vertex indices.", "", "face")
    if (corners.lengths == 3).all():
        return index.reshape(-1, 3).astype(np.int32)
    triangles = np.maximum(corners.lengths - 2, 0)
    first = np.repeat(corners.offsets[:-1], triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    fans = np.stack([index[first], index[first + step + 1], index[first + step + 2]], axis=1)
    return fans.astype(np.int32)


def _from_trimesh(path: Path, suffix: str) -> TriangleMesh:
    # Here, for trimesh takes a while to load and most runs read no such file.
    from workbench.formats.scene_file import read_scene

    scene = read_scene(path, pictures=False)
    try:
        parts = [_part(part, world_from_node, suffix) for part, world_from_node in scene.parts]
    except Exception as error:
        # The library throws whatever its parsers run into; all of it means a bad file.
        raise _refused(
            path, "The surface cannot be read.", f"{type(error).__name__}: {error}"[:200]
        ) from error
    if not parts:
        raise _refused(path, "The file holds no triangle mesh.", "no triangles")
    return _welded(parts[0]) if suffix == ".stl" else _joined(parts)


def _part(geometry: Any, world_from_node: NDArray[np.float64], suffix: str) -> TriangleMesh:
    vertices = np.asarray(geometry.vertices, np.float64)
    linear_part = world_from_node[:3, :3]
    triangles = np.asarray(geometry.faces, np.int64).reshape(-1, 3).astype(np.int32)
    if np.linalg.det(linear_part) < 0:
        triangles = triangles[:, ::-1]
    attributes: dict[str, NDArray[np.generic]] = {}
    # Asked for, the property would make normals up where the file has none.
    if suffix != ".stl" and "vertex_normals" in geometry._cache:
        normal = np.asarray(geometry.vertex_normals, np.float64) @ np.linalg.inv(linear_part)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        attributes["normal"] = normal / np.where(length > 0, length, 1)
    color = _color(geometry, suffix)
    if color is not None and len(color) == len(vertices):
        attributes["color"] = color
    for name, values in geometry.vertex_attributes.items():
        column = np.asarray(values)
        if len(column) == len(vertices) and column.size == len(vertices) and name != "color":
            attributes[name.lstrip("_").lower()] = column.reshape(-1)
    moved = vertices @ linear_part.T + world_from_node[:3, 3]
    return TriangleMesh(moved, triangles, attributes)


def _color(geometry: Any, suffix: str) -> NDArray[np.uint8] | None:
    visual = geometry.visual
    if visual.kind == "vertex":
        color = np.asarray(visual.vertex_colors)[:, :3].astype(np.uint8)
        return srgb_from_linear(color / 255) if suffix == ".glb" else color
    stored = getattr(visual, "vertex_attributes", {}).get("color")
    if stored is None or np.ndim(stored) != 2:
        return None
    linear = np.asarray(stored)[:, :3]
    if linear.dtype.kind in "iu":
        return srgb_from_linear(linear / np.iinfo(linear.dtype).max)
    return srgb_from_linear(linear)


def _joined(parts: Sequence[TriangleMesh]) -> TriangleMesh:
    """One mesh of several, with the attributes that all of them have."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    shared = set.intersection(*(set(part.vertex_attributes) for part in parts))
    return TriangleMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(
            [part.triangles + np.int32(start) for part, start in zip(parts, starts, strict=False)]
        ),
        {
            name: np.concatenate([part.vertex_attributes[name] for part in parts])
            for name in sorted(shared)
        },
    )


def _welded(soup: TriangleMesh) -> TriangleMesh:
    """STL repeats every corner; the same numbers mean the same vertex."""
    vertices, index = np.unique(soup.vertices, axis=0, return_inverse=True)
    return TriangleMesh(vertices, index.reshape(-1)[soup.triangles].astype(np.int32))
