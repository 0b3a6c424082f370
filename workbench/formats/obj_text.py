"""The text of OBJ files, some rows at a time: as a whole it takes ten times its arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ROWS = 1 << 14


def obj_origin(world_from_local_origin: Sequence[float] | NDArray[np.float64]) -> bytes:
    """The comment that tells where (3,) the zero of the coordinates lies in the world."""
    numbers = " ".join(repr(float(value)) for value in world_from_local_origin)
    return f"# world_from_local_origin {numbers}\n".encode()


def obj_rows(line: str, *arrays: NDArray[Any]) -> Iterator[bytes]:
    """A line for every row of arrays (n, k) side by side; it has a ``%`` for each column."""
    for start in range(0, len(arrays[0]), _ROWS):
        # Columns, not rows: thousands of small lists would keep the garbage collector busy.
        columns = [column for array in arrays for column in array[start : start + _ROWS].T.tolist()]
        values = chain.from_iterable(zip(*columns, strict=True))
        yield (f"{line}\n" * len(columns[0]) % tuple(values)).encode()


def obj_faces(corner: str, triangles: NDArray[np.int32]) -> Iterator[bytes]:
    """``f`` of every triangle (n, 3); its corners name what belongs to them, ``%d//%d``."""
    times = corner.count("%d")
    for start in range(0, len(triangles), _ROWS):
        numbers = np.repeat(triangles[start : start + _ROWS] + 1, times, axis=1)
        yield from obj_rows(f"f {corner} {corner} {corner}", numbers)
