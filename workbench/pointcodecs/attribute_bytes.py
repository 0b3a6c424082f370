"""Colours and normals of the points of one cube as bytes."""

from __future__ import annotations

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.errors import InputError

_ZSTD_LEVEL = 9
_BYTES_PER_POINT = 3
# An odd number of steps, so that the axes are hit exactly; the last value says: no normal.
_STEPS, _NONE = 4094, 4095


def color_bytes(color: NDArray[np.uint8]) -> bytes:
    """Colours (n, 3) sRGB as zstd of three planes: red, green, blue, each less the point before."""
    steps = color.copy()
    steps[1:] -= color[:-1]
    return _packed(steps.T)


def colors_of(data: bytes, count: int) -> NDArray[np.uint8]:
    """What `color_bytes` packed, (count, 3)."""
    return np.cumsum(_planes(data, count).T, axis=0, dtype=np.uint8)


def normal_bytes(normals: NDArray[np.float32]) -> bytes:
    """Unit normals (n, 3) as zstd of 12 bits for each coordinate on an octahedron.

    The sphere is laid out on a square by its projection on the octahedron |x| + |y| + |z| = 1,
    whose lower half is folded outward (Cigolle et al. 2014, "A survey of efficient
    representations for independent unit vectors", section 3.2). Planes: low bytes of both
    coordinates, and their high halves together. Coordinates of 4095 say that there is no
    normal. A normal moves by 0.06° at most.
    """
    size = np.abs(normals).sum(axis=1, keepdims=True, dtype=np.float64)
    known = (size > 0)[:, 0]
    x, y, z = (normals / np.where(size > 0, size, 1.0)).T
    folded_x = (1 - np.abs(y)) * np.where(x >= 0, 1.0, -1.0)
    folded_y = (1 - np.abs(x)) * np.where(y >= 0, 1.0, -1.0)
    flat = np.stack([np.where(z < 0, folded_x, x), np.where(z < 0, folded_y, y)])
    steps = np.rint((flat + 1) * (0.5 * _STEPS)).astype(np.uint16)
    u, v = np.where(known, steps, _NONE)
    return _packed(np.stack([u & 255, v & 255, u >> 8 | v >> 8 << 4]).astype(np.uint8))


def normals_of(data: bytes, count: int) -> NDArray[np.float32]:
    """What `normal_bytes` packed, (count, 3) float32; zero where there is none."""
    low_u, low_v, high = _planes(data, count).astype(np.int64)
    u, v = low_u | (high & 15) << 8, low_v | (high >> 4) << 8
    x, y = u * (2 / _STEPS) - 1, v * (2 / _STEPS) - 1
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    normals = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[(u == _NONE) & (v == _NONE)] = 0
    return normals.astype(np.float32)


def _packed(planes: NDArray[np.uint8]) -> bytes:
    return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(planes.tobytes())


def _planes(data: bytes, count: int) -> NDArray[np.uint8]:
    """(3, count); a packed size that differs is not even tried."""
    expected = _BYTES_PER_POINT * count
    try:
        size = zstandard.frame_content_size(data)
        if size != expected:
            raise _damaged(f"{size} bytes, {expected} expected")
        plain = zstandard.ZstdDecompressor().decompress(data)
    except zstandard.ZstdError as error:
        raise _damaged(str(error)) from error
    return np.frombuffer(plain, np.uint8).reshape(_BYTES_PER_POINT, count)


def _damaged(found: str) -> InputError:
    return InputError(
        "The colours or normals of a cube are damaged.",
        found=found,
        fix="Copy the file again, or export it anew.",
    )
