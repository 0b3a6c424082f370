"""A texture atlas: patches on pages, and where each vertex lies on them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.kernels.patch_drawing import COVERED, SUBTEXELS
from workbench.texturing.packing import Packing, Sides, packed
from workbench.texturing.patches import Patches


@dataclass(frozen=True)
class Atlas:
    """Patches and pages; the pages are empty until `atlas_pictures` draws on them.

    Attributes
    ----------
    patches, packing : what is where.
    pages : (h, w, 3) uint8 each, sRGB-encoded.
    states : (h, w) uint8 each: what a texel is, by `patch_drawing`.
    """

    patches: Patches
    packing: Packing
    pages: tuple[NDArray[np.uint8], ...] = field(repr=False)
    states: tuple[NDArray[np.uint8], ...] = field(repr=False)

    @property
    def utilisation(self) -> float:
        """Share of the pages' texels that triangles cover."""
        covered = sum(int((state == COVERED).sum()) for state in self.states)
        return covered / max(1, sum(state.size for state in self.states))

    def corners_on_pages(self) -> NDArray[np.float64]:
        """(m, 3, 2) right and down on their pages, texels, triangles in the patches' order."""
        moved = self.packing.places - self.patches.rects[:, :2]
        return np.asarray(self.patches.corners / SUBTEXELS + moved[self.patches.patch_of][:, None])

    def textured(self, mesh: TriangleMesh) -> TexturedMesh:
        """The mesh the patches were cut from, its vertices once for each patch they are on."""
        patches = self.patches
        corners = mesh.triangles[patches.triangles].astype(np.int64)
        names = corners + len(mesh.vertices) * patches.patch_of[:, None]
        unique, first, place = np.unique(names, return_index=True, return_inverse=True)
        vertices = unique % max(1, len(mesh.vertices))
        # Back in the mesh's own order, which is kinder to caches than that of the patches.
        triangles = np.empty((len(corners), 3), np.int32)
        pages = np.empty(len(corners), np.int32)
        triangles[patches.triangles] = place.reshape(-1, 3)
        page = self.packing.pages[patches.patch_of]
        pages[patches.triangles] = page
        sizes = np.array(self.packing.sizes, np.float64).reshape(-1, 2)
        at = self.corners_on_pages().reshape(-1, 2)[first] / sizes[page[first // 3]]
        attributes = {name: values[vertices] for name, values in mesh.vertex_attributes.items()}
        split = TriangleMesh(mesh.vertices[vertices], triangles, attributes)
        return TexturedMesh(split, at, pages, self.pages)


def empty_atlas(patches: Patches, largest: int = 8192, sides: Sides = "tight") -> Atlas:
    """Pages with room for the patches; see `packed`."""
    packing = packed(patches.rects[:, 2:], largest, sides)
    pages = tuple(np.zeros((height, width, 3), np.uint8) for width, height in packing.sizes)
    states = tuple(np.zeros((height, width), np.uint8) for width, height in packing.sizes)
    return Atlas(patches, packing, pages, states)
