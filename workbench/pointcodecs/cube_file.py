"""Files of point cubes: occupied cells in any codec, with colours and normals beside them."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.kernels.morton import morton_cells, morton_codes
from workbench.pointcodecs.attribute_bytes import (
    color_bytes,
    colors_of,
    normal_bytes,
    normals_of,
)
from workbench.pointcodecs.codecs import CodedCubes, codec_named
from workbench.pointcodecs.cube_layout import (
    COLORED,
    CUBE,
    NORMALS,
    CubeLayout,
    header_bytes,
    index_bytes,
    read_layout,
    refused,
)
from workbench.pointcodecs.point_cells import PointCells

SUFFIX = ".pcube"


def write_point_cubes(path: Path, cells: PointCells, codec: str) -> dict[str, float]:
    """Write occupied cells as one file; the same cells, in any order, give the same bytes.

    The grid is cut into cubes of 32³ cells for ``ci`` and ``eci``, of up to 256³ for
    ``context``. Each section holds the parts of all cubes that have points, one after another
    in the order of the cubes' Morton codes (x lowest). All numbers are little-endian. A reader
    asks for the header, then for the index, and knows from it which bytes of each section the
    cubes it wants have: sizes added up from the end of the header on, section after section.

    ========  =================================================================================
    header    80 bytes: ``WBPCUBES``; uint32 version, 1; uint8 codec (0 ci, 1 eci, 2 context),
              level (cells have coordinates below 2**level), cube level (cells along a side of
              a cube) and flags (1 colours, 2 normals); float64 corner of the grid, x, y, z, and
              side of a cell, in the unit of the points; uint64 points, cubes, offset of the
              index; CRC-32 of the index as it is stored, and of the header before it
    geometry  the cells of each cube as the codec writes them (`workbench.kernels.point_cubes`,
              `point_layers`, `cell_contexts`)
    colours   of each cube's points, where the file has them (`attribute_bytes.color_bytes`)
    normals   likewise (`attribute_bytes.normal_bytes`)
    index     the last bytes of the file, packed with zstd: 36 bytes per cube, first bytes of all
              cubes, then second ones, and so on
    ========  =================================================================================

    A cube's 36 bytes: uint64 Morton code less that of the cube before; uint32 points; bytes and
    CRC-32, uint32 each, of its part of the geometry, the colours and the normals; zeros for what
    the file has not. Colours and normals are in the order in which the codec gives the points.

    Parameters
    ----------
    path
        The file to write; its folder must exist.
    cells
        At least one, no two the same.
    codec
        ``ci``, ``eci`` or ``context``.

    Returns
    -------
    ``points``, ``cubes``; ``bytes`` of the file, ``geometry_bytes``, ``color_bytes``,
    ``normal_bytes``, ``index_bytes``; ``bits_per_point`` of the geometry.

    Raises
    ------
    InputError
        No cells, cells outside their grid, or the same cell twice.
    SettingsError
        No such codec.
    """
    coder = codec_named(codec)
    level = min(coder.cube_level, max(cells.frame.level, 5))
    codes, starts, order = _cubes_of(cells, level)
    coded = coder.encoded(cells.cells[order] & ((1 << level) - 1), starts, level)
    sorted_cells = cells.chosen(order[coded.order])
    records, parts = _records(sorted_cells, codes, starts, coded)
    flags = (COLORED if cells.color is not None else 0) | (
        NORMALS if cells.normals is not None else 0
    )
    layout = CubeLayout(cells.frame, coder, level, flags, records)
    index = index_bytes(records)
    header = header_bytes(layout, index)
    with replacing(path) as partial, open(partial, "wb") as file:
        for part in (header, coded.data.tobytes(), *parts, index):
            file.write(part)
    sizes = {f"{name}_bytes": int(records[f"{name}_bytes"].sum()) for name in _SECTION_NAMES}
    return {
        "points": len(cells),
        "cubes": len(records),
        "bytes": layout.index_offset + len(index),
        **sizes,
        "index_bytes": len(index),
        "bits_per_point": 8 * sizes["geometry_bytes"] / len(cells),
    }


_SECTION_NAMES = ("geometry", "color", "normal")


def _cubes_of(
    cells: PointCells, level: int
) -> tuple[NDArray[np.uint64], NDArray[np.int64], NDArray[np.int64]]:
    """Codes (c,) of the cubes that have cells, rows (c + 1,) where they begin, order (n,)."""
    grid = cells.cells
    if not len(grid) or grid.min() < 0 or grid.max() >= 1 << cells.frame.level:
        raise InputError(
            "There are no cells to write, or cells outside their grid.",
            expected=f"coordinates of 0 to {(1 << cells.frame.level) - 1}",
            found=f"{grid.min()} to {grid.max()}" if len(grid) else "no cells",
            fix="Make the cells of the points anew.",
        )
    codes = morton_codes(grid)
    order = np.argsort(codes, kind="stable")
    codes = codes[order]
    if (codes[1:] == codes[:-1]).any():
        raise InputError(
            "A cell is there twice.",
            found=f"{int((codes[1:] == codes[:-1]).sum())} repeated",
            fix="Merge the points of each cell first.",
        )
    cubes = codes >> np.uint64(3 * level)
    firsts = np.flatnonzero(np.concatenate([[True], cubes[1:] != cubes[:-1]]))
    return cubes[firsts], np.append(firsts, len(codes)), order


def _records(
    cells: PointCells,
    codes: NDArray[np.uint64],
    starts: NDArray[np.int64],
    coded: CodedCubes,
) -> tuple[NDArray[np.void], list[bytes]]:
    """The index, and the sections after the geometry."""
    records = np.zeros(len(codes), CUBE)
    records["code"], records["points"] = codes, np.diff(starts)
    geometry = _parts(coded.data.tobytes(), coded.bytes_at)
    _note(records, "geometry", geometry)
    sections = []
    packed: tuple[tuple[str, NDArray[Any] | None, Callable[[Any], bytes]], ...] = (
        ("color", cells.color, color_bytes),
        ("normal", cells.normals, normal_bytes),
    )
    for name, values, pack in packed:
        if values is not None:
            parts = [pack(values[begin:end]) for begin, end in pairwise(starts)]
            _note(records, name, parts)
            sections.append(b"".join(parts))
    return records, sections


def _note(records: NDArray[np.void], name: str, parts: list[bytes]) -> None:
    records[f"{name}_bytes"] = [len(part) for part in parts]
    records[f"{name}_crc"] = [zlib.crc32(part) for part in parts]


def _parts(data: bytes, bytes_at: NDArray[np.int64]) -> list[bytes]:
    return [data[a:b] for a, b in pairwise(bytes_at)]


class PointCubeFile:
    """A file of `write_point_cubes`, read cube by cube.

    Attributes
    ----------
    path : the file.
    layout : what its header and index say.

    Raises
    ------
    InputError
        Not such a file, or a damaged one; also from the methods, for the part they read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.layout = read_layout(self.path)

    def __len__(self) -> int:
        return len(self.layout.cubes)

    @property
    def places(self) -> NDArray[np.int32]:
        """(c, 3) lowest cell of each cube."""
        return morton_cells(self.layout.cubes["code"]) << self.layout.cube_level

    def cubes_in(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
        """Rows of the cubes that a box (3,), (3,) in the points' frame touches."""
        frame = self.layout.frame
        corner = frame.origin + self.places * frame.cell_size
        side = frame.cell_size * (1 << self.layout.cube_level)
        return np.flatnonzero(((corner <= high) & (corner + side >= low)).all(axis=1))

    def read(self, cubes: NDArray[np.int64] | NDArray[np.bool_] | None = None) -> PointCells:
        """The cells of some cubes, by their rows in the index or a mask of it, or of all.

        Cubes come in the order of the rows, the cells of each in that of the codec. The kernels
        let go of the interpreter: threads may read cubes of one file side by side.
        """
        flags = self.layout.flags
        rows = np.arange(len(self))
        if cubes is not None:
            rows = rows[cubes]
        try:
            with open(self.path, "rb") as file:
                geometry = self._section(file, "geometry", rows)
                color = self._section(file, "color", rows) if flags & COLORED else None
                normal = self._section(file, "normal", rows) if flags & NORMALS else None
        except OSError as error:
            raise refused(self.path, "The file cannot be read.", str(error)) from error
        try:
            return self._cells(rows, geometry, color, normal)
        except InputError as error:
            raise refused(self.path, error.message, error.found or "") from error
        except MemoryError as error:
            raise InputError(
                "The points of the file are more than the memory holds.",
                file=self.path,
                found=f"{self.layout.cubes['points'][rows].sum(dtype=np.int64)} points",
                fix="Read fewer cubes at a time.",
            ) from error

    def _cells(
        self,
        rows: NDArray[np.int64],
        geometry: list[bytes],
        color: list[bytes] | None,
        normal: list[bytes] | None,
    ) -> PointCells:
        """The cells of cubes from their bytes."""
        layout = self.layout
        counts = layout.cubes["points"][rows].astype(np.int64)
        local = layout.codec.decoded(
            b"".join(geometry),
            _running([len(part) for part in geometry]),
            _running(counts),
            layout.cube_level,
        )
        cells = local + np.repeat(self.places[rows], counts, axis=0)
        if len(cells) and cells.max() >= 1 << layout.frame.level:
            raise refused(self.path, "Cells lie outside the grid of the file.", f"{cells.max()}")
        return PointCells(
            layout.frame,
            cells,
            _unpacked(normal, counts, normals_of, np.float32),
            _unpacked(color, counts, colors_of, np.uint8),
        )

    def _section(self, file: BinaryIO, name: str, rows: NDArray[np.int64]) -> list[bytes]:
        """The checked bytes of a section of some cubes."""
        offsets, cubes = self.layout.offsets(name), self.layout.cubes
        parts = []
        for row in rows:
            # Cubes that follow one another are read from where the file is.
            if file.tell() != offsets[row]:
                file.seek(int(offsets[row]))
            data = file.read(int(cubes[f"{name}_bytes"][row]))
            if zlib.crc32(data) != int(cubes[f"{name}_crc"][row]):
                raise refused(self.path, "A cube of the file is damaged.", "a wrong checksum")
            parts.append(data)
        return parts


def _running(sizes: list[int] | NDArray[np.int64]) -> NDArray[np.int64]:
    """Where parts of some sizes begin, one after another, and where the last ends."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _unpacked(
    parts: list[bytes] | None,
    counts: NDArray[np.int64],
    unpack: Callable[[bytes, int], NDArray[Any]],
    kind: type[np.generic],
) -> NDArray[Any] | None:
    """Attributes (n, 3) of cubes, where a file has them."""
    if parts is None:
        return None
    values = [unpack(part, int(count)) for part, count in zip(parts, counts, strict=True)]
    return np.concatenate([np.zeros((0, 3), kind), *values])


def read_point_cubes(
    path: Path, cubes: NDArray[np.int64] | NDArray[np.bool_] | None = None
) -> PointCells:
    """The cells of a file, or of some of its cubes; `PointCells.point_set` makes them points.

    Raises
    ------
    InputError
        Not such a file, or a damaged one.
    """
    return PointCubeFile(path).read(cubes)
