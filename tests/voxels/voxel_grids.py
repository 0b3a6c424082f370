"""Voxel sets for tests of graphs, and what subtrees they have, found the slow way."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from workbench.kernels.morton import morton_codes

FLIPS = list(itertools.product((1, -1), repeat=3))


def codes_of(full: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Ascending Morton codes of the voxels of a grid indexed [x, y, z]."""
    return np.sort(morton_codes(np.argwhere(full)))


def distinct_subtrees(full: NDArray[np.bool_], *, mirrored: bool) -> int:
    """Non-empty aligned blocks of 2³ voxels and more that differ, also when flipped if so."""
    side, count = len(full), 0
    while side >= 2:
        kinds = set()
        for corner in itertools.product(range(0, len(full), side), repeat=3):
            block = full[tuple(slice(c, c + side) for c in corner)]
            if block.any():
                flips = FLIPS if mirrored else FLIPS[:1]
                kinds.add(min(block[::a, ::b, ::c].tobytes() for a, b, c in flips))
        count += len(kinds)
        side //= 2
    return count


@st.composite
def grids(draw: st.DrawFn, levels: tuple[int, ...] = (2, 3, 4)) -> NDArray[np.bool_]:
    """Grids from empty to full, of noise or of few kinds of blocks put down in all mirrors."""
    level = draw(st.sampled_from(levels))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    density = draw(st.sampled_from((0.0, 0.02, 0.3, 0.9, 1.0)))
    side = 1 << level
    if not draw(st.booleans()):
        return rng.random((side, side, side)) < density
    small = 2 ** draw(st.integers(0, level - 1))
    kinds = rng.random((3, small, small, small)) < density
    full = np.zeros((side, side, side), bool)
    for corner in itertools.product(range(0, side, small), repeat=3):
        a, b, c = FLIPS[rng.integers(8)]
        block = kinds[rng.integers(3)][::a, ::b, ::c]
        full[tuple(slice(k, k + small) for k in corner)] = block
    return full
