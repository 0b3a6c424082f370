"""Rays in tiles of tiles: the quarters of quarters of a list in which neighbours are near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.morton import morton_codes


@dataclass(frozen=True)
class RayTiles:
    """The tiles; the root, of all rays, first.

    Attributes
    ----------
    slices : (t, 2) int64, the first ray of each and the one behind its last.
    quarters : (t,) int32, the first of four children in a row; −1 for none.
    shares : (t,) float32 of all rays.
    """

    slices: NDArray[np.int64]
    quarters: NDArray[np.int32]
    shares: NDArray[np.float32]


def ray_tiles(count: int, smallest: int) -> RayTiles:
    """Divide ``count`` rays until tiles hold no more than ``smallest``."""
    levels = [np.array([[0, count]], np.int64)]
    quarters = []
    made = 1
    while True:
        slices = levels[-1]
        divided = slices[:, 1] - slices[:, 0] > smallest
        first = np.full(len(slices), -1, np.int32)
        first[divided] = made + 4 * np.arange(divided.sum())
        quarters.append(first)
        if not divided.any():
            break
        begin, end = slices[divided].T
        cuts = begin[:, None] + (end - begin)[:, None] * np.arange(5) // 4
        levels.append(np.stack([cuts[:, :-1], cuts[:, 1:]], axis=-1).reshape(-1, 2))
        made += len(levels[-1])
    tiles = np.concatenate(levels)
    shares = (tiles[:, 1] - tiles[:, 0]) / max(count, 1)
    return RayTiles(tiles, np.concatenate(quarters), shares.astype(np.float32))


def picture_order(width: int, height: int) -> NDArray[np.int64]:
    """(width · height,) pixels, rows first, in an order in which quarters are near squares."""
    rows, columns = np.divmod(np.arange(width * height), width)
    cells = np.stack([columns, rows, np.zeros_like(rows)], axis=1)
    return np.argsort(morton_codes(cells), kind="stable")
