"""How each form of a model that a browser shows is made of what the project exported."""

from __future__ import annotations

from pathlib import Path
from shutil import copyfile

from workbench.project.store import ProductStore
from workbench.viewer.representations import Made, Representation, SiteOptions


def _textured(store: ProductStore, folder: Path, options: SiteOptions) -> Made:
    del options
    copyfile(store.path("textured_glb"), folder / "textured.glb")
    return Made(_triangles(folder / "textured.glb"), "triangles", "With its photographs.")


def _surface(store: ProductStore, folder: Path, options: SiteOptions) -> Made:
    del options
    copyfile(store.path("surface_glb"), folder / "surface.glb")
    told = "Colours at its corners; says what was measured and what filled in."
    return Made(_triangles(folder / "surface.glb"), "triangles", told)


def _triangles(path: Path) -> int:
    from workbench.formats.glb_container import read_glb_description

    told = read_glb_description(path)
    parts = [part for mesh in told["meshes"] for part in mesh["primitives"]]
    return sum(int(told["accessors"][part["indices"]]["count"]) // 3 for part in parts)


REPRESENTATIONS = (
    Representation(
        "textured", "mesh", "Textured surface", "textured.glb", ("textured_glb",),
        "photographs have not textured it: workbench texture, then export", _textured,
    ),
    Representation(
        "surface", "mesh", "Surface", "surface.glb", ("surface_glb",),
        "it was not exported: workbench export with export.glb", _surface,
    ),
)  # fmt: skip
"""All forms, the first that is there is shown first."""
