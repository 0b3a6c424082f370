"""From voxels to a graph in which equal subtrees are one (Jaspe 2018, 5.4.1 and 5.4.2).

The octree itself is never built whole: voxels come in parts, each part is reduced bottom-up,
and its nodes join those of the parts before. What is kept grows with the graph, not with the
voxels, and a node is numbered where it first appears in Morton order, so that the graph does
not depend on how the voxels were parted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.dag_rows import (
    NO_CHILD,
    TURN_BITS,
    enter_rows,
    fill_table,
    node_parents,
    parent_count,
    voxel_parents,
)
from workbench.voxels.voxel_dag import VoxelDag, checked_level

_FIRST_ROOM = 1 << 10
_MOST_NODES = (1 << 26) - 1
VOXELS_AT_ONCE = 1 << 24


class DistinctRows:
    """Rows of eight words, each kept once, numbered in the order they came."""

    def __init__(self) -> None:
        self._kept = np.empty((_FIRST_ROOM, 8), np.uint32)
        self._table = np.zeros(4 * _FIRST_ROOM, np.uint32)
        self._count = 0

    @property
    def rows(self) -> NDArray[np.uint32]:
        """(n, 8) what was kept."""
        return self._kept[: self._count].copy()

    def places_of(self, rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """The place of each row (n, 8); those not seen before are kept."""
        places = np.empty(len(rows), np.uint32)
        # Few rows are new as a rule: room is made for some at a time, not for all at once.
        step = max(_FIRST_ROOM, len(self._kept) // 2)
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            self._make_room(len(rows[part]))
            self._count = enter_rows(rows[part], self._kept, self._count, self._table, places[part])
        return places

    def _make_room(self, more: int) -> None:
        if self._count + more <= len(self._kept):
            return
        room = 2 * len(self._kept)
        while room < self._count + more:
            room *= 2
        if self._count + more > _MOST_NODES:
            raise InputError(
                "The voxels need more nodes of one size than a graph can number.",
                found=f"more than {_MOST_NODES:,}",
                fix="Choose a lower resolution.",
            )
        kept = np.empty((room, 8), np.uint32)
        kept[: self._count] = self._kept[: self._count]
        self._kept = kept
        self._table = np.zeros(4 * room, np.uint32)
        fill_table(kept, self._count, self._table)


def reduced_dag(codes: NDArray[np.uint64], level: int, at_once: int = VOXELS_AT_ONCE) -> VoxelDag:
    """The graph of voxels at hand in which equal subtrees are one.

    Parameters
    ----------
    codes
        (n,) uint64 Morton codes, ascending, each once.
    level
        Depth of the voxels, 2 … 21.
    at_once
        Voxels to reduce at a time, where a part of the octree can be that small; the result
        does not depend on it.

    Raises
    ------
    InputError
        The level is out of its bounds, or the codes are unsorted, repeated or too large.
    """
    split = split_depth(codes, checked_level(level), at_once)
    return reduced_parts(subtree_parts(codes, level, split, at_once), level, split)


def reduced_parts(parts: Iterable[NDArray[np.uint64]], level: int, split: int) -> VoxelDag:
    """The graph of voxels that come part by part.

    Parameters
    ----------
    parts
        Each (n,) uint64 Morton codes, ascending; parts follow one another in that order, and
        the voxels below one node of depth ``split`` are all in one part.
    level
        Depth of the voxels, 2 … 21.
    split
        The depth up to which a part is reduced alone, 0 … ``level − 2``.

    Raises
    ------
    InputError
        The level is out of its bounds, or the codes are unsorted, repeated or too large.
    """
    checked_level(level)
    distinct = [DistinctRows() for _ in range(level - 1)]
    tops: list[tuple[NDArray[np.uint64], NDArray[np.uint32]]] = []
    last = -1
    for part in parts:
        if not len(part):
            continue
        last = _checked_part(part, level, split, last)
        tops.append(_raised(*_bricks(part, distinct[-1]), distinct, level - 2, split))
    if not tops:
        return VoxelDag(level, tuple(np.empty((0, 8), np.uint32) for _ in distinct), int(NO_CHILD))
    codes = np.concatenate([top[0] for top in tops])
    words = np.concatenate([top[1] for top in tops])
    _, root = _raised(codes, words, distinct, split, 0)
    return VoxelDag(level, tuple(rows.rows for rows in distinct), int(root[0]))


def split_depth(codes: NDArray[np.uint64], level: int, at_once: int) -> int:
    """The least depth at which no node has more than ``at_once`` voxels, or that of bricks."""
    for depth in range(level - 2):
        starts = _subtree_starts(codes, level, depth)
        if np.diff(np.append(starts, len(codes))).max(initial=0) <= at_once:
            return depth
    return level - 2


def subtree_parts(
    codes: NDArray[np.uint64], level: int, split: int, at_once: int
) -> Iterator[NDArray[np.uint64]]:
    """Whole subtrees of depth ``split`` in parts of at most ``at_once`` voxels, if they can be."""
    starts = np.append(_subtree_starts(codes, level, split), len(codes))
    first = 0
    while first < len(starts) - 1:
        last = int(np.searchsorted(starts, starts[first] + at_once, "right")) - 1
        last = max(last, first + 1)
        yield codes[starts[first] : starts[last]]
        first = last


def _subtree_starts(codes: NDArray[np.uint64], level: int, depth: int) -> NDArray[np.int64]:
    """Where in ``codes`` the nodes of ``depth`` begin; found by halving, not by a pass."""
    starts, at = [], 0
    shift = 3 * (level - depth)
    while at < len(codes):
        starts.append(at)
        after = ((int(codes[at]) >> shift) + 1) << shift
        at = (
            int(np.searchsorted(codes, np.uint64(after), "left")) if after < 1 << 64 else len(codes)
        )
    return np.array(starts, np.int64)


def _checked_part(part: NDArray[np.uint64], level: int, split: int, last: int) -> int:
    """The part's last code, once it is known to be in order and after the ``last`` before."""
    shift = 3 * (level - split)
    apart = last < 0 or int(part[0]) >> shift > last >> shift
    if not apart or not np.all(part[1:] > part[:-1]) or int(part[-1]) >> 3 * level:
        raise InputError(
            "Voxels are not in the order that a graph is built in.",
            expected=f"ascending Morton codes below 8^{level}, each once, in whole subtrees",
            found="other codes",
            fix="Sort the codes and drop the repeated ones.",
        )
    return int(part[-1])


def _bricks(
    codes: NDArray[np.uint64], distinct: DistinctRows
) -> tuple[NDArray[np.uint64], NDArray[np.uint32]]:
    """Codes and words of the 4³ bricks that hold the voxels."""
    count = parent_count(codes)
    parents, masks = np.empty(count, np.uint64), np.empty(count, np.uint8)
    voxel_parents(codes, parents, masks)
    return _parents(parents, masks.astype(np.uint32) << np.uint32(TURN_BITS), distinct)


def _parents(
    codes: NDArray[np.uint64], words: NDArray[np.uint32], distinct: DistinctRows
) -> tuple[NDArray[np.uint64], NDArray[np.uint32]]:
    count = parent_count(codes)
    parents, rows = np.empty(count, np.uint64), np.empty((count, 8), np.uint32)
    node_parents(codes, words, parents, rows)
    return parents, distinct.places_of(rows) << np.uint32(TURN_BITS)


def _raised(
    codes: NDArray[np.uint64],
    words: NDArray[np.uint32],
    distinct: list[DistinctRows],
    depth: int,
    top: int,
) -> tuple[NDArray[np.uint64], NDArray[np.uint32]]:
    """Codes and words of the nodes of depth ``top`` above those of ``depth``."""
    for above in range(depth - 1, top - 1, -1):
        codes, words = _parents(codes, words, distinct[above])
    return codes, words
