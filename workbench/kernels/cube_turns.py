"""The 48 ways a cube falls onto itself, as what they do to its eight octants.

Turns 0 … 7 mirror along the axes of their bits (x is bit 0); the others permute the axes
first. ``TURNED[g, c]`` is where turn g takes octant c = x + 2 y + 4 z, ``SLOT[g, c]`` which
octant it takes to c, ``COMPOSED[g, h]`` the turn that does h and then g, and ``INVERSE[g]``
the one that undoes g. ``TURNED_MASK[g, m]`` is what turn g makes of a mask of octants.
"""

from __future__ import annotations

import itertools

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

MIRRORS, TURNS = 8, 48


def _turned() -> NDArray[np.int8]:
    octants = np.arange(8)
    rows = []
    for axes in itertools.permutations(range(3)):
        permuted = sum((octants >> axis & 1) << place for place, axis in enumerate(axes))
        rows += [permuted ^ mirror for mirror in range(MIRRORS)]
    return np.array(rows, np.int8)


def _composed() -> NDArray[np.int8]:
    number = {tuple(row): g for g, row in enumerate(TURNED.tolist())}
    return np.array([[number[tuple(g[h].tolist())] for h in TURNED] for g in TURNED], np.int8)


TURNED = _turned()
SLOT = np.argsort(TURNED, axis=1).astype(np.int8)
COMPOSED = _composed()
INVERSE = np.argmin(COMPOSED, axis=1).astype(np.int8)
TURNED_MASK = np.packbits(
    (np.arange(256)[:, None] >> SLOT[:, None, :]) & 1, axis=-1, bitorder="little"
)[..., 0]


@njit(cache=True, nogil=True)
def turned_mask(mask: int, turn: int) -> int:
    """The 2³ voxels of ``mask``, a bit each, after a turn."""
    turned: int = int64(TURNED_MASK[turn, mask])
    return turned
