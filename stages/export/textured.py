"""The textured surface as the export writes it: GLB, and OBJ with what belongs to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from stages.export.options import ExportOptions
from workbench.geometry.mesh import TriangleMesh
from workbench.pipeline.stage import Job, Products


def write_textured(job: Job[ExportOptions], origin: NDArray[np.float64]) -> int:
    """Write the textured surface where there is one; how many formats.

    Parameters
    ----------
    origin : (3,) of the project, in the user's coordinates.
    """
    from workbench.formats.textured_gltf import write_textured_glb
    from workbench.formats.textured_obj import write_textured_obj
    from workbench.geometry.textured_mesh import TexturedMesh

    products, options = job.products, job.options
    atlas = products.load_if_there("texture_atlas")
    wanted = options.textured_glb or options.textured_obj
    if atlas is None or not wanted:
        products.remove_items_except("textured_pages", set())
        return 0
    pages = [products.load("texture_pages", item) for item in products.items("texture_pages")]
    pictures = tuple(np.ascontiguousarray(page[..., :3]) for page in pages)
    made = TriangleMesh.from_arrays(atlas)
    textured = TexturedMesh(made, atlas["texture_places"], atlas["pages"], pictures)
    with job.progress.step("writing the textured surface"):
        if options.textured_glb:
            with products.writing("textured_glb") as path:
                write_textured_glb(
                    path, textured, origin, pictures=options.pictures,
                    quality=options.picture_quality,
                )  # fmt: skip
        if options.textured_obj:
            moved = replace(textured, mesh=replace(made, vertices=made.vertices + origin))
            with TemporaryDirectory() as folder:
                # The files name each other: they are written under their own names.
                files = write_textured_obj(Path(folder) / "textured.obj", moved)
                _keep(products, files)
    if not options.textured_obj:
        products.remove_items_except("textured_pages", set())
    return options.textured_glb + options.textured_obj


def _keep(products: Products, files: Sequence[Path]) -> None:
    """Bring an OBJ (first) and what it names into the project, the OBJ last."""
    pages = set()
    for file in reversed(files):
        name = {".obj": "textured_obj", ".mtl": "textured_mtl"}.get(file.suffix, "textured_pages")
        item = file.stem if name == "textured_pages" else None
        pages |= {item} if item is not None else set()
        with products.writing(name, item) as path:
            copyfile(file, path)
    products.remove_items_except("textured_pages", pages)
