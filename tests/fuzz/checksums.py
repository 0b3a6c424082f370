"""Check sums put right after damage, so that readers are tried behind them too."""

from __future__ import annotations

import functools
import io
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np
import zstandard

_PAGE = 1024


def repaired_png(data: bytes) -> bytes:
    """CRC-32 of every chunk of a PNG file."""
    out, at = bytearray(data), 8
    while at + 12 <= len(out):
        (size,) = struct.unpack_from(">I", out, at)
        if at + 12 + size > len(out):
            break
        struct.pack_into(">I", out, at + 8 + size, zlib.crc32(out[at + 4 : at + 8 + size]))
        at += 12 + size
    return bytes(out)


def repaired_graph(data: bytes) -> bytes:
    """CRC-32 of a file of a voxel graph."""
    return data[:12] + struct.pack("<I", zlib.crc32(data[16:])) + data[16:]


def repaired_indexed(
    header: np.dtype[np.void], node: np.dtype[np.void], parts: tuple[tuple[str, str, str], ...]
) -> Callable[[bytes], bytes]:
    """CRC-32 of header, index and parts of a file of `workbench.formats.indexed_file`.

    ``parts`` are names of the fields of offset, size and check sum.
    """

    def repaired(data: bytes) -> bytes:
        if len(data) < header.itemsize:
            return data
        out = bytearray(data)
        head = np.frombuffer(out, header, 1)
        start = int(head["index_offset"][0])
        if header.itemsize <= start < len(out):
            index = np.frombuffer(out, node, (len(out) - start) // node.itemsize, start)
            for record in index:
                for offset, size, crc in parts:
                    at = int(record[offset])
                    record[crc] = zlib.crc32(out[at : at + int(record[size])])
            head["index_crc"] = zlib.crc32(out[start:])
        head["header_crc"] = zlib.crc32(out[: header.itemsize - 4])
        return bytes(out)

    return repaired


def repaired_cubes(header: np.dtype[np.void], cube: np.dtype[np.void]) -> Callable[[bytes], bytes]:
    """CRC-32 of a file of point cubes, its index packed anew with those of its parts."""

    def repaired(data: bytes) -> bytes:
        if len(data) < header.itemsize:
            return data
        head = np.frombuffer(bytearray(data[: header.itemsize]), header)
        start = int(head["index_offset"][0])
        body, index = data[header.itemsize : start], data[start:]
        if header.itemsize <= start <= len(data):
            index = _cubes_with_sums(body, index, cube)
        head["index_crc"] = zlib.crc32(index)
        head["header_crc"] = zlib.crc32(head.tobytes()[:-4])
        return head.tobytes() + body + index

    return repaired


def _cubes_with_sums(body: bytes, index: bytes, cube: np.dtype[np.void]) -> bytes:
    try:
        if not 0 < zstandard.frame_content_size(index) <= 1 << 20:
            return index
        planes = zstandard.ZstdDecompressor().decompress(index)
    except zstandard.ZstdError:
        return index
    count = len(planes) // cube.itemsize
    if not count:
        return index
    rows = np.frombuffer(planes, np.uint8, count * cube.itemsize).reshape(cube.itemsize, count).T
    records = rows.copy().view(cube).reshape(-1)
    at = 0
    for name in ("geometry", "color", "normal"):
        for record in records:
            size = int(record[f"{name}_bytes"])
            record[f"{name}_crc"] = zlib.crc32(body[at : at + size]) if size else 0
            at += size
    planes = np.ascontiguousarray(records.view(np.uint8).reshape(count, -1).T).tobytes()
    return zstandard.ZstdCompressor().compress(planes)


def repaired_zip(data: bytes) -> bytes:
    """CRC-32 of the members of a ZIP archive whose members are stored as they are."""
    out = bytearray(data)
    central = out.find(b"PK\x01\x02")
    while 0 <= central <= len(out) - 46:
        size, _, name = struct.unpack_from("<IIH", out, central + 20)
        (local,) = struct.unpack_from("<I", out, central + 42)
        if local + 30 <= len(out):
            before = sum(struct.unpack_from("<HH", out, local + 26))
            start = local + 30 + before
            crc = struct.pack("<I", zlib.crc32(out[start : start + size]))
            out[local + 14 : local + 18] = out[central + 16 : central + 20] = crc
        central = out.find(b"PK\x01\x02", central + 46 + name)
    return bytes(out)


def stored_zip(members: dict[str, bytes]) -> bytes:
    """A ZIP archive of members as they are."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return file.getvalue()


def _crc32c_table() -> list[int]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


_CRC32C = _crc32c_table()


def repaired_e57(data: bytes) -> bytes:
    """CRC-32C at the end of every page of an E57 file, where it does not fit."""
    out = bytearray(data)
    for start in range(0, len(out) - _PAGE + 1, _PAGE):
        end = start + _PAGE - 4
        struct.pack_into(">I", out, end, _crc32c(bytes(out[start:end])))
    return bytes(out)


@functools.lru_cache(1024)  # most pages are those of the file that was damaged
def _crc32c(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _CRC32C[(crc ^ byte) & 255] ^ crc >> 8
    return crc ^ 0xFFFFFFFF
