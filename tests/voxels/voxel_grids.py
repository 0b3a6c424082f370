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


def images_of(full: NDArray[np.bool_], *, turned: bool) -> list[NDArray[np.bool_]]:
    """A grid mirrored along its axes in all 8 ways, or turned as well in all 48."""
    orders = itertools.permutations(range(3)) if turned else [(0, 1, 2)]
    return [full.transpose(order)[::a, ::b, ::c] for order in orders for a, b, c in FLIPS]


def distinct_subtrees(full: NDArray[np.bool_], order: int) -> int:
    """Non-empty aligned blocks of 2³ voxels and more that are no images of one another.

    ``order`` is 1 for blocks that are equal, 8 for mirror images, 48 for turned ones, too.
    """
    side, count = len(full), 0
    while side >= 2:
        kinds = set()
        for corner in itertools.product(range(0, len(full), side), repeat=3):
            block = full[tuple(slice(c, c + side) for c in corner)]
            if block.any():
                images = images_of(block, turned=order == 48) if order > 1 else [block]
                kinds.add(min(image.tobytes() for image in images))
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
        block = kinds[rng.integers(3)].transpose(rng.permutation(3))[::a, ::b, ::c]
        full[tuple(slice(k, k + small) for k in corner)] = block
    return full
