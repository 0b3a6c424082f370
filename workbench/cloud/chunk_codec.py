"""Lossless bytes of one attribute of one chunk.

An attribute is cut into byte planes (``workbench.kernels.chunk_planes``). A plane whose
bytes are all alike keeps one byte, one that looks random is kept as it is, the rest go
through zstd: compressing noise costs time and gains nothing. Every value carries a CRC-32.
"""

from __future__ import annotations

import struct
import threading
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.cloud.schema import Attribute
from workbench.errors import InputError
from workbench.kernels import chunk_planes as kernels

_POSITIONS, _PLAIN, _UNIT = 1, 2, 3
_CRC, _HEAD = struct.Struct("<I"), struct.Struct("<IB")
_CONSTANT, _RAW, _ZSTD = 0, 1, 2
#: zstd's own entropy coder wins nothing above this.
_RANDOM_BITS_PER_BYTE = 7.8
#: So many samples show whether steps cost less.
_PROBE = 4096
_local = threading.local()


@dataclass(frozen=True)
class EncodedPositions:
    """Positions of a chunk and the order they were put in.

    Attributes
    ----------
    value : the bytes to store.
    order : (n,) int32; other attributes of the chunk follow it.
    """

    value: bytes
    order: NDArray[np.int32]


def encode_positions(points: NDArray[np.float64], level: int) -> EncodedPositions:
    """Positions (n, 3) float64 in Morton order, compressed with zstd ``level``."""
    points = np.ascontiguousarray(points)
    bits = points.view(np.uint64)
    exponents = kernels.grid_exponents(points, bits)
    local, base, shifts = kernels.local_integers(points, bits, exponents)
    order, keys = kernels.sorted_order(kernels.morton_codes(local, shifts))
    planes = kernels.position_planes(local, order, keys, shifts)
    frame = base.tobytes() + shifts.astype("<i8").tobytes() + exponents.astype("<i8").tobytes()
    body = frame + _packed(planes, kernels.plane_bits(planes), level)
    return EncodedPositions(_sealed(_POSITIONS, len(points), body), order)


def encode_attribute(values: NDArray[Any], level: int) -> bytes:
    """An attribute (n,) or (n, k) of a chunk, in the order of its positions."""
    values = np.ascontiguousarray(values)
    n = len(values)
    if values.dtype == np.float32 and values.ndim == 2 and values.shape[1] == 3:
        unit, dropped, parts = kernels.unit_vector_parts(values, values.view(np.uint32))
        if unit:
            coded = [_cheaper_columns(dropped[None], level), _cheaper_columns(parts, level)]
            return _sealed(_UNIT, n, struct.pack("<I", len(coded[0])) + b"".join(coded))
    whole = values.view(f"<u{values.itemsize}").reshape(n, -1)
    return _sealed(_PLAIN, n, _cheaper_columns(np.ascontiguousarray(whole.T), level))


def decode(value: bytes, attribute: Attribute, source: str) -> NDArray[Any]:
    """The array that was encoded.

    Raises
    ------
    InputError
        naming ``source`` where the bytes are damaged or not of this attribute.
    """
    method, n, body = _opened(value, source)
    try:
        if method == _POSITIONS:
            return _decoded_positions(body, n)
        if method == _UNIT:
            (split,) = struct.unpack_from("<I", body)
            dropped = _columns(body[4 : 4 + split], n, 1, np.dtype("u1"))
            parts = _columns(body[4 + split :], n, 3, np.dtype("<u4"))
            bits = kernels.unit_vectors_from_parts(dropped[0], parts)
            return np.asarray(bits.view(np.float32))
        width = np.dtype(f"<u{np.dtype(attribute.dtype).itemsize}")
        columns = _columns(body, n, attribute.components, width)
        return np.ascontiguousarray(columns.T).view(attribute.dtype).reshape(attribute.shape(n))
    except (ValueError, IndexError, struct.error, zstandard.ZstdError) as error:
        raise _damaged(source, str(error)) from error


def _decoded_positions(body: memoryview, n: int) -> NDArray[np.float64]:
    base = np.frombuffer(body, "<u8", 3)
    shifts = np.frombuffer(body, "<i8", 3, 24)
    exponents = np.frombuffer(body, "<i8", 3, 48)
    planes = _unpacked(body[72:], n)
    points = np.empty((n, 3))
    kernels.points_from_planes(planes, base, shifts, exponents, points, points.view(np.uint64))
    return points


def _sealed(method: int, n: int, body: bytes) -> bytes:
    head = _HEAD.pack(n, method)
    return _CRC.pack(zlib.crc32(body, zlib.crc32(head))) + head + body


def _opened(value: bytes, source: str) -> tuple[int, int, memoryview]:
    if len(value) < _CRC.size + _HEAD.size:
        raise _damaged(source, "a chunk is cut short")
    (crc,) = _CRC.unpack_from(value)
    if zlib.crc32(memoryview(value)[_CRC.size :]) != crc:
        raise _damaged(source, "a checksum does not match")
    n, method = _HEAD.unpack_from(value, _CRC.size)
    return method, n, memoryview(value)[_CRC.size + _HEAD.size :]


def _damaged(source: str, found: str) -> InputError:
    return InputError(
        "a point cloud is damaged",
        file=source,
        found=found,
        fix="restore the file from a copy or build it again",
    )


def _cheaper_columns(columns: NDArray[Any], level: int) -> bytes:
    """Unsigned integers (k, n), each column as it is or as steps, whichever has less entropy."""
    modes, planes = bytearray(), []
    for column in columns:
        first = column[:_PROBE]
        plain, steps = (kernels.plane_bits(_bytes_apart(c)).sum()
                        for c in (first, kernels.zigzag_steps(first)))  # fmt: skip
        modes.append(int(steps < plain))
        planes.append(_bytes_apart(kernels.zigzag_steps(column) if steps < plain else column))
    together = np.concatenate(planes)
    return bytes(modes) + _packed(together, kernels.plane_bits(together), level)


def _bytes_apart(column: NDArray[Any]) -> NDArray[np.uint8]:
    """(itemsize, n) uint8 planes, low bytes first."""
    return np.ascontiguousarray(column.view(np.uint8).reshape(len(column), -1).T)


def _columns(body: memoryview, n: int, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    modes = body[:count]
    planes = _unpacked(body[count:], n).reshape(count, dtype.itemsize, n)
    columns = np.empty((count, n), dtype)
    for k in range(count):
        values = np.ascontiguousarray(planes[k].T).view(dtype).reshape(n)
        columns[k] = kernels.from_zigzag_steps(values) if modes[k] else values
    return columns


def _packed(planes: NDArray[np.uint8], bits: NDArray[np.float64], level: int) -> bytes:
    """Number of planes, then kind and length of each, then their bytes."""
    n = planes.shape[1]
    heads, bodies = [struct.pack("<H", len(planes))], []
    for plane, entropy in zip(planes, bits, strict=True):
        if entropy == 0.0:
            kind, body = _CONSTANT, plane[:1].tobytes()
        elif entropy > _RANDOM_BITS_PER_BYTE * n:
            kind, body = _RAW, plane.tobytes()
        else:
            kind, body = _ZSTD, _compressor(level).compress(plane.data)
            if len(body) >= n:
                kind, body = _RAW, plane.tobytes()
        heads.append(struct.pack("<BI", kind, len(body)))
        bodies.append(body)
    return b"".join(heads + bodies)


def _unpacked(body: memoryview, n: int) -> NDArray[np.uint8]:
    (count,) = struct.unpack_from("<H", body)
    planes = np.empty((count, n), np.uint8)
    at = 2 + 5 * count
    for k in range(count):
        kind, length = struct.unpack_from("<BI", body, 2 + 5 * k)
        piece = body[at : at + length]
        at += length
        if kind == _CONSTANT:
            planes[k] = piece[0]
        elif kind == _RAW:
            planes[k] = np.frombuffer(piece, np.uint8)
        else:
            # The library makes room for what the frame says, whatever it is told here.
            if zstandard.frame_content_size(piece) != n:
                raise ValueError("a plane of another size")
            plain = _decompressor().decompress(piece)
            planes[k] = np.frombuffer(plain, np.uint8)
    return planes


def _compressor(level: int) -> zstandard.ZstdCompressor:
    """The thread's own: a compressor serves one thread at a time."""
    kept: dict[int, zstandard.ZstdCompressor] = _local.__dict__.setdefault("compressors", {})
    if level not in kept:
        kept[level] = zstandard.ZstdCompressor(level=level, write_content_size=True)
    return kept[level]


def _decompressor() -> zstandard.ZstdDecompressor:
    kept = _local.__dict__.get("decompressor")
    if kept is None:
        kept = _local.decompressor = zstandard.ZstdDecompressor()
    return kept
