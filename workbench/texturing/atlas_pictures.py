"""What is drawn on an atlas: photographs' pixels as they are, moved by what levelling says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.patch_drawing import draw_patches, pad_patches
from workbench.kernels.seam_strips import fill_empty
from workbench.texturing.atlas import Atlas

# JPEG's blocks are 8 texels wide, or 16 for its colours.
_SQUARE = 16
_NO_PICTURE = np.zeros((0, 0, 4), np.uint8)


def draw(
    atlas: Atlas,
    mesh: TriangleMesh,
    pictures: Callable[[int], NDArray[np.uint8]],
    offsets: NDArray[np.float32],
) -> None:
    """Draw all patches; every photograph is asked for once for each page it is on.

    Parameters
    ----------
    mesh : its ``color`` shows where no photograph is.
    offsets : (m, 3, 3) by corner and channel of 255, in the patches' order.
    """
    patches, packing = atlas.patches, atlas.packing
    added = np.ascontiguousarray(offsets, np.float32).copy()
    bare = patches.labels[patches.patch_of] == NO_PHOTO
    colors = np.asarray(mesh.vertex_attributes["color"], np.float32)
    added[bare] += colors[mesh.triangles[patches.triangles[bare]]]
    for label in np.unique(patches.labels).tolist():
        picture = _NO_PICTURE if label == NO_PHOTO else pictures(label)
        for page in range(len(atlas.pages)):
            which = np.flatnonzero((patches.labels == label) & (packing.pages == page))
            if len(which):
                draw_patches(
                    atlas.pages[page], atlas.states[page], which, patches.starts,
                    patches.corners, patches.rects, packing.places, added, picture,
                )  # fmt: skip


def finish(atlas: Atlas, padding: int) -> None:
    """Continue the patches into their padding, and fill what is left."""
    for page in range(len(atlas.pages)):
        which = atlas.packing.pages == page
        pad_patches(
            atlas.pages[page], atlas.states[page],
            atlas.patches.rects[which], atlas.packing.places[which], padding,
        )  # fmt: skip
        fill_empty(atlas.pages[page], atlas.states[page], _SQUARE)
