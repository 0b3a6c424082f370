"""A point cloud on disk, asked by region and level of detail and rewritten chunk by chunk.

Source: Jaspe-Villanueva 2018, section 3.3; Gobbetti and Marton 2004, Layered Point Clouds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.building import FORMAT, building_folder, header_of
from workbench.cloud.cache import ChunkCache, Key
from workbench.cloud.chunk_codec import decode, encode_attribute
from workbench.cloud.schema import POINTS, Arrays, Attribute, Schema
from workbench.cloud.store import ChunkStore
from workbench.cloud.tree import Tree
from workbench.errors import InputError, SettingsError
from workbench.geometry.regions import EVERYWHERE, Region

CACHE_BYTES = 256 << 20
#: So many chunks are read ahead of the one in use.
_AHEAD = 8

Order = Literal["depth_first", "coarse_first", "bottom_up"]


@dataclass(frozen=True)
class PointBlock:
    """Samples that a query found.

    Attributes
    ----------
    arrays : per name (n, …); ``"points"`` are (n, 3) float64 metres.
    level : finest level that is delivered in full; the samples are all those of levels up to
        it that the region holds, a uniform subset.
    complete : False where a budget ended before the level or spacing that was asked for.
    """

    arrays: dict[str, NDArray[Any]]
    level: int
    complete: bool

    @property
    def points(self) -> NDArray[np.float64]:
        """(n, 3) float64 positions, metres."""
        return self.arrays[POINTS]

    def __len__(self) -> int:
        return len(self.points)


class LayeredCloud:
    """The cloud at ``path``, for use by one thread; a forked process must open its own.

    What another process commits meanwhile is seen when chunks are next read from disk.

    Parameters
    ----------
    path : made by ``build_cloud``.
    writable : whether attributes may be written; one such process at a time.
    cache_bytes : of decoded arrays kept in memory.
    read_ahead : whether a thread loads what is probably asked for next.

    Raises
    ------
    InputError
        where the file is missing, unfinished, foreign or damaged.
    ProjectLockedError
        where another process writes it.
    """

    def __init__(
        self,
        path: Path,
        *,
        writable: bool = False,
        cache_bytes: int = CACHE_BYTES,
        read_ahead: bool = True,
    ) -> None:
        self.path = Path(path)
        if not self.path.exists() and building_folder(self.path).exists():
            raise InputError(
                "the point cloud is unfinished: its building was interrupted",
                file=self.path,
                fix="build it again",
            )
        self._store = ChunkStore(self.path, writable=writable)
        try:
            header, tree = self._store.read_header()
            if header.get("format") != FORMAT:
                raise InputError(
                    "the point cloud has a format of another version",
                    file=self.path,
                    expected=str(FORMAT),
                    found=str(header.get("format")),
                    fix="build it again",
                )
            try:
                self.schema = Schema.from_json(header["schema"])
                self._compression_level = int(header["compression_level"])
            except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
                raise InputError(
                    "a point cloud is damaged",
                    file=self.path,
                    where="its header",
                    found=str(error)[:200],
                    fix="restore the file from a copy or build it again",
                ) from error
            self.tree = Tree.from_bytes(tree, self.path)
            if writable:
                self._store.sweep()
        except BaseException:
            self._store.close()
            raise
        self._cache = ChunkCache(self._load, self._write_back, cache_bytes, read_ahead)
        self._last: Region | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __len__(self) -> int:
        return self.tree.total

    @property
    def levels(self) -> int:
        """Number of levels of detail; level 0 is the coarsest."""
        return self.tree.levels

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Closed bounds of all samples, (3,) each, metres."""
        root = self.tree.nodes[0]
        return root["low"].copy(), root["high"].copy()

    def close(self) -> None:
        """Release the file. Changes since the last ``commit`` are lost."""
        self._cache.close()
        self._store.close()

    # -- regions ---------------------------------------------------------------------------

    def query(
        self,
        region: Region = EVERYWHERE,
        *,
        names: Sequence[str] | None = None,
        level: int | None = None,
        spacing_m: float | None = None,
        budget_bytes: int | None = None,
        budget_ms: float | None = None,
    ) -> PointBlock:
        """Samples in a region, coarse levels first.

        Parameters
        ----------
        region : a closed region; all of space by default.
        names : attributes wanted; all by default. ``"points"`` always come along.
        level : finest level, 0 for the coarsest; all levels by default.
        spacing_m : go as deep as it takes for neighbours this close, and no deeper. What
            comes is at least as dense, where the cloud itself is.
        budget_bytes : of uncompressed chunks to look at.
        budget_ms : of time. The root always comes. A budget that ends amid a level gives up
            that level, for half a level would be dense here and sparse there.

        Returns
        -------
        PointBlock, by level, then in the order of the tree; an empty one, complete, where
        the region holds nothing.
        """
        start = perf_counter()
        _check_limits(level, spacing_m, budget_bytes, budget_ms)
        wanted = self._names(names)
        chunks = self._chunks_of(region, level, spacing_m)
        levels = self.tree.nodes["level"][chunks]
        inside = region.covers(self.tree.nodes["low"][chunks], self.tree.nodes["high"][chunks])
        affordable = self._affordable(chunks, wanted, budget_bytes)
        found: list[dict[str, NDArray[Any]]] = []
        whole, done = 0, 0
        for i in range(affordable):
            if i and levels[i] != levels[i - 1]:
                whole = len(found)
            if budget_ms is not None and levels[i] > levels[0]:
                spent = 1e3 * (perf_counter() - start)
                if spent + spent / i >= budget_ms:
                    break
            self._cache.want(chunks[i + 1 : i + 1 + _AHEAD], wanted)
            arrays = self._cache.get(int(chunks[i]), wanted)
            found.append(arrays if inside[i] else _filtered(arrays, region))
            done = i + 1
        complete = done == len(chunks)
        if complete or (done == affordable and levels[done] != levels[done - 1]):
            whole = done
        self._anticipate(region, level, spacing_m, chunks[done:], wanted)
        reached = int(levels[whole - 1]) if whole else (level or 0)
        return PointBlock(self._joined(found[:whole], wanted), reached, complete)

    def prefetch(
        self,
        region: Region,
        *,
        names: Sequence[str] | None = None,
        level: int | None = None,
        spacing_m: float | None = None,
    ) -> None:
        """Let the read-ahead thread load a region; returns at once."""
        self._cache.want(self._chunks_of(region, level, spacing_m), self._names(names))

    def cells(self, most_samples: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Closed boxes (low, high) that share out space, each with few enough samples.

        Every sample lies in exactly one; outer faces are infinite. See ``Tree.cells``.
        """
        return self.tree.cells(most_samples)

    # -- chunks ----------------------------------------------------------------------------

    def chunks(self, order: Order = "depth_first") -> NDArray[np.int64]:
        """All chunk numbers: neighbours together, coarse levels first, or children first."""
        if order == "coarse_first":
            return np.argsort(self.tree.nodes["level"], kind="stable")
        return self.tree.depth_first() if order == "depth_first" else self.tree.bottom_up()

    def leaves(self) -> NDArray[np.int64]:
        """Numbers of the chunks that have no finer ones, neighbours together."""
        order = self.tree.depth_first()
        return order[self.tree.nodes["axis"][order] < 0]

    def read(self, chunk: int, names: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
        """Arrays of one chunk, read-only; all attributes by default."""
        self._check_chunk(chunk)
        wanted = list(self.schema.names if names is None else names)
        for name in wanted:
            self.schema[name]
        return self._cache.get(int(chunk), wanted)

    def blocks(
        self, names: Sequence[str] | None = None, order: Order = "depth_first"
    ) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
        """Every chunk and its arrays, one at a time, the next ones loading meanwhile."""
        wanted = list(self.schema.names if names is None else names)
        sequence = self.chunks(order)
        for i, chunk in enumerate(sequence):
            self._cache.want(sequence[i + 1 : i + 1 + _AHEAD], wanted)
            yield int(chunk), self.read(int(chunk), wanted)

    def write(self, chunk: int, arrays: Arrays) -> None:
        """Replace attributes of one chunk; they last from the next ``commit`` on.

        Raises
        ------
        InputError
            where an array does not fit the schema, or positions are given: they are fixed.
        """
        self._check_chunk(chunk)
        self._store.check_writable()
        if POINTS in arrays:
            raise InputError(
                "the positions of a cloud cannot be changed",
                file=self.path,
                fix="build another cloud",
            )
        count = int(self.tree.nodes["count"][chunk])
        for name, values in arrays.items():
            self.schema[name].check(values, count, f"chunk {chunk}")
        self._cache.put(int(chunk), {n: np.array(a) for n, a in arrays.items()})

    def add_attribute(self, attribute: Attribute) -> None:
        """Give every sample one more attribute, ``attribute.fill`` until it is written."""
        self._store.check_writable()
        self.schema = self.schema.with_attribute(attribute)

    def commit(self) -> None:
        """Make all changes last, in one step: a crash leaves the commit before or this one."""
        self._cache.write_all()
        header = header_of(self.schema, self.tree, self._compression_level)
        self._store.commit(header, self.tree.as_bytes())

    # -- inside ----------------------------------------------------------------------------

    def _names(self, names: Sequence[str] | None) -> list[str]:
        wanted = list(self.schema.names if names is None else names)
        for name in wanted:
            self.schema[name]
        return [POINTS, *(n for n in dict.fromkeys(wanted) if n != POINTS)]

    def _check_chunk(self, chunk: int) -> None:
        if not 0 <= chunk < len(self.tree):
            raise InputError(
                "there is no such chunk",
                file=self.path,
                expected=f"0 to {len(self.tree) - 1}",
                found=str(chunk),
            )

    def _chunks_of(
        self, region: Region, level: int | None, spacing_m: float | None
    ) -> NDArray[np.int64]:
        touched = region.meets(self.tree.nodes["low"], self.tree.nodes["high"])
        return self.tree.wanted(touched, level, spacing_m)

    def _affordable(
        self, chunks: NDArray[np.int64], names: list[str], budget_bytes: int | None
    ) -> int:
        """How many of the chunks, whole levels at a time, the budget allows; the root always."""
        if budget_bytes is None or not len(chunks):
            return len(chunks)
        per_sample = sum(self.schema[n].bytes_per_sample for n in names)
        spent = np.cumsum(self.tree.nodes["count"][chunks]) * per_sample
        levels = self.tree.nodes["level"][chunks]
        ends = np.flatnonzero(np.r_[np.diff(levels) > 0, True])
        return int(max(ends[0], ends[spent[ends] <= budget_bytes].max(initial=0))) + 1

    def _anticipate(
        self,
        region: Region,
        level: int | None,
        spacing_m: float | None,
        rest: NDArray[np.int64],
        names: list[str],
    ) -> None:
        """Read ahead: what the budget left out, else where the region moves to, else finer."""
        last, self._last = self._last, region
        if not len(rest):
            moved = region.center - last.center if last else np.zeros(3)
            if moved.any():
                rest = self._chunks_of(region.shifted(moved), level, spacing_m)
            elif level is not None or spacing_m is not None:
                finer = None if spacing_m is None else 0.5 * spacing_m
                rest = self._chunks_of(region, None if level is None else level + 1, finer)
        per_sample = sum(self.schema[n].bytes_per_sample for n in names)
        size = np.cumsum(self.tree.nodes["count"][rest]) * per_sample
        # Half the cache: what was just asked for is as likely to be asked again.
        self._cache.want(rest[size <= self._cache.capacity_bytes // 2], names)

    def _joined(
        self, found: list[dict[str, NDArray[Any]]], names: list[str]
    ) -> dict[str, NDArray[Any]]:
        if not found:
            return {n: self.schema[n].filled(0) for n in names}
        return {n: np.concatenate([arrays[n] for arrays in found]) for n in names}

    def _load(self, chunk: int, names: list[str]) -> dict[str, NDArray[Any]]:
        numbers = [self.schema.names.index(n) for n in names]
        count = int(self.tree.nodes["count"][chunk])
        arrays = {}
        for name, value in zip(names, self._store.get((chunk, k) for k in numbers), strict=True):
            where = f"{self.path} (chunk {chunk}, {name})"
            attribute = self.schema[name]
            arrays[name] = (
                attribute.filled(count) if value is None else decode(value, attribute, where)
            )
        return arrays

    def _write_back(self, changed: dict[Key, NDArray[Any]]) -> None:
        numbers = {n: k for k, n in enumerate(self.schema.names)}
        self._store.put(
            ((chunk, numbers[name]), encode_attribute(array, self._compression_level))
            for (chunk, name), array in changed.items()
        )


def _filtered(arrays: dict[str, NDArray[Any]], region: Region) -> dict[str, NDArray[Any]]:
    keep = np.flatnonzero(region.contains(arrays[POINTS]))
    return {name: array.take(keep, axis=0) for name, array in arrays.items()}


def _check_limits(
    level: int | None, spacing_m: float | None, budget_bytes: int | None, budget_ms: float | None
) -> None:
    limits = {"level": level, "spacing_m": spacing_m, "budget_bytes": budget_bytes,
              "budget_ms": budget_ms}  # fmt: skip
    for name, value in limits.items():
        if value is not None and not value >= 0:
            raise SettingsError(f"{name} is out of bounds", expected="0 or more", found=str(value))
