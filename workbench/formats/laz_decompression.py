"""Points of LAZ files as they were before compression.

Source: M. Isenburg, *LASzip*. The work is done by lazrs. It trusts the sizes inside a file, which
are checked here before it sees them, and goes wherever false symbols of times lead: it does not
see them, or it does so where nothing else ends with it.
"""

from __future__ import annotations

import atexit
import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import lazrs
import numpy as np

from workbench.formats import laz_process
from workbench.formats.las_layout import LasLayout, refused

_ITEMS_AT = 34
# From this kind on parts of points are compressed in layers of a chunk, so many for a kind.
_LAYERED = 10
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTES_ITEM = 14
_ITEM_BYTES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}
_ITEMS_OF_ANY_SIZE = (0, _BYTES_ITEM)
_MOST_CHUNK_POINTS = 1 << 32
# Places, colours and further numbers. Of times, above all, nothing is decompressed.
_NEEDED = lazrs.DecompressionSelection(
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
    | lazrs.SELECTIVE_DECOMPRESS_Z
    | lazrs.SELECTIVE_DECOMPRESS_RGB
    | lazrs.SELECTIVE_DECOMPRESS_ALL_EXTRA_BYTES
)


class Records(Protocol):
    """What gives uncompressed points as bytes, from the first on."""

    def many(self, number: int) -> bytes | bytearray:
        """The next ones; fewer bytes than they have where a file ends."""


@contextmanager
def decompressed(file: BinaryIO, layout: LasLayout, laszip: bytes, path: Path) -> Iterator[Records]:
    """The points of a LAZ file. What `PointSet` has no use for may be of no meaning.

    Parameters
    ----------
    laszip
        The record that tells how they are compressed.

    Raises
    ------
    InputError
        Sizes in the file cannot be true. Reading may raise whatever lazrs does.
    """
    items, layers = _items(laszip, path)
    if items != layout.point_bytes:
        refused(path, "The LAZ file compresses points of another size than it declares.",
                f"{layout.point_bytes} bytes", f"{items} bytes")  # fmt: skip
    _check_chunks(file, layout, laszip, layers, path)
    if layers:
        file.seek(layout.points_start)
        yield _Layered(file, layout, laszip)
    else:
        with _process() as process:
            yield _PointByPoint(process, layout, laszip, path)


class _Layered:
    def __init__(self, file: BinaryIO, layout: LasLayout, laszip: bytes) -> None:
        self._points = lazrs.LasZipDecompressor(file, laszip, _NEEDED)
        self._bytes = layout.point_bytes

    def many(self, number: int) -> bytearray:
        data = bytearray(number * self._bytes)
        self._points.decompress_many(data)
        return data


class _PointByPoint:
    """Points one after another, by a process of its own.

    A symbol of a time may say: look at the next one. lazrs follows by calling itself, and a byte
    of likely symbols is some 36,000 of them: a few hundred bytes end the process that reads them.
    """

    def __init__(self, process: _Process, layout: LasLayout, laszip: bytes, path: Path) -> None:
        self._process, self._bytes = process, layout.point_bytes
        start = layout.points_start
        process.ask({"path": str(path.absolute()), "start": start, "laszip": laszip.hex()})

    def many(self, number: int) -> bytes:
        return self._process.ask({"bytes": number * self._bytes})


class _Process:
    """What `laz_process` does, for one file after another."""

    def __init__(self) -> None:
        self.answered = True
        self._process = subprocess.Popen(
            [sys.executable, "-P", laz_process.__file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # panics, which are answers too
            start_new_session=True,  # an interrupt is for those who ask
        )

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._process.poll() is None

    def ask(self, order: dict[str, Any]) -> bytes:
        """Its answer; ValueError with the reason where there is none."""
        orders, answers = self._process.stdin, self._process.stdout
        assert orders is not None
        assert answers is not None
        self.answered = False
        with suppress(BrokenPipeError):
            orders.write(json.dumps(order).encode() + b"\n")
            orders.flush()
        head = answers.read(laz_process.ANSWER.size)
        failed, size = laz_process.ANSWER.unpack(head) if head else (True, 0)
        data = answers.read(size)
        if not head or len(data) < size:
            raise ValueError(f"decompression ended its process ({self._process.wait()})")
        self.answered = True
        if failed:
            raise ValueError(data.decode())
        return data

    def end(self) -> None:
        """Whatever it does."""
        self._process.kill()
        self._process.communicate()


@contextmanager
def _process() -> Iterator[_Process]:
    """One that has nothing else to do."""
    process = _ready()
    try:
        yield process
    finally:
        if process.answered:
            with suppress(ValueError):  # ended from outside, when all is read
                process.ask(laz_process.CLOSE)
        if process.answered:
            _idle.append(process)
        else:
            process.end()


def _ready() -> _Process:
    with suppress(IndexError):
        while True:
            process = _idle.pop()
            if process.alive:
                return process
    return _Process()


def _end_idle() -> None:
    while _idle:
        _idle.pop().end()


_idle: list[_Process] = []
atexit.register(_end_idle)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # they answer one process only


def _items(laszip: bytes, path: Path) -> tuple[int, int]:
    """Bytes of a point, and into how many layers its chunks are parted (0: none)."""
    number = struct.unpack_from("<H", laszip, 32)[0] if len(laszip) >= _ITEMS_AT else 0
    if not number or len(laszip) < _ITEMS_AT + 6 * number:
        refused(path, "The LAZ file does not tell how it is compressed.",
                "a LASzip record", f"{len(laszip)} bytes")  # fmt: skip
    items = np.frombuffer(laszip, "<u2", 3 * number, _ITEMS_AT).reshape(-1, 3).tolist()
    for kind, size, _ in items:
        # The decompressor goes by the kind alone, and would take layers for what they are not.
        if (
            size != _ITEM_BYTES.get(kind, size)
            or kind not in (*_ITEM_BYTES, *_ITEMS_OF_ANY_SIZE)
            or (kind >= _LAYERED) != (items[0][0] >= _LAYERED)
        ):
            refused(path, "The LAZ file compresses an unknown part of points.",
                    "parts as LASzip has them", f"part {kind} of {size} bytes")  # fmt: skip
    layers = sum(size if kind == _BYTES_ITEM else _LAYERS.get(kind, 0) for kind, size, _ in items)
    return sum(size for _, size, _ in items), layers


def _check_chunks(
    file: BinaryIO, layout: LasLayout, laszip: bytes, layers: int, path: Path
) -> None:
    """Chunks lie in the file, their layers fill them, and they hold the declared points."""
    start, end = layout.points_start, layout.file_bytes
    file.seek(start)
    table = struct.unpack("<q", _exactly(file, 8, path))[0]
    if table == -1:
        file.seek(end - 8)
        table = struct.unpack("<q", _exactly(file, 8, path))[0]
    if not start + 8 <= table <= end - 8:
        refused(path, "The table of chunks of the LAZ file is not there.",
                f"between byte {start + 8} and {end - 8}", f"byte {table}")  # fmt: skip
    file.seek(table)
    _, number = struct.unpack("<II", _exactly(file, 8, path))
    if (number - 1) * layout.point_bytes > end - start:
        refused(path, "The LAZ file declares more chunks than it can hold.",
                f"at most {(end - start) // layout.point_bytes + 1}", str(number))  # fmt: skip
    file.seek(start)
    chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(laszip))
    at, points = start + 8, 0
    for held, size in chunks:
        if size < 0 or at + size > table or held > _MOST_CHUNK_POINTS:
            refused(path, "A chunk of the LAZ file ends behind the last one.",
                    f"at most byte {table}", f"byte {at + size}")  # fmt: skip
        # The decompressor passes by a chunk without points unless it is the first, and goes on
        # behind the last layer, wherever the table says that the next chunk begins.
        if layers and points < layout.count:
            read = held > 0 or at == start + 8
            layered = _layered_bytes(file, at, layout.point_bytes, layers, path) if read else 0
            if layered != size:
                refused(path, "The layers of a chunk of the LAZ file do not fill it.",
                        f"{size} bytes from byte {at} on", f"{layered} bytes")  # fmt: skip
        at, points = at + size, points + held
    if points < layout.count:
        refused(path, "The LAZ file has fewer points than it declares.",
                f"{layout.count} points", f"{points} points")  # fmt: skip


def _layered_bytes(file: BinaryIO, at: int, point_bytes: int, layers: int, path: Path) -> int:
    """Bytes of a chunk: its first point, how many points it has, and what its layers have."""
    file.seek(at + point_bytes + 4)
    sizes = np.frombuffer(_exactly(file, 4 * layers, path), "<u4")
    return point_bytes + 4 + 4 * layers + int(sizes.sum(dtype=np.int64))


def _exactly(file: BinaryIO, size: int, path: Path) -> bytes:
    data = file.read(size)
    if len(data) != size:
        refused(path, "The LAZ file ends early.", f"{size} more bytes", f"{len(data)}")
    return data
