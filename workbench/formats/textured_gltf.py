"""Textured meshes as one binary glTF file with its pictures in it.

Source: Khronos Group, *glTF 2.0 Specification* (2021): 3.8.2 (texture coordinates from the upper
left corner; colour textures are sRGB-encoded), 3.9 (materials); KHR_materials_unlit.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.glb_container import GlbParts, MeshPlace, unit_normals, write_glb
from workbench.formats.texture_picture import PictureKind, encoded_picture, mime_type
from workbench.geometry.textured_mesh import TexturedMesh

_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP = 9729, 9987, 33071


def write_textured_glb(
    path: Path,
    textured: TexturedMesh,
    world_from_local_origin: Sequence[float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
    *,
    pictures: PictureKind = "jpeg",
    quality: int = 95,
) -> None:
    """Write a textured mesh as one GLB file; same mesh, same bytes.

    Every page is a primitive with a material of its own. Materials are unlit
    (``KHR_materials_unlit``): colours are shown as they are; a program that does not know the
    extension lights them, without gloss. Positions, extras and axes are those of
    `write_surface_glb`; of the attributes only ``normal`` is written, since a vertex colour
    would be multiplied with the texture.

    Parameters
    ----------
    path
        The file to write.
    textured
        Vertices in the local frame.
    world_from_local_origin
        (3,) where the zero of the local frame lies in the world.
    pictures
        ``jpeg``, or ``png`` without loss.
    quality
        Of JPEG, 1 to 100.

    Raises
    ------
    InputError
        The mesh has no triangles: glTF cannot say that.
    """
    mesh = textured.mesh
    if not len(mesh.triangles):
        raise InputError(
            "A surface without triangles cannot be written as GLB.",
            file=path,
            fix="Check the stage that made the surface.",
        )
    place = MeshPlace(mesh.vertices, world_from_local_origin)
    parts = GlbParts()
    primitives: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    for page, picture in enumerate(textured.pictures):
        triangles = mesh.triangles[textured.pages == page]
        if not len(triangles):
            continue
        used, numbers = np.unique(triangles, return_inverse=True)
        attributes = {"POSITION": parts.vertices(mesh.vertices[used] - place.centre, bounds=True)}
        if "normal" in mesh.vertex_attributes:
            normals = unit_normals(mesh.vertex_attributes["normal"][used])
            attributes["NORMAL"] = parts.vertices(normals)
        attributes["TEXCOORD_0"] = parts.vertices(textured.texture_places[used])
        indices = parts.indices(numbers.reshape(-1, 3).astype(np.int32))
        primitives.append({"attributes": attributes, "indices": indices, "material": len(images)})
        content = encoded_picture(picture, pictures, quality)
        images.append({"bufferView": parts.file(content), "mimeType": mime_type(pictures)})
    further = {
        "extensionsUsed": ["KHR_materials_unlit"],
        "materials": [_material(k) for k in range(len(images))],
        "textures": [{"source": k, "sampler": 0} for k in range(len(images))],
        "images": images,
        "samplers": [
            {
                "magFilter": _LINEAR,
                "minFilter": _LINEAR_MIPMAP_LINEAR,
                "wrapS": _CLAMP,
                "wrapT": _CLAMP,
            }
        ],
    }
    write_glb(path, place, primitives, further, parts)


def _material(texture: int) -> dict[str, Any]:
    return {
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": texture},
            "metallicFactor": 0,
            "roughnessFactor": 1,
        },
        "extensions": {"KHR_materials_unlit": {}},
    }
