"""Surfaces cut into chunks without ever being whole in memory.

Positions and sorted triangles lie in temporary files beside the result, which the system may drop
from memory as it likes; in memory are a histogram of places and one bucket of triangles at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.morton import morton_codes
from workbench.raytracing.chunk_file import (
    MOST_TRIANGLES,
    ChunkFile,
    SurfaceChunk,
    write_chunk_file,
)
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.surface_source import SurfaceSource, surface_frame

#: Triangles of a chunk. Fewer make a finer hierarchy, more make fewer and longer reads.
TRIANGLES_PER_CHUNK = 4096
# Histogram cells per axis; 2²¹ counters are 16 MB.
_CELL_BITS = 7
_FINE_BITS = 21
_TRIANGLES_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class _Scratch:
    """Temporary files as arrays: positions and colours of vertices, rows of triangles."""

    positions: NDArray[np.float32]
    colors: NDArray[np.uint8] | None
    rows: NDArray[np.void]


_ROW = np.dtype([("code", "<u8"), ("number", "<u4"), ("corners", "<u4", 3)])


def build_chunk_file(
    source: SurfaceSource,
    path: Path,
    *,
    triangles_per_chunk: int = TRIANGLES_PER_CHUNK,
    triangles_at_once: int = _TRIANGLES_AT_ONCE,
) -> ChunkFile:
    """Cut a surface into chunks along the Morton order of its triangles' middles.

    Parameters
    ----------
    source
        The surface; it is read three times.
    path
        The file to write; the temporary files are made in its folder and take 12 B a vertex and
        24 B a triangle.
    triangles_per_chunk
        At most ``MOST_TRIANGLES``.
    triangles_at_once
        Triangles in memory, about; more only where one cell of a 128³ grid holds more.

    Raises
    ------
    InputError
        No triangles, vertices that are not finite, triangles of vertices that are not there, or
        more of either than 32 bits count.
    """
    _check_size(source, triangles_per_chunk)
    frame = surface_frame(source)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        scratch = _scratch(source, Path(folder))
        _store_vertices(source, frame, scratch)
        starts = _sorted_into_buckets(source, scratch, triangles_at_once)
        write_chunk_file(
            path,
            frame,
            _chunks(scratch, starts, triangles_per_chunk),
            vertices=source.vertices,
            colored=scratch.colors is not None,
        )
        del scratch
    return ChunkFile(path)


def triangle_colors(colors: NDArray[np.uint8], corners: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Colours (t, 3) of triangles (t, 3) between vertices of colours (v, 3): their mean."""
    return np.asarray(np.rint(colors[corners].mean(axis=1, dtype=np.float32)), np.uint8)


def _check_size(source: SurfaceSource, triangles_per_chunk: int) -> None:
    if not 1 <= triangles_per_chunk <= MOST_TRIANGLES:
        raise ValueError(f"triangles_per_chunk is {triangles_per_chunk}, not 1–{MOST_TRIANGLES}")
    if not source.triangles:
        raise InputError("The surface has no triangles.", fix="Check the file it came from.")
    if max(source.vertices, source.triangles) >= 1 << 32:
        raise InputError(
            "The surface has more vertices or triangles than can be numbered.",
            expected="fewer than 2^32 of each",
            found=f"{source.vertices} vertices, {source.triangles} triangles",
            fix="Divide it.",
        )


def _scratch(source: SurfaceSource, folder: Path) -> _Scratch:
    positions = np.memmap(folder / "positions", np.float32, "w+", shape=(source.vertices, 3))
    colors = None
    if source.colors() is not None:
        colors = np.memmap(folder / "colors", np.uint8, "w+", shape=(source.vertices, 3))
    return _Scratch(
        positions, colors, np.memmap(folder / "rows", _ROW, "w+", shape=(source.triangles,))
    )


def _store_vertices(source: SurfaceSource, frame: LocalFrame, scratch: _Scratch) -> None:
    first = 0
    for points in source.points():
        scratch.positions[first : first + len(points)] = frame.local(points)
        first += len(points)
    first = 0
    for colors in source.colors() or ():
        assert scratch.colors is not None
        scratch.colors[first : first + len(colors)] = colors
        first += len(colors)


def _coded(
    source: SurfaceSource, positions: NDArray[np.float32]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint64]]]:
    """Corners (b, 3) and Morton codes (b,) of the triangles, in order."""
    scale = np.float32((1 << _FINE_BITS) - 1) / np.float32(2.0)
    for corners in source.corners():
        if corners.size and (corners.min() < 0 or corners.max() >= len(positions)):
            raise InputError(
                "The surface has triangles of vertices that are not there.",
                expected=f"vertices 0 to {len(positions) - 1}",
                found=f"{corners.min()} to {corners.max()}",
                fix="Check the file it came from.",
            )
        middles = positions[corners].mean(axis=1, dtype=np.float32)
        cells = np.clip((middles + np.float32(1.0)) * scale, 0, (1 << _FINE_BITS) - 1)
        yield corners, morton_codes(cells.astype(np.int64))


def _sorted_into_buckets(
    source: SurfaceSource, scratch: _Scratch, triangles_at_once: int
) -> NDArray[np.int64]:
    """Write the rows of triangles bucket by bucket; returns where buckets begin, and the end."""
    shift = np.uint64(3 * (_FINE_BITS - _CELL_BITS))
    cells = 1 << (3 * _CELL_BITS)
    counts = np.zeros(cells, np.int64)
    for _, codes in _coded(source, scratch.positions):
        counts += np.bincount((codes >> shift).astype(np.int64), minlength=cells)
    ends = np.cumsum(counts)
    bucket_of_cell, starts = _buckets(ends, triangles_at_once)
    written = starts[:-1].copy()
    first = 0
    for corners, codes in _coded(source, scratch.positions):
        buckets = bucket_of_cell[(codes >> shift).astype(np.int64)]
        order = np.argsort(buckets, kind="stable")
        rows = np.empty(len(codes), _ROW)
        rows["code"], rows["corners"] = codes[order], corners[order]
        rows["number"] = first + order
        first += len(codes)
        present, at, counted = np.unique(buckets[order], return_index=True, return_counts=True)
        for bucket, begin, count in zip(present, at, counted, strict=True):
            place = written[bucket]
            scratch.rows[place : place + count] = rows[begin : begin + count]
            written[bucket] += count
    return starts


def _buckets(
    ends: NDArray[np.int64], triangles_at_once: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bucket of each cell, and where buckets begin: cells in a row of no more than so many."""
    cells, starts, last = [0], [0], 0
    while last < ends[-1]:
        cell = int(np.searchsorted(ends, last + triangles_at_once, side="right"))
        cell = max(cell, int(np.searchsorted(ends, last, side="right")) + 1)
        last = int(ends[cell - 1])
        cells.append(cell)
        starts.append(last)
    bucket_of_cell = np.repeat(np.arange(len(cells) - 1), np.diff([*cells[:-1], len(ends)]))
    return bucket_of_cell, np.array(starts, np.int64)


def _chunks(
    scratch: _Scratch, starts: NDArray[np.int64], triangles_per_chunk: int
) -> Iterator[SurfaceChunk]:
    for begin, end in pairwise(starts):
        rows = np.array(scratch.rows[begin:end])
        # Equal codes stay in the order of their numbers: the file is the same for each way it is
        # built.
        rows = rows[np.lexsort((rows["number"], rows["code"]))]
        for part in np.array_split(rows, max(1, -(-len(rows) // triangles_per_chunk))):
            yield _chunk(scratch, part)


def _chunk(scratch: _Scratch, rows: NDArray[np.void]) -> SurfaceChunk:
    used, corners = np.unique(rows["corners"], return_inverse=True)
    colors = None
    if scratch.colors is not None:
        colors = triangle_colors(scratch.colors, rows["corners"])
    return SurfaceChunk(
        np.asarray(scratch.positions[used]),
        used.astype(np.uint32),
        corners.reshape(-1, 3).astype(np.uint16),
        np.ascontiguousarray(rows["number"]),
        colors,
    )
