"""Octrees with additive levels from streams of points of any number, in bounded memory.

A node shows what it covers by a grid of 128 cells along each axis. Grids nest, so the point of
a cell is chosen among those of the finer cells in it, nearest to the centre, and a point
belongs to the coarsest node whose grid it was chosen for. What is left below a node stays in it
once it is little. The nodes of each level and all above have then exactly one point in every
cell with points, wherever nodes go on.

Clouds larger than the memory are first parted on disk into buckets, each the points below one
node. Buckets are worked off in Morton order, so that of the nodes above them only those on the
way to the root are open at a time.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.octree_rows import (
    Rows,
    RowSource,
    packed,
    row_type,
    rows_of_file,
    unpacked,
)
from workbench.errors import InputError
from workbench.formats.octree_nodes import CELLS, Cube, NodeKey, OctreeNode
from workbench.formats.point_rounding import Rounding, rounding_of
from workbench.formats.point_stream import PointStream
from workbench.kernels.cell_winners import cell_codes, winning_levels
from workbench.kernels.morton import BITS_PER_AXIS, morton_cells

MEMORY_BYTES = 1 << 30
LEAF_POINTS = 16_384
"""So many points are not worth nodes of their own below."""

_BYTES_PER_POINT = 160
_LEAVES_PER_BUCKET = 4
_GRID = CELLS.bit_length() - 1
_DEEPEST = 31


@dataclass(frozen=True)
class _Bucket:
    key: NodeKey
    first_code: int
    count: int


@dataclass
class _Open:
    """A node above the buckets at work, and its points so far."""

    key: NodeKey
    parts: list[Rows] = field(default_factory=list)


class StreamedOctree:
    """An octree of a stream; same points and options, same nodes in the same order.

    Parameters
    ----------
    stream : the points.
    folder : for files meanwhile, of the size of the points in memory.
    precision : step of coordinates, by default that of `rounding_of`.
    memory_bytes : bound of the working memory, unless that many points coincide.
    leaf_points : so many are not parted further.

    Raises
    ------
    SettingsError : the precision does not fit the size of the cloud.
    """

    def __init__(
        self,
        stream: PointStream,
        folder: Path,
        *,
        precision: float | None = None,
        memory_bytes: int = MEMORY_BYTES,
        leaf_points: int = LEAF_POINTS,
    ) -> None:
        self.rounding: Rounding = rounding_of(stream.low, stream.high, precision)
        corners = self.rounding.whole(np.stack([stream.low, stream.high])).astype(np.int64)
        self.cube = Cube(corners[0], int((corners[1] - corners[0]).max()) + 1)
        self.count = stream.count
        self.attributes = stream.attributes
        self._stream = stream
        self._folder = Path(folder)
        self._bucket_points = max(
            memory_bytes // _BYTES_PER_POINT, _LEAVES_PER_BUCKET * leaf_points
        )
        self._leaf_points = leaf_points
        self._dtype = row_type(stream.attributes)
        self._open: list[_Open] = []

    def nodes(self) -> Iterator[OctreeNode]:
        """Every node once; those above buckets come after what is below them."""
        self._open = []
        yield from self._below(NodeKey(0, 0, 0, 0), self._rows, self.count)
        while self._open:
            yield self._closed()

    # -- more than memory --------------------------------------------------------------------

    def _below(
        self, key: NodeKey, source: RowSource, count: int
    ) -> Generator[OctreeNode, None, Rows]:
        """The nodes at and below one; returns what coarser grids choose from, if it is deep."""
        if count <= self._bucket_points or key.level + _GRID >= _DEEPEST:
            rows = np.concatenate([np.empty(0, self._dtype), *source()])
            _check_unchanged(abs(len(rows) - count))
            return (yield from self._in_memory(key, rows))
        buckets = self._buckets(key, source)
        _check_unchanged(abs(sum(bucket.count for bucket in buckets) - count))
        path = self._folder / f"level-{key.level}.points"
        self._part(key, source, buckets, path)
        winners, start = [], 0
        for bucket in buckets:
            yield from self._opened(bucket.key)
            part = rows_of_file(path, self._dtype, start, bucket.count)
            winners.append((yield from self._below(bucket.key, part, bucket.count)))
            start += bucket.count
        path.unlink()
        return self._shared_out(key, np.concatenate(winners))

    def _buckets(self, key: NodeKey, source: RowSource) -> list[_Bucket]:
        """Nodes below ``key`` that share out its points, few enough each, in Morton order."""
        counts = [np.zeros(1 << (3 * _GRID), np.int64)]
        for rows in source():
            counts[0] += np.bincount(
                self._codes(key, rows, _GRID).astype(np.int64), minlength=len(counts[0])
            )
        while len(counts[-1]) > 1:
            counts.append(counts[-1].reshape(-1, 8).sum(axis=1))
        buckets = []
        for above, level_counts in enumerate(counts[:-1]):
            parts = np.repeat(counts[above + 1] > self._bucket_points, 8) & (level_counts > 0)
            if above:
                parts &= level_counts <= self._bucket_points
            codes = np.flatnonzero(parts)
            level = _GRID - above
            for code, cell in zip(codes, morton_cells(codes.astype(np.uint64)), strict=True):
                x, y, z = (int(v) for v in cell)
                node = NodeKey(key.level + level, (key.x << level) + x, (key.y << level) + y,
                               (key.z << level) + z)  # fmt: skip
                first = int(code) << (3 * above)
                buckets.append(_Bucket(node, first, int(level_counts[code])))
        return sorted(buckets, key=lambda bucket: bucket.first_code)

    def _part(self, key: NodeKey, source: RowSource, buckets: list[_Bucket], path: Path) -> None:
        """Write the rows bucket by bucket: sizes are known, so each has its place at once."""
        first_codes = np.array([bucket.first_code for bucket in buckets], np.uint64)
        sizes = np.array([bucket.count for bucket in buckets], np.int64)
        at = np.cumsum(sizes) - sizes
        ends = at + sizes
        try:
            with open(path, "wb") as file:
                for rows in source():
                    codes = self._codes(key, rows, _GRID)
                    which = np.searchsorted(first_codes, codes, side="right") - 1
                    order = np.argsort(which, kind="stable")
                    rows = rows[order]
                    found, begin = np.unique(which[order], return_index=True)
                    for bucket, first, last in zip(
                        found, begin, [*begin[1:], len(rows)], strict=True
                    ):
                        part = rows[first:last]
                        os.pwrite(file.fileno(), part.data, int(at[bucket]) * part.itemsize)
                        at[bucket] += len(part)
        except OSError as error:
            raise InputError(
                "The points cannot be sorted on disk.",
                file=path,
                found=str(error),
                fix=f"Free {self.count * self._dtype.itemsize} bytes there, or export elsewhere.",
            ) from error
        _check_unchanged(int(np.abs(ends - at).sum()))

    def _opened(self, key: NodeKey) -> Iterator[OctreeNode]:
        """Close the nodes that do not lie above ``key``, and open those that do."""
        while self._open and not key.inside(self._open[-1].key):
            yield self._closed()
        ancestors = [key]
        while ancestors[-1].level > len(self._open):
            ancestors.append(ancestors[-1].parent)
        self._open += [_Open(node) for node in reversed(ancestors[1:])]

    def _closed(self) -> OctreeNode:
        node = self._open.pop()
        return self._node(node.key, np.concatenate([np.empty(0, self._dtype), *node.parts]))

    # -- in memory ---------------------------------------------------------------------------

    def _in_memory(self, key: NodeKey, rows: Rows) -> Generator[OctreeNode, None, Rows]:
        rows, codes, levels = self._ranked(key, rows)
        upper = levels < key.level
        handed = self._handed_up(key, rows[upper], levels[upper])
        subtree = _Subtree(key, codes, levels, self._leaf_points)
        for node, which in subtree.nodes(key, np.flatnonzero(~upper)):
            yield self._node(node, rows[which])
        return handed

    def _shared_out(self, key: NodeKey, rows: Rows) -> Rows:
        """Put the winners of buckets where they belong; all nodes of them are open."""
        rows, _, levels = self._ranked(key, rows)
        return self._handed_up(key, rows, levels)

    def _handed_up(self, key: NodeKey, rows: Rows, levels: NDArray[np.int64]) -> Rows:
        """Rows into open nodes by level, but the winner of a deep ``key``, which is returned."""
        last = key.level - _GRID
        for level in np.unique(levels):
            if level > last or last <= 0:
                self._open[int(level)].parts.append(rows[levels == level])
        return rows[levels == last] if last > 0 else rows[:0]

    def _ranked(
        self, key: NodeKey, rows: Rows
    ) -> tuple[Rows, NDArray[np.uint64], NDArray[np.int64]]:
        """Rows in Morton order, their codes, and the level of the node that each belongs to."""
        bits = _bits_below(key)
        codes = self._codes(key, rows, bits)
        order = np.argsort(codes, kind="stable")
        codes = codes[order]
        won = np.empty(len(codes), np.int8)
        winning_levels(codes, bits, max(_GRID - key.level, 0), won)
        return rows[order], codes, won.astype(np.int64) + (key.level - _GRID)

    def _node(self, key: NodeKey, rows: Rows) -> OctreeNode:
        return OctreeNode(key, *unpacked(rows, self.rounding))

    def _rows(self) -> Iterator[Rows]:
        for batch in self._stream.batches():
            if len(batch):
                yield packed(batch, self.rounding, self._dtype)

    def _codes(self, key: NodeKey, rows: Rows, bits: int) -> NDArray[np.uint64]:
        codes = np.empty(len(rows), np.uint64)
        corner = np.array([key.x, key.y, key.z], np.int64)
        whole = np.ascontiguousarray(rows["whole"])
        outside = cell_codes(whole, self.cube.low, self.cube.side, key.level, corner, bits, codes)
        _check_unchanged(outside)
        return codes


@dataclass(frozen=True)
class _Subtree:
    """Points in Morton order below ``root``, and the level of the node each belongs to."""

    root: NodeKey
    codes: NDArray[np.uint64]
    levels: NDArray[np.int64]
    leaf_points: int

    def nodes(
        self, key: NodeKey, inside: NDArray[np.int64]
    ) -> Iterator[tuple[NodeKey, NDArray[np.int64]]]:
        """Which points a node and those below it hold, of those ``inside`` that are left."""
        if not len(inside):
            return
        here = self.levels[inside] == key.level
        if len(inside) <= self.leaf_points:
            here[:] = True
        yield key, inside[here]
        rest = inside[~here]
        if not len(rest):
            return
        below = key.level + 1 - self.root.level
        children = self.codes[rest] >> np.uint64(3 * (_bits_below(self.root) - below))
        found, begin = np.unique(children, return_index=True)
        for child, first, last in zip(found, begin, [*begin[1:], len(rest)], strict=True):
            x, y, z = ((int(child) >> axis) & 1 for axis in range(3))
            node = NodeKey(key.level + 1, 2 * key.x + x, 2 * key.y + y, 2 * key.z + z)
            yield from self.nodes(node, rest[first:last])


def _bits_below(key: NodeKey) -> int:
    """Depth of the finest grid inside a node."""
    return min(BITS_PER_AXIS, _DEEPEST - key.level)


def _check_unchanged(elsewhere: int) -> None:
    if elsewhere:
        raise InputError(
            "The points changed while they were read.",
            found=f"{elsewhere} points more, fewer or elsewhere than before",
            fix="Leave the file alone until the export is done.",
        )
