"""Levelling textures of a sequence of views, averaged over time so that they do not flicker.

Source: Arikan et al., section 6.2, after Scherzer et al. 2007.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.render.stitch.stitching import Fragments

NEW_SHARE = 0.4
# So much of the surroundings in the view before must show the same place.
_LEAST_KNOWN = 0.25


@dataclass(frozen=True)
class LevelledFrame:
    """A view of a sequence.

    Attributes
    ----------
    shown : what it shows.
    change : (h, w, 3) float32 the levelling texture that was applied.
    """

    shown: Fragments
    change: NDArray[np.float32]


def smoothed(
    change: NDArray[np.float32],
    shown: Fragments,
    before: LevelledFrame,
    new_share: float = NEW_SHARE,
) -> NDArray[np.float32]:
    """A levelling texture averaged with that of the view before.

    Every place is looked up where the view before showed it; between its pixels linearly, those
    that show something else left out. What is new, or was hidden, keeps its value.

    Parameters
    ----------
    change : (h, w, 3) of this view.
    shown : what it shows.
    before : the view before, of any camera and size.
    new_share : of this view's value (table 3: 0.4).

    Raises
    ------
    InputError : the share is not in [0, 1].
    """
    if not 0.0 <= new_share <= 1.0:
        raise InputError("shares are in [0, 1]", found=str(new_share))
    at = np.flatnonzero(shown.seen)
    pixels, depths = before.shown.camera.project(shown.position.reshape(-1, 3)[at])
    height, width = before.shown.depth.shape
    old = np.zeros((len(at), 3))
    known = np.zeros(len(at))
    pixels = np.where(np.isfinite(pixels), pixels, -2.0)
    corner = np.floor(pixels - 0.5)
    share = pixels - 0.5 - corner
    for down in (0, 1):
        for across in (0, 1):
            column, row = corner[:, 0] + across, corner[:, 1] + down
            inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            c, r = (np.where(inside, k, 0).astype(np.intp) for k in (column, row))
            same = inside & (np.abs(before.shown.depth[r, c] - depths) <= before.shown.epsilon)
            weight = (share[:, 0] if across else 1.0 - share[:, 0]) * same
            weight = weight * (share[:, 1] if down else 1.0 - share[:, 1])
            old += weight[:, None] * before.change[r, c]
            known += weight
    out = change.copy()
    good = known >= _LEAST_KNOWN
    mean = old[good] / known[good, None]
    flat = out.reshape(-1, 3)
    flat[at[good]] = new_share * flat[at[good]] + (1.0 - new_share) * mean
    return out
