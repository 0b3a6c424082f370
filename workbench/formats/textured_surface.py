"""Surfaces with the pictures on them, from files that carry such: GLB, glTF and OBJ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.gltf import srgb_from_linear
from workbench.formats.picture_file import require_pixels_fit
from workbench.formats.scene_file import read_scene, scene_refused
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE

_WITH_PICTURES = (".glb", ".gltf", ".obj")
_PLAIN = (200, 200, 200)


def read_textured_surface(path: Path) -> tuple[TriangleMesh, SurfaceTexture | None]:
    """A surface and its texture, where the file has one that can be read.

    Vertices of a textured surface have the attribute ``color`` (n, 3) uint8 sRGB, the texel they
    lie on. Only the colour of materials counts: neither gloss nor lights nor what shines through.

    Parameters
    ----------
    path
        GLB, glTF or OBJ with pictures in it or beside it, or whatever `read_surface` reads; its
        attributes are then those of `read_surface`, and there is no texture.

    Raises
    ------
    InputError
        The file is damaged, or holds no triangles or vertices that are not finite.

    Notes
    -----
    Parts without a picture in a file with some are of their material's colour. An OBJ whose
    picture is missing is one without texture. Of a glTF without pictures the shape alone is read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WITH_PICTURES:
        return read_surface(path), None
    scene = read_scene(path, pictures=True)
    try:
        pictures = [_picture(part, scene.file_bytes) for part, _ in scene.parts]
        if any(picture is not None for picture in pictures):
            return _joined(path, scene.parts, pictures)
        if suffix == ".gltf":
            return _plain(path, scene.parts), None
    except InputError as error:
        if error.file is not None:
            raise
        raise scene_refused(path, error.message, error.found or "") from error
    except Exception as error:
        # Parts of materials that make no sense, pictures that end early.
        raise scene_refused(
            path, "The surface cannot be read.", f"{type(error).__name__}: {error}"[:200]
        ) from error
    return read_surface(path), None


def _picture(part: Any, file_bytes: int) -> NDArray[np.uint8] | None:
    """The picture (h, w, 3) of a part, None where it has none."""
    if getattr(part.visual, "uv", None) is None:
        return None
    material = part.visual.material
    stored = getattr(material, "baseColorTexture", None)
    stored = stored if stored is not None else getattr(material, "image", None)
    if stored is None:
        return None
    require_pixels_fit(stored.width * stored.height, 1, file_bytes)
    picture = np.array(stored.convert("RGB"), np.uint8)
    factor = getattr(material, "baseColorFactor", None)
    if factor is None:
        return picture
    share = np.asarray(factor)[:3] / (255.0 if np.asarray(factor).dtype.kind in "iu" else 1.0)
    return picture if (share == 1.0).all() else srgb_from_linear(LINEAR_OF_BYTE[picture] * share)


def _joined(
    path: Path,
    parts: list[tuple[Any, NDArray[np.float64]]],
    found: list[NDArray[np.uint8] | None],
) -> tuple[TriangleMesh, SurfaceTexture]:
    """One mesh of all parts, a picture each."""
    pictures, places = [], []
    for (part, _), picture in zip(parts, found, strict=True):
        if picture is None:
            color = getattr(getattr(part.visual, "material", None), "main_color", _PLAIN)
            pictures.append(np.array(color, np.uint8)[:3].reshape(1, 1, 3))
            places.append(np.full((len(part.vertices), 2), 0.5))
        else:
            # The library's places run upwards.
            places.append(np.asarray(part.visual.uv, np.float64) * [1.0, -1.0] + [0.0, 1.0])
            pictures.append(picture)
    mesh = _plain(path, parts)
    sizes = [len(part.faces) for part, _ in parts]
    texture = SurfaceTexture(
        np.concatenate(places),
        np.repeat(np.arange(len(parts), dtype=np.int32), sizes),
        tuple(pictures),
    )
    return mesh.with_attributes(color=texture.vertex_colors(mesh.triangles)), texture


def _plain(path: Path, parts: list[tuple[Any, NDArray[np.float64]]]) -> TriangleMesh:
    """One mesh of all parts, without attributes."""
    vertices, triangles, start = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for part, world_from_node in parts:
        linear_part = world_from_node[:3, :3]
        faces = np.asarray(part.faces, np.int64).reshape(-1, 3)
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(part.vertices):
            raise scene_refused(path, "A triangle names a vertex that does not exist.", "")
        triangles.append(start + (faces[:, ::-1] if np.linalg.det(linear_part) < 0 else faces))
        vertices.append(np.asarray(part.vertices) @ linear_part.T + world_from_node[:3, 3])
        start += len(part.vertices)
    mesh = TriangleMesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))
    if not len(mesh.triangles):
        raise scene_refused(path, "The surface has no triangles.", f"{len(mesh.vertices)} vertices")
    wrong = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
    if wrong:
        raise scene_refused(
            path, "The surface has vertices that are not finite.", f"{wrong} of {start}"
        )
    return mesh
