"""Octrees of points in bounded memory: what COPC and Potree files are made of.

Every point is in one node; nodes down to any level together are a part of the cloud that is
spread evenly. Built bottom up, like those of Untwine: subtrees that fit in memory first,
and each node takes one point out of every cell of its grid from its children. Here it is
the one nearest to the centre of the cell, so that the same points make the same tree,
whatever their batches and the memory.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError
from workbench.formats.point_rounding import Rounding
from workbench.formats.point_stream import BATCH_POINTS, PointStream
from workbench.geometry.point_set import PointSet
from workbench.kernels.morton import BITS_PER_AXIS, morton_cells
from workbench.kernels.octree_levels import cube_codes, leaf_levels, lift_to_parents

GRID_LEVEL = 7
"""A node has 2⁷ cells a side, as readers of COPC and Potree take for granted."""
LEAF_POINTS = 20_000
"""As many as a node of a surface has: leaves of a level are as dense as its other nodes."""
DEEPEST_LEVEL = BITS_PER_AXIS - GRID_LEVEL + 1
MEMORY_BYTES = 1 << 30

_SPLIT_LEVELS = 3
_WORKING_BYTES = 96
"""Per point, besides its row twice: code, order, level and what sorting needs."""

Key = tuple[int, int, int, int]
Rows = NDArray[np.void]


class NodeSink(Protocol):
    """Takes the nodes of a tree as they are done, in no order of levels."""

    def node(self, key: Key, rows: Rows) -> None:
        """Node ``(level, x, y, z)`` and its points, in Morton order."""
        ...


@dataclass
class PointOctree:
    """A tree: where its cube is, and how many points each node has.

    Attributes
    ----------
    corner : (3,) int64, the lowest corner of the root cube, in the integers of a `Rounding`.
    side : of the root cube, in such integers.
    counts : points by ``(level, x, y, z)``; nodes that passed all theirs on have none.
    """

    corner: NDArray[np.int64]
    side: int
    counts: dict[Key, int] = field(default_factory=dict)

    @property
    def levels(self) -> int:
        """Number of levels."""
        return 1 + max(key[0] for key in self.counts)

    def children(self, key: Key) -> Iterator[tuple[int, Key]]:
        """The nodes below one: z, y and x of the half they are in as bits 0, 1 and 2."""
        level, *cell = key
        for half in range(8):
            bits = (half >> 2 & 1, half >> 1 & 1, half & 1)
            x, y, z = (2 * c + bit for c, bit in zip(cell, bits, strict=True))
            if (level + 1, x, y, z) in self.counts:
                yield half, (level + 1, x, y, z)


def build_octree(
    stream: PointStream,
    rounding: Rounding,
    rows_of: Callable[[PointSet], Rows],
    sink: NodeSink,
    folder: Path,
    *,
    memory_bytes: int = MEMORY_BYTES,
    leaf_points: int = LEAF_POINTS,
) -> PointOctree:
    """Share the points of a stream out to nodes and hand each node to ``sink`` once.

    Parameters
    ----------
    stream
        The points.
    rounding
        How they became integers.
    rows_of
        Makes rows of points, structured, whose field ``whole`` has the integers (3,).
    sink
        What takes the nodes.
    folder
        Where rows are kept meanwhile, twice at most; files there have names of their own.
    memory_bytes
        Bound of the working memory, on top of one batch and the interpreter. More points than
        that at a single place are held nevertheless.
    leaf_points
        A node with more has children.

    Raises
    ------
    SettingsError
        ``memory_bytes`` is too little for one leaf.
    """
    whole = rounding.whole(np.stack([stream.low, stream.high])).astype(np.int64)
    tree = PointOctree(whole[0], int((whole[1] - whole[0]).max()) + 1)
    dtype = rows_of(next(stream.batches()).chosen(slice(0, 0))).dtype
    point_bytes = 2 * dtype.itemsize + _WORKING_BYTES
    most = memory_bytes // point_bytes
    if most < leaf_points:
        raise SettingsError(
            "Too little memory for a node of the octree.",
            expected=f"at least {leaf_points * point_bytes} bytes",
            found=str(memory_bytes),
            fix="Allow more memory.",
        )
    with tempfile.TemporaryDirectory(prefix=".octree-", dir=folder) as scratch:
        builder = _Builder(tree, sink, Path(scratch), dtype, most, leaf_points)
        batches = (rows_of(batch) for batch in stream.batches() if len(batch))
        rest = builder.subtree((0, 0, 0, 0), stream.count, batches)
        builder.hand_over(rest, 0)
    for key in list(tree.counts):
        level, x, y, z = key
        while level:
            level, x, y, z = level - 1, x >> 1, y >> 1, z >> 1
            tree.counts.setdefault((level, x, y, z), 0)
    return tree


class _Builder:
    """State of one build; ``most`` is how many points are in memory at once."""

    def __init__(
        self,
        tree: PointOctree,
        sink: NodeSink,
        folder: Path,
        dtype: np.dtype[Any],
        most: int,
        leaf_points: int,
    ) -> None:
        self._tree, self._sink, self._folder, self._dtype = tree, sink, folder, dtype
        self._most, self._leaf_points = most, leaf_points

    def subtree(self, key: Key, count: int, batches: Iterator[Rows]) -> Rows:
        """Hand over all nodes below one; returns the points of the node itself."""
        level = key[0]
        if count <= self._most or level >= DEEPEST_LEVEL:
            rows, codes = self._sorted(np.concatenate(list(batches)))
            levels = np.empty(len(rows), np.int8)
            leaf_levels(codes, level, DEEPEST_LEVEL, self._leaf_points, levels)
        else:
            parts, at = [], []
            for bucket, size, path in self._buckets(key, batches):
                parts.append(self.subtree(bucket, size, _rows_in(path, self._dtype)))
                at.append(np.full(len(parts[-1]), bucket[0], np.int8))
                path.unlink()
            joined, levels = np.concatenate(parts), np.concatenate(at)
            rows, codes, levels = self._sorted_with(joined, levels)
        whole = np.ascontiguousarray(rows["whole"])
        lift_to_parents(codes, whole, self._tree.corner, self._tree.side, GRID_LEVEL, level, levels)
        for lower in range(level + 1, int(levels.max()) + 1):
            chosen = np.flatnonzero(levels == lower)
            self._hand_over(rows[chosen], codes[chosen], lower)
        own: Rows = rows[levels == level]
        return own

    def hand_over(self, rows: Rows, level: int) -> None:
        """Give the nodes of one level to the sink; rows are in Morton order."""
        self._hand_over(rows, self._codes(rows), level)

    def _hand_over(self, rows: Rows, codes: NDArray[np.uint64], level: int) -> None:
        if not len(rows):
            return
        nodes = codes >> np.uint64(3 * (BITS_PER_AXIS - level))
        starts = np.flatnonzero(np.r_[True, nodes[1:] != nodes[:-1]])
        ends = np.r_[starts[1:], len(rows)]
        for (x, y, z), start, end in zip(
            morton_cells(nodes[starts]).tolist(), starts.tolist(), ends.tolist(), strict=True
        ):
            self._tree.counts[level, x, y, z] = end - start
            self._sink.node((level, x, y, z), rows[start:end])

    def _codes(self, rows: Rows) -> NDArray[np.uint64]:
        codes = np.empty(len(rows), np.uint64)
        cube_codes(np.ascontiguousarray(rows["whole"]), self._tree.corner, self._tree.side, codes)
        return codes

    def _sorted(self, rows: Rows) -> tuple[Rows, NDArray[np.uint64]]:
        codes = self._codes(rows)
        order = np.argsort(codes, kind="stable")
        return rows[order], codes[order]

    def _sorted_with(
        self, rows: Rows, levels: NDArray[np.int8]
    ) -> tuple[Rows, NDArray[np.uint64], NDArray[np.int8]]:
        codes = self._codes(rows)
        order = np.argsort(codes, kind="stable")
        return rows[order], codes[order], levels[order]

    def _buckets(self, key: Key, batches: Iterator[Rows]) -> list[tuple[Key, int, Path]]:
        """Points shared out to files by the nodes up to three levels below ``key``.

        A node that fits in memory is not split further.
        """
        level = key[0]
        fine = min(level + _SPLIT_LEVELS, DEEPEST_LEVEL)
        depth = fine - level
        spilled = self._folder / ("-".join(map(str, key)) + ".all")
        counts = np.zeros(8**depth, np.int64)
        shift = np.uint64(3 * (BITS_PER_AXIS - fine))
        within = np.uint64(8**depth - 1)
        with open(spilled, "wb") as file:
            for rows in batches:
                file.write(np.ascontiguousarray(rows).data)
                cells = (self._codes(rows) >> shift) & within
                counts += np.bincount(cells.astype(np.int64), minlength=len(counts))
        buckets, bucket_of = self._chosen_nodes(key, counts, depth)
        for rows in _rows_in(spilled, self._dtype):
            cells = (self._codes(rows) >> shift) & within
            number = bucket_of[cells.astype(np.int64)]
            order = np.argsort(number, kind="stable")
            present, starts = np.unique(number[order], return_index=True)
            for k, part in zip(present, np.split(order, starts[1:]), strict=True):
                with open(buckets[k][2], "ab") as file:
                    file.write(rows[part].data)
        spilled.unlink()
        return buckets

    def _chosen_nodes(
        self, key: Key, counts: NDArray[np.int64], depth: int
    ) -> tuple[list[tuple[Key, int, Path]], NDArray[np.int64]]:
        """Nodes below ``key`` that fit, or are as deep as it goes, and which one cells are in."""
        level, *cell = key
        chosen: list[tuple[Key, int, Path]] = []
        bucket_of = np.full(len(counts), -1)
        for lower in range(1, depth + 1):
            size = 8 ** (depth - lower)
            sums = counts.reshape(-1, size).sum(axis=1)
            taken = bucket_of.reshape(-1, size)[:, 0] >= 0
            fits = (sums <= self._most) | (lower == depth)
            for node in np.flatnonzero(~taken & fits & (sums > 0)).tolist():
                x, y, z = morton_cells(np.array([node], np.uint64))[0].tolist()
                bucket = (
                    level + lower,
                    (cell[0] << lower) + x,
                    (cell[1] << lower) + y,
                    (cell[2] << lower) + z,
                )
                path = self._folder / ("-".join(map(str, bucket)) + ".rows")
                bucket_of[node * size : (node + 1) * size] = len(chosen)
                chosen.append((bucket, int(sums[node]), path))
        return chosen, bucket_of


def _rows_in(path: Path, dtype: np.dtype[Any]) -> Iterator[Rows]:
    with open(path, "rb") as file:
        while len(rows := np.fromfile(file, dtype, BATCH_POINTS)):
            yield rows
