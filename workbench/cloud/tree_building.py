"""The nodes of a cloud one after another, whatever part of them fits in memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from workbench.cloud.partition import UpperNodes, part, planned
from workbench.cloud.row_sources import BlockRows, FileRows, Rows, RowSource, Survey, places, survey
from workbench.cloud.schema import Arrays, Schema
from workbench.cloud.store import ChunkStore, Key
from workbench.cloud.subtree import (
    EncodedChunk,
    Mapping,
    TreeShape,
    encoded_chunk,
    encoded_subtree,
)
from workbench.cloud.tree import NODE, Tree
from workbench.errors import InputError
from workbench.kernels.layered_kdtree import BY_ORDER, LEAF

Progress = Callable[[str, float], None]

#: A bucket is this small a part of the memory, whatever the worker count: the tree must not
#: depend on the machine.
BUCKETS_IN_MEMORY = 4
#: A plan rests on a sample: leaves are meant to be this full, so that few overflow.
_LEAF_FILL = 0.9
_UPPER_SHARE, _BUCKET_SHARE = 0.25, 0.8
_BATCH_BYTES = 1 << 24
#: Each bucket is an open file.
_MOST_UPPER_NODES = 255


@dataclass(frozen=True)
class Limits:
    """How much may be used; see ``build_cloud``."""

    memory_bytes: int
    points_per_chunk: int
    compression_level: int
    threads: int


@dataclass(frozen=True)
class _Place:
    """Where a part of the tree hangs."""

    parent: int
    side: str
    level: int

    @property
    def seed(self) -> int:
        """Of the random choice there: parts of a tree that choose alike would not be random."""
        return 2 * (self.parent + 1) + (self.side == "right")


_ROOT = _Place(-1, "", 0)


def inner_count(samples: int, points_per_chunk: int) -> int:
    """Samples of an inner chunk: all chunks alike in a tree of as few levels as will do."""
    if samples <= points_per_chunk:
        return points_per_chunk
    most = max(1, int(_LEAF_FILL * points_per_chunk))
    chunks = 3
    while -(-samples // chunks) > most:
        chunks = 2 * chunks + 1
    return -(-samples // chunks)


class TreeBuilder:
    """Builds one cloud into an empty store.

    Parameters
    ----------
    schema, store : what and where.
    pool : runs the work on buckets.
    limits : memory and chunk size.
    progress : told what is under way and its share done.
    """

    def __init__(
        self,
        schema: Schema,
        store: ChunkStore,
        pool: ThreadPoolExecutor,
        limits: Limits,
        progress: Progress,
    ) -> None:
        self._schema, self._store, self._pool = schema, store, pool
        self._limits, self._progress = limits, progress
        self._row_bytes = schema.row_bytes
        # Per row: the row itself, two copies of place and number, the encoded form.
        share = _BUCKET_SHARE * limits.memory_bytes / BUCKETS_IN_MEMORY
        self._bucket_rows = int(share / (2 * self._row_bytes + 64))
        self._nodes: list[np.void] = []
        self._stored = self._total = self._inner = 0

    def build(self, blocks: Iterable[Arrays], folder: Path) -> Tree:
        """Store all chunks; ``folder`` is empty and for temporary files."""
        source: RowSource = BlockRows(blocks, self._schema)
        self._progress("reading samples", 0.0)
        if iter(blocks) is blocks:
            spool = FileRows(folder / "spool", self._row_bytes // 8)
            with open(spool.path, "wb", buffering=0) as file:
                found = survey(map(places, _copied(source, file)))
            source = spool
        else:
            found = survey(source.positions())
        if not found.count:
            raise InputError(
                "there are no samples to build a point cloud from",
                file=self._store.path,
                fix="give at least one block with samples",
            )
        self._total = found.count
        self._inner = inner_count(found.count, self._limits.points_per_chunk)
        self._build(source, found.count, found, _ROOT, folder)
        return Tree(_with_totals(np.array(self._nodes, NODE)))

    def _build(
        self,
        source: RowSource,
        count: int,
        found: Survey | None,
        place: _Place,
        folder: Path,
    ) -> None:
        if count <= self._bucket_rows:
            rows = np.concatenate(list(source))
            self._store_subtree(self._encoded(rows, place.seed, self._pool.map), place)
            return
        found = found or survey(source.positions())
        if (found.low == found.high).all():
            self._store_coincident(source, count, place)
            return
        most = int(_UPPER_SHARE * self._limits.memory_bytes / self._inner / (self._row_bytes + 12))
        upper = planned(found, self._bucket_rows, max(1, min(most, _MOST_UPPER_NODES)))
        folder = folder / "parts"
        folder.mkdir()
        parted = part(
            source, count, upper, self._inner, folder, 2 * place.seed,
            lambda share: self._progress("distributing samples", share),
        )  # fmt: skip
        if isinstance(source, FileRows):
            source.path.unlink()
        places = self._store_upper(upper, parted.kept, place)
        buckets = parted.buckets
        del parted
        self._build_buckets(buckets, places, folder)
        folder.rmdir()

    def _build_buckets(
        self, buckets: list[tuple[FileRows, int]], places: list[_Place], folder: Path
    ) -> None:
        """Subtrees of buckets, several made at once, stored in their order."""
        waiting = deque(zip(buckets, places, strict=True))
        coming: deque[tuple[Future[list[EncodedChunk]], _Place]] = deque()
        while waiting or coming:
            while waiting and len(coming) < self._limits.threads:
                (rows, count), place = waiting[0]
                if count > self._bucket_rows:
                    break
                waiting.popleft()
                if count:
                    coming.append((self._pool.submit(self._encoded_file, rows, place.seed), place))
                else:
                    rows.path.unlink()
            if coming:
                job, place = coming.popleft()
                self._store_subtree(job.result(), place)
            elif waiting:
                (rows, count), place = waiting.popleft()
                self._build(rows, count, None, place, folder)

    def _encoded_file(self, rows: FileRows, seed: int) -> list[EncodedChunk]:
        chunks = self._encoded(rows.all(), seed)
        rows.path.unlink()
        return chunks

    def _encoded(self, rows: Rows, seed: int, mapping: Mapping = map) -> list[EncodedChunk]:
        limits = self._limits
        shape = TreeShape(self._inner, limits.points_per_chunk, limits.compression_level)
        return encoded_subtree(rows, self._schema, shape, 2 * seed + 1, mapping)

    def _store_subtree(self, chunks: list[EncodedChunk], place: _Place) -> None:
        first = len(self._nodes)
        for chunk in chunks:
            node = chunk.node
            for link in ("parent", "left", "right"):
                if node[link] >= 0:
                    node[link] += first
            node["level"] += place.level
        chunks[0].node["parent"] = place.parent
        self._hang(first, place)
        self._store_chunks(chunks)

    def _store_upper(self, upper: UpperNodes, kept: list[Rows], place: _Place) -> list[_Place]:
        """Store what upper nodes keep; returns where each bucket hangs."""
        level = self._limits.compression_level
        places = [_ROOT] * (len(kept) + 1)
        here = {0: place}
        jobs: deque[Future[EncodedChunk]] = deque()
        numbers = iter(range(len(self._nodes), len(self._nodes) + len(kept)))
        placed = []
        for node, rows in enumerate(kept):
            # No rows left for a node: none below it either, its children hang nowhere.
            number = next(numbers) if len(rows) else -1
            if len(rows):
                placed.append((node, number, rows))
            for side, child in zip(("left", "right"), upper.plan[node, 1:], strict=True):
                below = _Place(number, side, here[node].level + 1)
                if child >= 0:
                    here[int(child)] = below
                else:
                    places[-1 - int(child)] = below
        remaining = deque(placed)
        for node, number, _ in placed:
            while remaining and len(jobs) < 2 * self._limits.threads:
                jobs.append(
                    self._pool.submit(encoded_chunk, remaining.popleft()[2], self._schema, level)
                )
            chunk = jobs.popleft().result()
            chunk.node["axis"], chunk.node["split"] = upper.plan[node, 0], upper.splits[node]
            chunk.node["parent"], chunk.node["level"] = here[node].parent, here[node].level
            self._hang(number, here[node])
            self._store_chunks([chunk])
        return places

    def _store_coincident(self, source: RowSource, count: int, place: _Place) -> None:
        """Samples all in one place: any share of them is as good as another."""
        capacity = self._limits.points_per_chunk
        chunks, first = -(-count // capacity), len(self._nodes)
        for k, rows in enumerate(_regrouped(source, capacity)):
            chunk = encoded_chunk(rows, self._schema, self._limits.compression_level)
            node = chunk.node
            children = [c if c < chunks else -1 for c in (2 * k + 1, 2 * k + 2)]
            node["left"], node["right"] = (c + first if c >= 0 else -1 for c in children)
            node["axis"] = BY_ORDER if children[0] >= 0 else LEAF
            node["parent"] = first + (k - 1) // 2 if k else place.parent
            node["level"] = place.level + (k + 1).bit_length() - 1
            self._store_chunks([chunk])
        self._hang(first, place)
        if isinstance(source, FileRows):
            source.path.unlink()

    def _hang(self, number: int, place: _Place) -> None:
        if place.parent >= 0:
            self._nodes[place.parent][place.side] = number

    def _store_chunks(self, chunks: list[EncodedChunk]) -> None:
        batch: list[tuple[Key, bytes]] = []
        size = 0
        for chunk in chunks:
            number = len(self._nodes)
            self._nodes.append(chunk.node)
            self._stored += int(chunk.node["count"])
            for attribute, value in enumerate(chunk.values):
                batch.append(((number, attribute), value))
                size += len(value)
            if size > _BATCH_BYTES:
                self._store.put(batch)
                batch, size = [], 0
        self._store.put(batch)
        self._progress("storing chunks", self._stored / self._total)


def _with_totals(nodes: np.ndarray[tuple[int], np.dtype[np.void]]) -> np.ndarray[
    tuple[int], np.dtype[np.void]
]:  # fmt: skip
    """Nodes with samples and bounds of their whole subtrees; upper nodes know their own only."""
    nodes["total"] = nodes["count"]
    for i in range(len(nodes) - 1, 0, -1):
        p = nodes["parent"][i]
        nodes["total"][p] += nodes["total"][i]
        nodes["low"][p] = np.minimum(nodes["low"][p], nodes["low"][i])
        nodes["high"][p] = np.maximum(nodes["high"][p], nodes["high"][i])
    childless = (nodes["left"] < 0) & (nodes["right"] < 0)
    nodes["axis"][childless] = LEAF
    return nodes


def _copied(source: RowSource, file: BinaryIO) -> Iterator[Rows]:
    """The same rows, written to a file as they pass."""
    for rows in source:
        piece = rows.data.cast("B")
        while len(piece):
            piece = piece[file.write(piece) :]
        yield rows


def _regrouped(source: RowSource, size: int) -> Iterator[Rows]:
    """The same rows, ``size`` at a time."""
    held: list[Rows] = []
    count = 0
    for rows in source:
        while count + len(rows) >= size:
            cut = size - count
            yield np.concatenate([*held, rows[:cut]])
            held, count, rows = [], 0, rows[cut:]
        if len(rows):
            held.append(rows)
            count += len(rows)
    if held:
        yield np.concatenate(held)
