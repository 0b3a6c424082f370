"""Adobe DNG files with an uncompressed Bayer mosaic, written byte for byte the same.

Source: Adobe, *Digital Negative (DNG) Specification*, version 1.4.0.0 (2012), on top of
TIFF 6.0 (1992) and Exif 2.3 (CIPA DC-008-2012).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing

CfaPattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]

_CHANNEL = {"R": 0, "G": 1, "B": 2}
_STANDARD_LIGHT_A, _D65 = 17, 21
_FLASH_FIRED, _NO_FLASH = 0x0009, 0x0010
_CENTIMETRE = 3
# TIFF field types: code and struct letter.
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL = 1, 2, 3, 4, 5
_UNDEFINED, _SRATIONAL, _DOUBLE = 7, 10, 12
_LETTER = {_BYTE: "B", _SHORT: "H", _LONG: "I", _DOUBLE: "d"}
_HEADER_BYTES = 8

Values = Sequence[float] | Sequence[int] | bytes | str
Entry = tuple[int, int, Values]


@dataclass(frozen=True)
class DngMetadata:
    """Everything a DNG says beside its mosaic.

    Attributes
    ----------
    make, model, lens_model, serial_number, software : plain ASCII.
    taken_at : local time of the exposure, to the second.
    cfa : colours of the upper left 2×2 photosites, row by row.
    black_level, white_level : digital numbers of no light and of saturation.
    color_matrix_a, color_matrix_d65 : (3, 3) from CIE XYZ to camera RGB for the illuminants
        A and D65 (tags ColorMatrix1 and ColorMatrix2).
    as_shot_neutral : (3,) camera RGB of a white surface, largest 1.
    noise_profile : (scale, offset) of the variance of the signal in [0, 1], or none.
    exposure_time_s, f_number, iso, focal_length_mm : as set.
    pixel_pitch_mm : distance between photosites; gives the focal-plane resolution.
    focal_length_35mm : equivalent for a 36 mm wide frame, rounded.
    flash_fired : whether the flash lit the picture.
    """

    make: str
    model: str
    lens_model: str
    serial_number: str
    software: str
    taken_at: datetime
    cfa: CfaPattern
    black_level: int
    white_level: int
    color_matrix_a: ArrayLike
    color_matrix_d65: ArrayLike
    as_shot_neutral: tuple[float, float, float]
    noise_profile: tuple[float, float] | None
    exposure_time_s: float
    f_number: float
    iso: int
    focal_length_mm: float
    pixel_pitch_mm: float
    focal_length_35mm: int
    flash_fired: bool


def write_dng(
    path: Path,
    mosaic: NDArray[np.uint16],
    metadata: DngMetadata,
    preview: NDArray[np.uint8] | None = None,
) -> None:
    """Write a mosaic as a DNG, whole or not at all.

    Parameters
    ----------
    path : file to make or replace; its folder must exist.
    mosaic : (rows, cols) uint16 digital numbers, black level included.
    metadata : what the tags say.
    preview : (h, w, 3) uint8 sRGB-encoded small picture for file browsers; a grey pixel
        block where none is given.

    Raises
    ------
    InputError
        The mosaic is not two-dimensional, has an odd side, or exceeds 4 GB.
    """
    if mosaic.ndim != 2 or mosaic.shape[0] % 2 or mosaic.shape[1] % 2:
        raise InputError(
            "This array is no Bayer mosaic.",
            file=path,
            expected="rows × cols, both even",
            found=" × ".join(map(str, mosaic.shape)),
        )
    if mosaic.nbytes >= 2**32 - 2**20:
        raise InputError("A DNG cannot hold this mosaic.", file=path, expected="less than 4 GB")
    small = np.full((16, 16, 3), 64, np.uint8) if preview is None else preview
    head = _head_bytes(mosaic.shape, small.shape, metadata)
    with replacing(path) as partial, partial.open("wb") as file:
        file.write(head)
        file.write(np.ascontiguousarray(small, np.uint8).tobytes())
        file.write(b"\0" * (small.size % 2))
        file.write(np.ascontiguousarray(mosaic, "<u2").data)


def _head_bytes(
    shape: tuple[int, ...], preview_shape: tuple[int, ...], metadata: DngMetadata
) -> bytes:
    """All directories; the preview and then the mosaic follow without a gap.

    Directories refer to each other and to the pixels by offset, and no value's size depends
    on an offset: a first pass with zeros measures, a second one fills in.
    """
    preview_bytes = int(np.prod(preview_shape))
    offsets = dict.fromkeys(("raw", "exif", "preview_pixels", "raw_pixels"), 0)
    parts: list[bytes] = []
    for _ in range(2):
        place = _HEADER_BYTES
        parts = []
        for name, entries in (
            ("main", _main_entries(preview_shape, metadata, offsets)),
            ("raw", _raw_entries(shape, metadata, offsets)),
            ("exif", _exif_entries(metadata)),
        ):
            offsets[name] = place
            parts.append(_directory(entries, place))
            place += len(parts[-1])
        offsets["preview_pixels"] = place
        offsets["raw_pixels"] = place + preview_bytes + preview_bytes % 2
    return struct.pack("<2sHI", b"II", 42, _HEADER_BYTES) + b"".join(parts)


def _main_entries(
    preview_shape: tuple[int, ...], metadata: DngMetadata, offsets: dict[str, int]
) -> list[Entry]:
    taken = metadata.taken_at.strftime("%Y:%m:%d %H:%M:%S")
    lens = (metadata.focal_length_mm,) * 2 + (metadata.f_number,) * 2
    return [
        (254, _LONG, [1]),
        (256, _LONG, [preview_shape[1]]),
        (257, _LONG, [preview_shape[0]]),
        (258, _SHORT, [8, 8, 8]),
        (259, _SHORT, [1]),
        (262, _SHORT, [2]),
        (271, _ASCII, metadata.make),
        (272, _ASCII, metadata.model),
        (273, _LONG, [offsets["preview_pixels"]]),
        (274, _SHORT, [1]),
        (277, _SHORT, [3]),
        (278, _LONG, [preview_shape[0]]),
        (279, _LONG, [int(np.prod(preview_shape))]),
        (284, _SHORT, [1]),
        (305, _ASCII, metadata.software),
        (306, _ASCII, taken),
        (330, _LONG, [offsets["raw"]]),
        (34665, _LONG, [offsets["exif"]]),
        (50706, _BYTE, bytes([1, 4, 0, 0])),
        (50707, _BYTE, bytes([1, 3, 0, 0])),
        (50708, _ASCII, f"{metadata.make} {metadata.model}"),
        (50721, _SRATIONAL, np.asarray(metadata.color_matrix_a, float).ravel().tolist()),
        (50722, _SRATIONAL, np.asarray(metadata.color_matrix_d65, float).ravel().tolist()),
        (50727, _RATIONAL, [1.0, 1.0, 1.0]),
        (50728, _RATIONAL, list(metadata.as_shot_neutral)),
        (50730, _SRATIONAL, [0.0]),
        (50731, _RATIONAL, [1.0]),
        (50732, _RATIONAL, [1.0]),
        (50734, _RATIONAL, [1.0]),
        (50735, _ASCII, metadata.serial_number),
        (50736, _RATIONAL, lens),
        (50778, _SHORT, [_STANDARD_LIGHT_A]),
        (50779, _SHORT, [_D65]),
    ]


def _raw_entries(
    shape: tuple[int, ...], metadata: DngMetadata, offsets: dict[str, int]
) -> list[Entry]:
    rows, cols = shape
    entries: list[Entry] = [
        (254, _LONG, [0]),
        (256, _LONG, [cols]),
        (257, _LONG, [rows]),
        (258, _SHORT, [16]),
        (259, _SHORT, [1]),
        (262, _SHORT, [32803]),
        (273, _LONG, [offsets["raw_pixels"]]),
        (277, _SHORT, [1]),
        (278, _LONG, [rows]),
        (279, _LONG, [2 * rows * cols]),
        (284, _SHORT, [1]),
        (33421, _SHORT, [2, 2]),
        (33422, _BYTE, bytes(_CHANNEL[letter] for letter in metadata.cfa)),
        (50710, _BYTE, bytes([0, 1, 2])),
        (50711, _SHORT, [1]),
        (50713, _SHORT, [2, 2]),
        (50714, _SHORT, [metadata.black_level] * 4),
        (50717, _LONG, [metadata.white_level]),
        (50718, _RATIONAL, [1.0, 1.0]),
        (50719, _LONG, [0, 0]),
        (50720, _LONG, [cols, rows]),
        (50829, _LONG, [0, 0, rows, cols]),
    ]
    if metadata.noise_profile is not None:
        entries.append((51041, _DOUBLE, list(metadata.noise_profile)))
    return entries


def _exif_entries(metadata: DngMetadata) -> list[Entry]:
    taken = metadata.taken_at.strftime("%Y:%m:%d %H:%M:%S")
    per_centimetre = 10.0 / metadata.pixel_pitch_mm
    lens = (metadata.focal_length_mm,) * 2 + (metadata.f_number,) * 2
    return [
        (33434, _RATIONAL, [metadata.exposure_time_s]),
        (33437, _RATIONAL, [metadata.f_number]),
        (34850, _SHORT, [1]),
        (34855, _SHORT, [metadata.iso]),
        (36864, _UNDEFINED, b"0230"),
        (36867, _ASCII, taken),
        (36868, _ASCII, taken),
        (37384, _SHORT, [4 if metadata.flash_fired else 0]),
        (37385, _SHORT, [_FLASH_FIRED if metadata.flash_fired else _NO_FLASH]),
        (37386, _RATIONAL, [metadata.focal_length_mm]),
        (41486, _RATIONAL, [per_centimetre]),
        (41487, _RATIONAL, [per_centimetre]),
        (41488, _SHORT, [_CENTIMETRE]),
        (41986, _SHORT, [1]),
        (41987, _SHORT, [1]),
        (41989, _SHORT, [metadata.focal_length_35mm]),
        (42033, _ASCII, metadata.serial_number),
        (42034, _RATIONAL, lens),
        (42036, _ASCII, metadata.lens_model),
    ]


def _directory(entries: list[Entry], start: int) -> bytes:
    """One image file directory that begins at ``start``, with the values it refers to."""
    ordered = sorted(entries)
    place = start + 2 + 12 * len(ordered) + 4
    fixed, outside = [struct.pack("<H", len(ordered))], b""
    for tag, kind, values in ordered:
        data, count = _encoded(kind, values)
        if len(data) <= 4:
            field = data.ljust(4, b"\0")
        else:
            field = struct.pack("<I", place + len(outside))
            outside += data + b"\0" * (len(data) % 2)
        fixed.append(struct.pack("<HHI", tag, kind, count) + field)
    fixed.append(struct.pack("<I", 0))
    return b"".join(fixed) + outside


def _encoded(kind: int, values: Values) -> tuple[bytes, int]:
    """A field's bytes and its count."""
    if isinstance(values, str):
        text = values.encode("ascii") + b"\0"
        return text, len(text)
    if isinstance(values, bytes):
        return values, len(values)
    if kind in (_RATIONAL, _SRATIONAL):
        letters = "<II" if kind == _RATIONAL else "<ii"
        pairs = [Fraction(float(value)).limit_denominator(1_000_000) for value in values]
        return b"".join(struct.pack(letters, p.numerator, p.denominator) for p in pairs), len(pairs)
    return struct.pack(f"<{len(values)}{_LETTER[kind]}", *values), len(values)
