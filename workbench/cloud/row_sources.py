"""Streams of samples as packed rows: from the caller's blocks or from files of our own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.schema import LARGEST_COORDINATE, POINTS, Arrays, Schema
from workbench.errors import InputError
from workbench.kernels.layered_kdtree import extents, sampled

Rows = NDArray[np.uint64]
SLICE_ROWS = 1 << 16
_SAMPLE_SIZE = 1 << 19
T = TypeVar("T")


class RowSource(Protocol):
    """Rows (n, words) uint64 of at most ``SLICE_ROWS``, the same ones every time."""

    def __iter__(self) -> Iterator[Rows]: ...

    def positions(self) -> Iterator[NDArray[np.float64]]:
        """(n, 3) float64 positions of the rows alone."""
        ...


@dataclass(frozen=True)
class BlockRows:
    """The caller's blocks, checked and cut to slices."""

    blocks: Iterable[Arrays]
    schema: Schema

    def __iter__(self) -> Iterator[Rows]:
        for block, where, start in self._slices():
            rows = self.schema.rows(block, where)
            _check_places(places(rows), where, start)
            if len(rows):
                yield rows

    def positions(self) -> Iterator[NDArray[np.float64]]:
        for block, where, start in self._slices():
            self.schema.check(block, where)
            points = np.ascontiguousarray(block[POINTS])
            _check_places(points, where, start)
            yield points

    def _slices(self) -> Iterator[tuple[Arrays, str, int]]:
        """Pieces of blocks, which block they are of and where in it they begin."""
        for number, block in enumerate(self.blocks):
            where = f"block {number}"
            arrays = _arrays(block, where)
            length = max((len(a) for _, a in arrays), default=1)
            for start in range(0, max(1, length), SLICE_ROWS):
                yield {n: a[start : start + SLICE_ROWS] for n, a in arrays}, where, start


@dataclass(frozen=True)
class FileRows:
    """Rows that were written one after another to a file."""

    path: Path
    words: int

    def __iter__(self) -> Iterator[Rows]:
        with open(self.path, "rb") as file:
            while True:
                rows = np.fromfile(file, np.uint64, SLICE_ROWS * self.words)
                if not len(rows):
                    return
                yield rows.reshape(-1, self.words)

    def positions(self) -> Iterator[NDArray[np.float64]]:
        return map(places, self)

    def all(self) -> Rows:
        """Every row at once."""
        return np.fromfile(self.path, np.uint64).reshape(-1, self.words)


@dataclass(frozen=True)
class Survey:
    """What one pass over a source tells.

    Attributes
    ----------
    count : rows.
    low, high : (3,) float64 closed bounds, metres.
    sample : (s, 3) float64 positions of a random part, in stream order; all of them where
        they are few.
    """

    count: int
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    sample: NDArray[np.float64]


def survey(positions: Iterator[NDArray[np.float64]]) -> Survey:
    """Count, bounds and a sample; the sample does not depend on how rows are sliced."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    kept, keys = np.empty((_SAMPLE_SIZE, 3)), np.empty(_SAMPLE_SIZE, np.uint64)
    threshold, number, count = 1 << 32, 0, 0
    for points in ahead(positions):
        extents(points, low, high)
        threshold, number = sampled(points, count, threshold, kept, keys, number)
        count += len(points)
    return Survey(count, low, high, kept[:number].copy())


def places(rows: Rows) -> NDArray[np.float64]:
    """(n, 3) float64 positions of rows, a copy."""
    return np.ascontiguousarray(rows[:, :3]).view(np.float64)


def ahead(iterator: Iterator[T]) -> Iterator[T]:
    """The same items, each made in a thread while the one before is used."""
    end = object()
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, iterator, end)
        while (item := coming.result()) is not end:
            coming = pool.submit(next, iterator, end)
            yield item  # type: ignore[misc]  # anything but the end is a T


def _arrays(block: Arrays, where: str) -> list[tuple[str, NDArray[np.generic]]]:
    """The arrays of a block, all equally long."""
    lengths = {name: np.shape(a)[0] if np.ndim(a) else -1 for name, a in block.items()}
    if len(set(lengths.values())) > 1 or -1 in lengths.values():
        raise InputError(
            "the arrays of a block differ in length",
            where=where,
            expected="one value per sample in every array",
            found=", ".join(f"{name}: {n}" for name, n in lengths.items()),
        )
    return list(block.items())


def _check_places(points: NDArray[np.float64], where: str, start: int) -> None:
    bad = extents(points, np.full(3, np.inf), np.full(3, -np.inf))
    if bad >= 0:
        raise InputError(
            "a position is not a number",
            where=f"{where}, sample {start + bad}",
            expected=f"finite coordinates within ±{LARGEST_COORDINATE:g} m",
            found=str(points[bad].tolist()),
            fix="leave out samples without a measured place",
        )
