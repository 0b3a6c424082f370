"""Textured meshes as OBJ with materials and pictures beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
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
    lines = [
        f"# world_from_local_origin {' '.join(repr(float(v)) for v in world_from_local_origin)}",
        f"mtllib {library.name}",
        *_vertex_lines(textured),
    ]
    with_normals = "normal" in mesh.vertex_attributes
    numbers = range(1, len(mesh.vertices) + 1)
    names = [f"{k}/{k}/{k}" if with_normals else f"{k}/{k}" for k in numbers]
    for page in range(len(textured.pictures)):
        lines.append(f"usemtl page_{page}")
        columns = mesh.triangles[textured.pages == page].T.tolist()
        lines += [f"f {names[a]} {names[b]} {names[c]}" for a, b, c in zip(*columns, strict=True)]
    _write(path, ("\n".join(lines) + "\n").encode())
    return [path, library, *written]


def _vertex_lines(textured: TexturedMesh) -> list[str]:
    mesh = textured.mesh
    columns = mesh.vertices.T.tolist()
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in zip(*columns, strict=True)]
    right, down = textured.texture_places.T
    lines += [
        f"vt {a:.8f} {b:.8f}" for a, b in zip(right.tolist(), (1.0 - down).tolist(), strict=True)
    ]
    if "normal" in mesh.vertex_attributes:
        normals = np.asarray(mesh.vertex_attributes["normal"], np.float64).T.tolist()
        lines += [f"vn {a:.6f} {b:.6f} {c:.6f}" for a, b, c in zip(*normals, strict=True)]
    return lines


def _write(path: Path, content: bytes) -> None:
    with replacing(path) as partial:
        partial.write_bytes(content)
