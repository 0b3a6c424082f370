"""From a labelled mesh to a textured one: patches, levelling, atlas."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.texturing.atlas import empty_atlas
from workbench.texturing.atlas_pictures import draw, finish
from workbench.texturing.packing import Sides
from workbench.texturing.patches import patches_of
from workbench.texturing.seam_blending import blend_seams, seam_colors
from workbench.texturing.seam_levelling import Levelling, levelled
from workbench.texturing.seams import ColorStep, color_step, colors_along, seams_of

Levels = Literal["none", "global", "global-and-local"]
_SHARES = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True)
class AtlasOptions:
    """How a texture is made.

    Attributes
    ----------
    levels : what is done about seams: nothing, smooth offsets over the mesh, or these and a
        blend of what they leave over a strip along the seams.
    stiffness, anchor : of the offsets; see `levelled`.
    strip : width of the blend in texels.
    padding : texels by which patches go on beyond their borders.
    largest, sides : of pages; see `packed`.
    """

    levels: Levels = "global-and-local"
    stiffness: float = 0.1
    anchor: float = 20.0
    strip: int = 20
    padding: int = 4
    largest: int = 8192
    sides: Sides = "tight"

    def __post_init__(self) -> None:
        for name, good, what in (
            ("stiffness", np.isfinite(self.stiffness) and self.stiffness > 0.0, "above 0"),
            ("anchor", np.isfinite(self.anchor) and self.anchor > 0.0, "above 0"),
            ("strip", self.strip >= 1, "1 or more"),
            ("padding", 0 <= self.padding <= 64, "from 0 to 64"),
            ("largest", 64 <= self.largest <= 16384, "from 64 to 16384"),
        ):
            if not good:
                raise InputError(
                    f"the option {name} of a texture is out of its range",
                    expected=what, found=str(getattr(self, name)),
                )  # fmt: skip


@dataclass(frozen=True)
class TextureReport:
    """What became of a mesh.

    Attributes
    ----------
    patches, bare_patches : how many, and how many of them without a photograph.
    page_sizes : width and height of each.
    utilisation : share of their texels that triangles cover.
    before, after : visibility of the seams between photographs, as the pictures show them and as
        the finished pages do.
    levelling : None where none was wanted.
    """

    patches: int
    bare_patches: int
    page_sizes: tuple[tuple[int, int], ...]
    utilisation: float
    before: ColorStep
    after: ColorStep
    levelling: Levelling | None


def textured(
    labelled: LabelledMesh,
    cameras: Mapping[int, PhotoCamera],
    pictures: Callable[[int], NDArray[np.uint8]],
    options: AtlasOptions | None = None,
) -> tuple[TexturedMesh, TextureReport]:
    """Texture a labelled mesh with the pixels of its photographs.

    Parameters
    ----------
    labelled : its mesh has the vertex attribute ``color`` (n, 3) uint8.
    cameras : of the photographs by their numbers, of their pictures' sizes.
    pictures : from a photograph's number to its texture picture (h, w, 4) uint8.

    Raises
    ------
    InputError : the mesh has no triangles or no colours, or its labels do not fit the cameras.
    """
    options = options or AtlasOptions()
    mesh = labelled.mesh
    if not len(mesh.triangles) or "color" not in mesh.vertex_attributes:
        raise InputError(
            "a mesh to be textured must have triangles, and colours at its vertices",
            found=f"{len(mesh.triangles)} triangles, {', '.join(mesh.vertex_attributes) or 'none'}",
            fix="run the stages that make the surface and colour it",
        )
    patches = patches_of(labelled, cameras, padding=options.padding, largest=options.largest)
    seams = seams_of(labelled, patches)
    colors = colors_along(seams, labelled, patches, pictures, _SHARES)
    labels = patches.labels[patches.patch_of]
    between = (labels[seams.rows] != NO_PHOTO).all(axis=1)
    levelling = None
    offsets = np.zeros((len(labels), 3, 3), np.float32)
    if options.levels != "none":
        levelling = levelled(
            labelled, patches, seams, colors, _SHARES, options.stiffness, options.anchor
        )
        offsets = levelling.offsets
    atlas = empty_atlas(patches, options.largest, options.sides)
    draw(atlas, mesh, pictures, offsets)
    if options.levels == "global-and-local":
        blend_seams(atlas, seams, options.strip)
    finish(atlas, options.padding)
    drawn = seams.where(between)
    return atlas.textured(mesh), TextureReport(
        patches.count,
        int((patches.labels == NO_PHOTO).sum()),
        atlas.packing.sizes,
        atlas.utilisation,
        color_step(colors[between], drawn.lengths),
        color_step(seam_colors(atlas, drawn, _SHARES), drawn.lengths),
        levelling,
    )
