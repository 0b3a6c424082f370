"""The header and the index of a file of point cubes; `cube_file` tells what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.formats.indexed_file import IndexedFormat
from workbench.kernels.morton import BITS_PER_AXIS
from workbench.pointcodecs.codecs import CODECS, PointCodec
from workbench.pointcodecs.point_cells import CellFrame

COLORED, NORMALS = 1, 2
_ZSTD_LEVEL = 9

HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u4"),
        ("codec", "u1"),
        ("level", "u1"),
        ("cube_level", "u1"),
        ("flags", "u1"),
        ("origin", "<f8", (3,)),
        ("cell_size", "<f8"),
        ("points", "<u8"),
        ("cubes", "<u8"),
        ("index_offset", "<u8"),
        ("index_crc", "<u4"),
        ("header_crc", "<u4"),
    ]
)
CUBE = np.dtype(
    [
        ("code", "<u8"),
        ("points", "<u4"),
        ("geometry_bytes", "<u4"),
        ("geometry_crc", "<u4"),
        ("color_bytes", "<u4"),
        ("color_crc", "<u4"),
        ("normal_bytes", "<u4"),
        ("normal_crc", "<u4"),
    ]
)
SECTIONS = ("geometry", "color", "normal")
FORMAT = IndexedFormat(
    HEADER,
    b"WBPCUBES",
    1,
    "a file of point cubes of the workbench",
    "The file holds no point cubes.",
    "The index of the file is damaged or cut short.",
)
refused = FORMAT.refused


@dataclass(frozen=True)
class CubeLayout:
    """What the header and the index of a file say.

    Attributes
    ----------
    frame : the grid of cells.
    codec : of the geometry.
    cube_level : cubes have 2**cube_level cells a side.
    flags : ``COLORED``, ``NORMALS``, added up.
    cubes : (c,) of dtype ``CUBE``, ``code`` ascending.
    """

    frame: CellFrame
    codec: PointCodec
    cube_level: int
    flags: int
    cubes: NDArray[np.void]

    def offsets(self, section: str) -> NDArray[np.int64]:
        """(c + 1,) byte of the file where each cube's part of a section begins, and its end."""
        at = HEADER.itemsize
        for name in SECTIONS:
            sizes = self.cubes[f"{name}_bytes"].astype(np.int64)
            if name == section:
                break
            at += int(sizes.sum())
        return np.asarray(at + np.concatenate([[0], np.cumsum(sizes)]), np.int64)

    @property
    def index_offset(self) -> int:
        """The byte where the index begins, behind the last section."""
        return int(self.offsets(SECTIONS[-1])[-1])


def index_bytes(cubes: NDArray[np.void]) -> bytes:
    """The index as it is stored."""
    columns = cubes.copy()
    columns["code"][1:] -= cubes["code"][:-1]
    planes = columns.view(np.uint8).reshape(len(cubes), CUBE.itemsize).T
    return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(planes.tobytes())


def header_bytes(layout: CubeLayout, index: bytes) -> bytes:
    """The header of a file with an index of `index_bytes`."""
    fields = {
        "codec": layout.codec.number,
        "level": layout.frame.level,
        "cube_level": layout.cube_level,
        "flags": layout.flags,
        "origin": layout.frame.origin,
        "cell_size": layout.frame.cell_size,
        "points": layout.cubes["points"].sum(dtype=np.uint64),
        "cubes": len(layout.cubes),
        "index_offset": layout.index_offset,
    }
    return FORMAT.sealed(fields, index)


def read_layout(path: Path) -> CubeLayout:
    """The checked header and index of a file.

    Raises
    ------
    InputError
        Not such a file, of another version, shorter than it says, or damaged.
    """
    path = Path(path)
    header, index = FORMAT.opened(path, _check_header, _check_end)
    cubes = _cubes_of(path, index, int(header["cubes"]))
    codec = next(c for c in CODECS.values() if c.number == int(header["codec"]))
    frame = CellFrame(
        header["origin"].astype(np.float64), float(header["cell_size"]), int(header["level"])
    )
    layout = CubeLayout(frame, codec, int(header["cube_level"]), int(header["flags"]), cubes)
    _check_cubes(path, layout, header)
    return layout


def _check_header(path: Path, header: Any) -> None:
    levels = {codec.number: codec.cube_level for codec in CODECS.values()}
    level, cube_level = int(header["level"]), int(header["cube_level"])
    sound = 1 <= cube_level <= levels.get(int(header["codec"]), 0) and header["cubes"] > 0
    sound = sound and 1 <= level <= BITS_PER_AXIS and int(header["flags"]) < 4
    sound = sound and bool(np.isfinite(header["origin"]).all())
    if not sound or not 0 < float(header["cell_size"]) < np.inf:
        raise refused(path, "The header of the file makes no sense.", f"levels {level, cube_level}")


def _check_end(path: Path, header: Any, end: int) -> None:
    # A cube takes a byte at least: nothing larger than the file is ever made room for.
    if not HEADER.itemsize + int(header["cubes"]) <= int(header["index_offset"]) < end:
        raise refused(path, "The file is cut short.", f"{end} bytes")


def _cubes_of(path: Path, index: bytes, count: int) -> NDArray[np.void]:
    """The index unpacked; a packed size that differs is not even tried."""
    size = count * CUBE.itemsize
    try:
        if zstandard.frame_content_size(index) != size:
            raise refused(path, "The index of the file is damaged.", "another size")
        planes = zstandard.ZstdDecompressor().decompress(index)
    except zstandard.ZstdError as error:
        raise refused(path, "The index of the file is damaged.", str(error)) from error
    rows = np.frombuffer(planes, np.uint8).reshape(CUBE.itemsize, count).T
    cubes = rows.copy().view(CUBE)[:, 0]
    cubes["code"] = np.cumsum(cubes["code"], dtype=np.uint64)
    return cubes


def _check_cubes(path: Path, layout: CubeLayout, header: Any) -> None:
    """Cubes ascend inside the grid, and their sections fill the file up to the index."""
    cubes, codec = layout.cubes, layout.codec
    codes = cubes["code"]
    across = max(layout.frame.level - layout.cube_level, 0)
    if (codes[1:] <= codes[:-1]).any() or int(codes[-1]) >> 3 * across:
        raise refused(path, "The index names cubes out of order or outside the grid.", "a code")
    counts = cubes["points"].astype(np.int64)
    possible = codec.most_points(cubes["geometry_bytes"].astype(np.int64))
    if (counts < 1).any() or (counts > np.minimum(possible, 1 << 3 * layout.cube_level)).any():
        raise refused(path, "The index names more points than there are.", f"{counts.max()}")
    if layout.index_offset != int(header["index_offset"]):
        raise refused(path, "The sections of the file do not fit its index.", "other sizes")
    if int(counts.sum()) != int(header["points"]):
        raise refused(path, "The index does not fit the header.", f"{counts.sum()} points")
