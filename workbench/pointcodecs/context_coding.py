"""Cubes of points as an octree, every bit of it in the light of its neighbours.

The tree is written level by level: which children the occupied cells of a level have. Each of
these bits goes through a binary arithmetic coder with the chance that five adaptive contexts
give it together (`workbench.kernels.cell_contexts`). On a surface most bits are near certain
from the neighbours that are known, so that a point costs less than a bit.

A cube can be read alone: the contexts start from what two spheres teach, one of all cells that
it touches and one of those whose crosses it passes, held so loosely that a cube of anything
else soon has its own. Without them, scans at 512³ took 2 to 6 % more. Cubes are large, 256
positions a side, for learning to cost little.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.adaptive_bits import (
    AT,
    finish_writing,
    new_chances,
    new_coder,
    new_weights,
    open_minded,
    start_reading,
    was_read_whole,
)
from workbench.kernels.cell_contexts import (
    CHANCES,
    WEIGHT_SETS,
    code_level,
    new_bitmap,
    set_cells,
)
from workbench.kernels.point_cubes import LEFT_OVER, SOUND, WRONG_COUNT

_TAUGHT_LEVEL, _TAUGHT_MEETINGS = 7, 2


def encode_contexts(
    points: NDArray[np.int32], starts: NDArray[np.int64], level: int
) -> list[NDArray[np.uint8]]:
    """Bytes of each cube; points (n, 3) of a cube in the order of z, y, x, x fastest."""
    return [_encoded_cube(points[begin:end], level) for begin, end in pairwise(starts)]


def decode_contexts(
    data: NDArray[np.uint8],
    bytes_at: NDArray[np.int64],
    starts: NDArray[np.int64],
    level: int,
    points: NDArray[np.int32],
    status: NDArray[np.int64],
) -> None:
    """Read what `encode_contexts` wrote.

    The parameters are those of `workbench.kernels.point_cubes.decode_cells`.
    """
    for cube in range(len(starts) - 1):
        part = data[bytes_at[cube] : bytes_at[cube + 1]]
        begin, end = int(starts[cube]), int(starts[cube + 1])
        status[cube] = SOUND
        if begin == end:
            status[cube] = LEFT_OVER if len(part) else SOUND
            continue
        coder = new_coder(reading=True)
        start_reading(coder, part)
        chances = _taught_chances().copy()
        found = _walk(coder, part, chances, level, end - begin, _nothing_wanted)
        if found is None or len(found) != end - begin:
            status[cube] = WRONG_COUNT
        elif not was_read_whole(coder, part):
            status[cube] = LEFT_OVER
        else:
            points[begin:end] = found


def _encoded_cube(points: NDArray[np.int32], level: int) -> NDArray[np.uint8]:
    if not len(points):
        return np.zeros(0, np.uint8)

    wanted = _bitmaps_of(points, level)
    room = 2 * len(points) + 64
    while True:
        data = np.zeros(room, np.uint8)
        coder = new_coder(reading=False)
        _walk(coder, data, _taught_chances().copy(), level, len(points), wanted)
        size = finish_writing(coder, data)
        if size >= 0:
            return data[: max(size, 1)].copy()
        # The coder ran on without room, and tells how much it would have taken.
        room = int(coder[AT]) + 4


def _bitmaps_of(points: NDArray[np.int32], level: int) -> Callable[[int], NDArray[np.uint8]]:
    """From the side of a level to the bitmap of the cells that points occupy there."""

    def wanted(side: int) -> NDArray[np.uint8]:
        bitmap = new_bitmap(side)
        set_cells(bitmap, side, points // ((1 << level) // side))
        return bitmap

    return wanted


def _nothing_wanted(side: int) -> NDArray[np.uint8]:
    del side
    return np.zeros(0, np.uint8)


@lru_cache(maxsize=1)
def _taught_chances() -> NDArray[np.uint32]:
    """Contexts that have met two spheres; whole numbers alone, as all that a stream needs."""
    chances = new_chances(CHANCES)
    for points in _spheres():
        wanted = _bitmaps_of(points, _TAUGHT_LEVEL)
        nowhere = np.zeros(0, np.uint8)
        _walk(new_coder(reading=False), nowhere, chances, _TAUGHT_LEVEL, len(points), wanted)
    return open_minded(chances, _TAUGHT_MEETINGS)


def _spheres() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Cells that a sphere touches, and those in which it crosses a line between two faces."""
    side = 1 << _TAUGHT_LEVEL
    # Twice the distance of middles of cells from the sphere's, which lies beside that of the cube.
    twice = [np.abs(2 * np.arange(side, dtype=np.int32) - side + k) for k in range(3)]
    middle = [t**2 for t in twice]
    near, far = [np.maximum(t - 1, 0) ** 2 for t in twice], [(t + 1) ** 2 for t in twice]
    radius = (side - 7) ** 2

    def inside(
        x: NDArray[np.int32], y: NDArray[np.int32], z: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        return np.asarray(x[:, None, None] + y[:, None] + z < radius)

    crossed = np.zeros((side, side, side), np.bool_)
    for axis in range(3):
        first = [near[k] if k == axis else middle[k] for k in range(3)]
        last = [far[k] if k == axis else middle[k] for k in range(3)]
        crossed |= inside(*first) & ~inside(*last)
    touched = inside(*near) & ~inside(*far)
    return np.argwhere(touched).astype(np.int32), np.argwhere(crossed).astype(np.int32)


def _walk(
    coder: NDArray[np.int64],
    data: NDArray[np.uint8],
    chances: NDArray[np.uint32],
    level: int,
    most: int,
    wanted: Callable[[int], NDArray[np.uint8]],
) -> NDArray[np.int32] | None:
    """The cells of the last level, or None where a level has more than ``most``."""
    weights = new_weights(WEIGHT_SETS)
    cells, count = np.zeros((1, 3), np.int32), 1
    bitmap = new_bitmap(1)
    set_cells(bitmap, 1, cells)
    for depth in range(1, level + 1):
        side = 1 << depth
        finer, children = new_bitmap(side), np.empty((min(most, side**3), 3), np.int32)
        count = code_level(
            coder, data, chances, weights, cells, count, bitmap, side, wanted(side), finer, children
        )
        if count < 0:
            return None
        cells, bitmap = children, finer
    return cells[:count]
