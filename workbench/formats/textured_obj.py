"""Textured meshes as OBJ with materials and pictures beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.obj_text import obj_faces, obj_origin, obj_rows
from workbench.formats.texture_picture import SUFFIX, PictureKind, encoded_picture
from workbench.geometry.textured_mesh import TexturedMesh


def write_textured_obj(
    path: Path,
    textured: TexturedMesh,
    *,
    world_from_local_origin: Sequence[float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
    pictures: PictureKind = "png",
    quality: int = 95,
) -> list[Path]:
    """Write a textured mesh as OBJ, MTL and one picture a page; same mesh, same bytes.

    ``v x y z``, ``vt`` from the lower left corner, ``vn`` where the mesh has normals, and ``f``
    by material. Coordinates have as many digits as it takes to read the same float64 back; the
    materials only emit their textures' colour, as far as the format can say that. Files are
    named after ``path``; the OBJ comes last, so that it never names what is not there.

    Parameters
    ----------
    path
        The OBJ file to write.
    textured
        Vertices in the local frame.
    world_from_local_origin
        (3,) where the zero of that frame lies in the world; kept as a comment.
    pictures
        ``png`` without loss, or ``jpeg``.
    quality
        Of JPEG, 1 to 100.

    Returns
    -------
    The files, the OBJ first.

    Raises
    ------
    InputError
        The mesh has no triangles.
    """
    path, mesh = Path(path), textured.mesh
    if not len(mesh.triangles):
        raise InputError(
            "A surface without triangles cannot be written as a textured OBJ.",
            file=path,
            fix="Check the stage that made the surface.",
        )
    written, materials = [], []
    for page, picture in enumerate(textured.pictures):
        file = path.with_name(f"{path.stem}_{page}{SUFFIX[pictures]}")
        _write(file, encoded_picture(picture, pictures, quality))
        written.append(file)
        materials += [
            f"newmtl page_{page}", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "d 1", "illum 1",
            f"map_Ka {file.name}", f"map_Kd {file.name}", "",
        ]  # fmt: skip
    library = path.with_suffix(".mtl")
    _write(library, "\n".join(materials).encode())
    right, down = textured.texture_places.T
    normals = mesh.vertex_attributes.get("normal")
    with replacing(path) as partial, open(partial, "wb") as text:
        text.write(obj_origin(world_from_local_origin))
        text.write(f"mtllib {library.name}\n".encode())
        text.writelines(obj_rows("v %r %r %r", mesh.vertices))
        text.writelines(obj_rows("vt %.8f %.8f", np.column_stack([right, 1.0 - down])))
        if normals is not None:
            text.writelines(obj_rows("vn %.6f %.6f %.6f", normals))
        corner = "%d/%d" if normals is None else "%d/%d/%d"
        for page in range(len(textured.pictures)):
            text.write(f"usemtl page_{page}\n".encode())
            text.writelines(obj_faces(corner, mesh.triangles[textured.pages == page]))
    return [path, library, *written]


def _write(path: Path, content: bytes) -> None:
    with replacing(path) as partial:
        partial.write_bytes(content)
