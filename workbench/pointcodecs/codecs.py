"""The codecs of cubes of points, by name.

All three take many cubes at once and give bytes for each, which can be read alone. What they
cost on surfaces, and how fast they are read, is measured by ``bench_pointcodecs``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.kernels.point_cubes import (
    CUT_OFF,
    LEFT_OVER,
    SOUND,
    WRONG_COUNT,
    WRONG_PLACE,
    decode_cells,
    encode_cells,
    room_for_cells,
)
from workbench.kernels.point_layers import decode_layers, encode_layers, room_for_layers
from workbench.pointcodecs.context_coding import decode_contexts, encode_contexts

_WHAT_IS_WRONG = {
    CUT_OFF: "it ends too early",
    WRONG_COUNT: "another number of points",
    LEFT_OVER: "bytes that mean nothing",
    WRONG_PLACE: "a point outside the cube, or twice",
}
# Kernels look at up to three bytes at once.
_BEYOND = 3
# An arithmetic coder has at most four bytes in hand, and ends with as few as tell its last bits.
_UNWRITTEN = 4


@dataclass(frozen=True)
class CodedCubes:
    """Bytes of cubes.

    Attributes
    ----------
    data : (b,) uint8, cube after cube.
    bytes_at : (c + 1,) int64, where each begins, and where the last ends.
    order : (n,) int64, rows of the points in the order in which they are read back.
    """

    data: NDArray[np.uint8]
    bytes_at: NDArray[np.int64]
    order: NDArray[np.int64]


@dataclass(frozen=True)
class PointCodec:
    """How cubes of points become bytes.

    Attributes
    ----------
    name, number : on the command line, and in files.
    cube_level : cubes have 2**cube_level positions a side where the grid is as large.
    most_points_per_byte : that a stream without an end holds.
    """

    name: str
    number: int
    cube_level: int
    most_points_per_byte: int
    _encode: Callable[[NDArray[np.int32], NDArray[np.int64], int], CodedCubes]
    _decode: Callable[..., None]

    def encoded(
        self, points: NDArray[np.int32], starts: NDArray[np.int64], level: int
    ) -> CodedCubes:
        """Bytes of cubes of 2**level positions a side.

        Parameters
        ----------
        points
            (n, 3) places in the cubes, in [0, 2**level), no two the same in one cube.
        starts
            (c + 1,) rows where the points of each cube begin, and where the last end.
        level
            1…``cube_level``.
        """
        self._check_level(level)
        if len(points) and (points.min() < 0 or points.max() >= 1 << level):
            raise ValueError(f"a point lies outside a cube of {1 << level} positions a side")
        return self._encode(np.ascontiguousarray(points, np.int32), starts, level)

    def decoded(
        self,
        data: NDArray[np.uint8] | bytes,
        bytes_at: NDArray[np.int64],
        starts: NDArray[np.int64],
        level: int,
    ) -> NDArray[np.int32]:
        """(n, 3) points of cubes that `encoded` made, in its order.

        Raises
        ------
        InputError
            Bytes that are no such cubes; ``where`` tells the first that is not.
        """
        self._check_level(level)
        counts, sizes = np.diff(starts), np.diff(bytes_at)
        possible = (counts >= 0) & (counts <= 1 << 3 * level) & (sizes >= 0)
        possible &= counts <= self.most_points(sizes)
        if not possible.all() or bytes_at[-1] > len(data):
            cube = int(np.argmin(possible))
            raise _damaged(cube, f"{counts[cube]} points in {sizes[cube]} bytes")
        # Kernels are compiled for arrays that can be written, and read beyond the end.
        padded = np.zeros(len(data) + _BEYOND, np.uint8)
        padded[: len(data)] = np.frombuffer(data, np.uint8)
        points = np.empty((int(starts[-1]), 3), np.int32)
        status = np.empty(len(counts), np.int64)
        self._decode(padded, bytes_at, starts, level, points, status)
        wrong = np.flatnonzero(status != SOUND)
        if len(wrong):
            raise _damaged(int(wrong[0]), _WHAT_IS_WRONG[int(status[wrong[0]])])
        return points

    def most_points(self, sizes: NDArray[np.int64]) -> NDArray[np.int64]:
        """More points than cubes of so many bytes (c,) can hold are not worth a try."""
        return (sizes + _UNWRITTEN) * self.most_points_per_byte

    def _check_level(self, level: int) -> None:
        if not 1 <= level <= self.cube_level:
            raise ValueError(f"cubes of {self.name} have a level of 1 to {self.cube_level}")


def _damaged(cube: int, found: str) -> InputError:
    return InputError(
        "A cube of points is damaged.",
        where=f"cube {cube}",
        found=found,
        fix="Copy the file again, or export it anew.",
    )


def _cell_identification(
    points: NDArray[np.int32], starts: NDArray[np.int64], level: int
) -> CodedCubes:
    data, ends = _room(room_for_cells(len(points), len(starts) - 1, level), starts)
    encode_cells(points, starts, level, data, ends)
    x, y, z = points.T.astype(np.int64)
    cell = (x >> 1) << 14 | (y >> 1) << 7 | z >> 1
    label = (x & 1) << 2 | (y & 1) << 1 | z & 1
    return _cut(data, ends, np.lexsort((label, cell, _cube_of(starts))))


def _layers(points: NDArray[np.int32], starts: NDArray[np.int64], level: int) -> CodedCubes:
    # From the far corner a surface grows toward low coordinates: −1 is the shortest offset.
    begins = np.lexsort((*points.T, -points.sum(axis=1), _cube_of(starts)))
    data, ends = _room(room_for_layers(len(points), len(starts) - 1, level), starts)
    order = np.empty(len(points), np.int64)
    encode_layers(points[begins], starts, level, data, ends, order)
    return _cut(data, ends, begins[order])


def _contexts(points: NDArray[np.int32], starts: NDArray[np.int64], level: int) -> CodedCubes:
    order = np.lexsort((*points.T, _cube_of(starts)))
    parts = encode_contexts(points[order], starts, level)
    ends = np.cumsum([len(part) for part in parts])
    return _cut(np.concatenate([np.zeros(0, np.uint8), *parts]), ends, order)


def _cube_of(starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) the number of each point's cube."""
    return np.repeat(np.arange(len(starts) - 1), np.diff(starts))


def _room(size: int, starts: NDArray[np.int64]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    return np.zeros(size + _BEYOND, np.uint8), np.zeros(len(starts) - 1, np.int64)


def _cut(data: NDArray[np.uint8], ends: NDArray[Any], order: NDArray[np.int64]) -> CodedCubes:
    bytes_at = np.concatenate([[0], ends]).astype(np.int64)
    return CodedCubes(data[: bytes_at[-1]].copy(), bytes_at, order)


CODECS = {
    codec.name: codec
    for codec in (
        PointCodec("ci", 0, 5, 8, _cell_identification, decode_cells),
        PointCodec("eci", 1, 5, 3, _layers, decode_layers),
        # The surest bit costs 0.0005: 15,000 of them, and as many points, fit a byte.
        PointCodec("context", 2, 8, 1 << 14, _contexts, decode_contexts),
    )
}


def codec_named(name: str) -> PointCodec:
    """The codec of a name.

    Raises
    ------
    SettingsError
        There is none.
    """
    if name not in CODECS:
        raise SettingsError(
            "There is no such codec of points.",
            expected=", ".join(CODECS),
            found=name,
            fix="choose one of them",
        )
    return CODECS[name]
