"""Winners of cells against a plain search."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.kernels.cell_winners import cell_codes, winning_levels
from workbench.kernels.morton import morton_codes


def plain_levels(cells: np.ndarray, bits: int, coarsest: int) -> np.ndarray:
    """Cells (n, 3) in Morton order."""
    levels = np.full(len(cells), bits + 1)
    alive = list(range(len(cells)))
    for level in range(bits, coarsest - 1, -1):
        size = 1 << (bits - level)
        groups: dict[tuple[int, ...], list[int]] = {}
        for i in alive:
            groups.setdefault(tuple(cells[i] // size), []).append(i)
        alive = []
        for group in groups.values():
            middle = (cells[group] // size + 0.5) * size
            alive.append(group[np.argmin(((cells[group] + 0.5 - middle) ** 2).sum(axis=1))])
        levels[alive] = level
        alive.sort()
    return levels


@pytest.mark.parametrize(("bits", "coarsest", "n"), [(3, 0, 300), (5, 2, 400), (21, 0, 60)])
def test_winners(bits: int, coarsest: int, n: int) -> None:
    random = np.random.default_rng(bits)
    cells = random.integers(0, 1 << bits, (n, 3))
    cells[: n // 3] = cells[n // 3 : 2 * (n // 3)]
    codes = morton_codes(cells)
    order = np.argsort(codes, kind="stable")
    levels = np.empty(n, np.int8)
    winning_levels(codes[order], bits, coarsest, levels)
    np.testing.assert_array_equal(levels, plain_levels(cells[order], bits, coarsest))


def test_codes_of_a_node() -> None:
    """Cells of a cube whose side is no power of two, by fractions of whole numbers."""
    random = np.random.default_rng(3)
    side, low, level, bits = 1000, np.array([-50, 7, 2**31 - 1100]), 3, 4
    away = random.integers(0, side, (5000, 3))
    whole = (low + away).astype(np.int32)
    finest = away * 2 ** (level + bits) // side
    corner = np.array([2, 5, 7])
    inside = (finest >> bits == corner).all(axis=1)
    codes = np.empty(int(inside.sum()), np.uint64)
    assert cell_codes(whole[inside], low, side, level, corner, bits, codes) == 0
    np.testing.assert_array_equal(codes, morton_codes(finest[inside] - (corner << bits)))
    codes = np.empty(len(whole), np.uint64)
    outside = cell_codes(whole, low, side, level, corner, bits, codes)
    assert outside == (~inside).sum() > 0
