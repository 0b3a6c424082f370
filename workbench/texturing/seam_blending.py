"""Seam levelling close by: what is left of a step fades out over a strip along the seam.

Both sides go half the way, and the harmonic movement between seam and strip's end keeps each
photograph's own detail: it is the Poisson blending of the strip with the photograph's gradients.

Source: Waechter, Moehrle, Goesele 2014, section 4.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.kernels.patch_drawing import read_between
from workbench.kernels.seam_strips import fade_steps
from workbench.texturing.atlas import Atlas
from workbench.texturing.seams import Seams, places_along

_SWEEPS = 40


def blend_seams(atlas: Atlas, seams: Seams, reach: int = 20) -> None:
    """Blend the seams of an atlas that is drawn and not yet finished.

    Beside a photograph, what none shows moves all the way: it is a guess.

    Parameters
    ----------
    seams : of the mesh the atlas was made for.
    reach : width of the strip in texels.
    """
    if not seams.count:
        return
    places, rows = _samples(atlas, seams)
    patches = atlas.patches.patch_of[rows]
    pages = atlas.packing.pages[patches]
    colors = np.empty((len(rows), 2, 3), np.float32)
    for page, picture in enumerate(atlas.pages):
        there = pages == page
        colors[there] = read_between(picture, places[there])
    shown = atlas.patches.labels[patches] != NO_PHOTO
    half = 0.5 * (colors[:, ::-1] - colors) * (1.0 + (~shown & shown[:, ::-1]))[..., None]
    # A photograph does not move towards a guess.
    moved = shown == shown[:, ::-1]
    moved |= ~shown
    at, step, patch = places[moved], half[moved].astype(np.float32), patches[moved]
    order = np.argsort(patch, kind="stable")
    at, step = at[order], step[order]
    ids, first = np.unique(patch[order], return_index=True)
    for p, start, end in zip(ids, first, [*first[1:], len(order)], strict=True):
        page = atlas.packing.pages[p]
        fade_steps(
            atlas.pages[page], atlas.states[page],
            tuple(atlas.packing.places[p].tolist()), tuple(atlas.patches.rects[p, 2:].tolist()),
            at[start:end], step[start:end], reach, _SWEEPS,
        )  # fmt: skip


def seam_colors(atlas: Atlas, seams: Seams, shares: NDArray[np.float64]) -> NDArray[np.float32]:
    """(e, 2, s, 3) colours of 255 on both sides of seams, as drawing with the atlas reads them."""
    places = places_along(seams, atlas.corners_on_pages(), shares)
    pages = atlas.packing.pages[atlas.patches.patch_of[seams.rows]]
    colors = np.empty((*places.shape[:3], 3), np.float32)
    for page, picture in enumerate(atlas.pages):
        there = pages == page
        read = read_between(picture, places[there].reshape(-1, 2))
        colors[there] = read.reshape(-1, len(shares), 3)
    return colors


def _samples(atlas: Atlas, seams: Seams) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Places (n, 2, 2) on both sides, about a texel apart, and the rows (n, 2) of triangles."""
    corners = atlas.corners_on_pages()
    ends = corners[seams.rows[:, :, None], seams.corners]
    texels = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1)
    count = np.ceil(texels).astype(np.int64) + 1
    edge = np.repeat(np.arange(seams.count), count)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = (place / np.maximum(count - 1, 1)[edge])[:, None, None]
    return ends[edge, :, 0] * (1.0 - share) + ends[edge, :, 1] * share, seams.rows[edge]
