"""ICC profiles of RGB pictures: writing linear ones, linearising pictures by theirs.

Source: International Color Consortium, *Specification ICC.1:2010* (profile version 4.3), and
version 2.4 for the profiles written here, which every viewer reads.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_D50 = (0.9642, 1.0, 0.8249)
_HEADER_BYTES, _ENTRY_BYTES = 128, 12
# Parametric curves, ICC.1:2010, 10.16: how many parameters each type has.
_PARAMETERS = (1, 3, 4, 5, 7)
_LEVELS = 65536


@dataclass(frozen=True)
class MatrixProfile:
    """A profile of three curves and a matrix.

    Attributes
    ----------
    curves : (3, 65536) float32, linear light in [0, 1] of every 16-bit value of R, G and B.
    xyz_d50_from_rgb : (3, 3) from linear RGB to CIE XYZ relative to D50, Y of white 1.
    """

    curves: NDArray[np.float32]
    xyz_d50_from_rgb: NDArray[np.float64]

    def linear(self, picture: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float32]:
        """Linear RGB (h, w, 3) float32 in [0, 1] of an encoded picture (h, w, 3)."""
        step = 257 if picture.dtype == np.uint8 else 1
        light = np.empty(picture.shape, np.float32)
        for k in range(3):
            light[..., k] = self.curves[k, ::step][picture[..., k]]
        return light


def linear_rgb_profile(xyz_d50_from_rgb: ArrayLike, name: str) -> bytes:
    """A version 2 display profile of linear RGB; the same arguments give the same bytes.

    Parameters
    ----------
    xyz_d50_from_rgb : (3, 3) to CIE XYZ relative to D50; (1, 1, 1) must give the white D50.
    name : plain ASCII, shown to people.
    """
    text = name.encode("ascii")
    described = struct.pack(">4sII", b"desc", 0, len(text) + 1) + text + b"\0"
    described += bytes(4 + 4 + 2 + 1 + 67)
    parts = {
        b"desc": described,
        b"cprt": struct.pack(">4sI", b"text", 0) + b"No copyright.\0",
        b"wtpt": _xyz(_D50),
    }
    columns = np.asarray(xyz_d50_from_rgb, float).T
    for letter, column in zip("rgb", columns, strict=True):
        parts[f"{letter}XYZ".encode()] = _xyz(column)
        # A curve of no points is the identity: linear light.
        parts[f"{letter}TRC".encode()] = struct.pack(">4sII", b"curv", 0, 0)
    table, data = b"", b""
    start = _HEADER_BYTES + 4 + _ENTRY_BYTES * len(parts)
    for signature, part in parts.items():
        table += struct.pack(">4sII", signature, start + len(data), len(part))
        data += part + bytes(-len(part) % 4)
    size = start + len(data)
    date = struct.pack(">6H", 2024, 1, 1, 0, 0, 0)
    header = struct.pack(">I4sI4s4s4s", size, b"\0\0\0\0", 0x02400000, b"mntr", b"RGB ", b"XYZ ")
    header += date + b"acsp" + bytes(4 + 4 + 4 + 4 + 8)
    header += struct.pack(">I", 0) + _s15(_D50)
    header = header.ljust(_HEADER_BYTES, b"\0")
    return header + struct.pack(">I", len(parts)) + table + data


def read_matrix_profile(profile: bytes) -> MatrixProfile | None:
    """The curves and matrix of an RGB profile; None where it is damaged or of another kind."""
    try:
        if profile[16:20] != b"RGB ":
            return None
        tags = _tags(profile)
        curves = [_curve(tags[f"{letter}TRC".encode()]) for letter in "rgb"]
        columns = [
            [value / 65536 for value in struct.unpack(">3i", tags[f"{letter}XYZ".encode()][8:20])]
            for letter in "rgb"
        ]
    except (KeyError, ValueError, IndexError, struct.error):
        return None
    return MatrixProfile(np.array(curves, np.float32), np.array(columns).T)


def srgb_profile() -> MatrixProfile:
    """IEC 61966-2-1, what a picture without a profile is taken for."""
    level = np.linspace(0.0, 1.0, _LEVELS)
    light = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    matrix = [
        [0.4360747, 0.3850649, 0.1430804],
        [0.2225045, 0.7168786, 0.0606169],
        [0.0139322, 0.0971045, 0.7141733],
    ]
    return MatrixProfile(np.tile(light.astype(np.float32), (3, 1)), np.array(matrix))


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, _HEADER_BYTES)
    if count > 1000:
        raise ValueError("too many tags")
    found = {}
    for k in range(count):
        place = _HEADER_BYTES + 4 + _ENTRY_BYTES * k
        signature, offset, size = struct.unpack_from(">4sII", profile, place)
        found[signature] = profile[offset : offset + size]
    return found


def _curve(tag: bytes) -> NDArray[np.float64]:
    """Linear light of every 16-bit value."""
    level = np.linspace(0.0, 1.0, _LEVELS)
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        values = np.frombuffer(tag, ">u2", count, 12)
        if count == 0:
            return level
        if count == 1:
            return np.asarray(level ** (values[0] / 256.0))
        return np.interp(level, np.linspace(0.0, 1.0, count), values / 65535.0)
    if tag[:4] != b"para":
        raise ValueError("neither a sampled nor a parametric curve")
    (kind,) = struct.unpack_from(">H", tag, 8)
    numbers = [n / 65536 for n in struct.unpack_from(f">{_PARAMETERS[kind]}i", tag, 12)]
    g, (a, b, c, d, e, f) = numbers[0], _filled(kind, numbers)
    power = np.maximum(a * level + b, 0.0) ** g + e
    return np.clip(np.where(level >= d, power, c * level + f), 0.0, 1.0)


def _filled(kind: int, numbers: list[float]) -> list[float]:
    """a, b, c, d, e, f of the longest form from those of a shorter one."""
    if kind == 0:
        return [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    a, b = numbers[1:3]
    if kind == 1:
        return [a, b, 0.0, -b / a, 0.0, 0.0]
    if kind == 2:
        return [a, b, 0.0, -b / a, numbers[3], numbers[3]]
    c, d = numbers[3:5]
    return [a, b, c, d, *(numbers[5:7] if kind == 4 else [0.0, 0.0])]


def _xyz(values: ArrayLike) -> bytes:
    return struct.pack(">4sI", b"XYZ ", 0) + _s15(values)


def _s15(values: ArrayLike) -> bytes:
    """Numbers as signed fixed point with sixteen bits behind the point."""
    numbers = np.rint(np.asarray(values, float) * 65536).astype(int)
    return struct.pack(f">{len(numbers)}i", *numbers.tolist())
