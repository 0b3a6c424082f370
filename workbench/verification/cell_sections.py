"""What a report says of a surface coded as points: bits and reading time of every codec."""

from __future__ import annotations

import lzma
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.kernels.morton import morton_codes
from workbench.metrics import Metric
from workbench.pointcodecs.codecs import CODECS
from workbench.pointcodecs.cube_file import SUFFIX, read_point_cubes, write_point_cubes
from workbench.pointcodecs.point_cells import PointCells
from workbench.verification.figures import TradeoffPoint, tradeoff_figure
from workbench.verification.quantities import shown_length, shown_number
from workbench.verification.report_content import Column, Paragraph, Plot, Section, Table

_LABELS = {
    "ci": "CI, cell identification",
    "eci": "ECI, layers and seeds",
    "context": "octree by contexts",
}


@dataclass(frozen=True)
class CodecFigures:
    """One way to code the places of cells.

    Attributes
    ----------
    name : of a codec or a packer.
    label : in words.
    bits : for each cell.
    written_s, read_s : processor time to a file and back.
    """

    name: str
    label: str
    bits: float
    written_s: float
    read_s: float


@dataclass(frozen=True)
class ExportedCells:
    """What there is to say of coded cells.

    Attributes
    ----------
    codec : that of the file.
    file_bytes : of the file, colours and normals among them.
    cells : how many.
    resolution : of the grid, cells a side.
    cell_size_m : side of a cell.
    codecs : ways to code the same cells.
    """

    codec: str
    file_bytes: int
    cells: int
    resolution: int
    cell_size_m: float
    codecs: Sequence[CodecFigures]


def codec_figures(cells: PointCells) -> list[CodecFigures]:
    """All codecs and two general packers on the same cells, without colours."""
    bare = PointCells(cells.frame, cells.cells, None, None, 0)
    few = bare.chosen(np.arange(min(len(bare), 1000)))
    figures = []
    with TemporaryDirectory() as folder:
        for name in CODECS:
            path = Path(folder) / f"{name}{SUFFIX}"
            # Compiled before the clock counts.
            write_point_cubes(path, few, name)
            read_point_cubes(path)
            start = process_time()
            told = write_point_cubes(path, bare, name)
            halfway = process_time()
            read_point_cubes(path)
            read_s = process_time() - halfway
            figures.append(
                CodecFigures(
                    name, _LABELS[name], told["bits_per_point"], halfway - start, read_s
                )
            )  # fmt: skip
    codes = np.sort(morton_codes(bare.cells))
    steps = codes.copy()
    steps[1:] -= codes[:-1]
    zstd, unzstd = zstandard.ZstdCompressor(level=9), zstandard.ZstdDecompressor()
    figures.append(
        _packed("zstd", "steps in Morton order, zstd", steps, zstd.compress, unzstd.decompress)
    )
    figures.append(
        _packed("lzma", "steps in Morton order, lzma", steps, lzma.compress, lzma.decompress)
    )
    return figures


def _packed(
    name: str,
    label: str,
    steps: NDArray[np.uint64],
    pack: Callable[[bytes], bytes],
    unpack: Callable[[bytes], bytes],
) -> CodecFigures:
    """Steps of seven bits a byte, most of which are one byte, packed."""
    start = process_time()
    packed = pack(_bytes_of_steps(steps))
    halfway = process_time()
    unpack(packed)
    read_s = process_time() - halfway
    return CodecFigures(name, label, 8.0 * len(packed) / len(steps), halfway - start, read_s)


def _bytes_of_steps(steps: NDArray[np.uint64]) -> bytes:
    """Unsigned LEB128."""
    sevens = np.array([7 * k for k in range(10)], np.uint64)
    parts = (steps[:, None] >> sevens[:9]) & np.uint64(127)
    count = np.ones(len(steps), np.int64)
    for k in range(1, 9):
        count[(steps >> sevens[k]) > 0] = k + 1
    place = np.arange(9)
    more = place < count[:, None] - 1
    return bytes(
        (parts | (more.astype(np.uint64) << np.uint64(7)))[place < count[:, None]].astype(np.uint8)
    )


def cell_section(told: ExportedCells) -> Section:
    """The chapter on coded cells."""
    text = (
        f"The surface fills {shown_number(told.cells)} of {told.resolution}³ cells of "
        f"{shown_length(told.cell_size_m)}; their middles are at most "
        f"{shown_length(told.cell_size_m * 0.5 * np.sqrt(3.0))} from it. Coded by "
        f"{_LABELS[told.codec]} they take {shown_number(told.file_bytes / 1e6)} MB in the file, "
        "colours and normals among them."
    )
    columns = (
        Column("Codec", style="wide"),
        Column("For each cell", "bits", 3),
        Column("Written", "M cells/s", 2),
        Column("Read", "M cells/s", 2),
    )
    rows = tuple(
        (
            f"{row.label} (in the file)" if row.name == told.codec else row.label,
            row.bits,
            1e-6 * told.cells / row.written_s,
            1e-6 * told.cells / row.read_s,
        )
        for row in told.codecs
    )
    caption = (
        "The places alone, by processor time, file to cells (Mallón et al. 2003, and general "
        "packers). Packers' reading leaves out making cells of their steps."
    )
    points = [
        TradeoffPoint(row.name, 1e9 * row.read_s / told.cells, row.bits) for row in told.codecs
    ]
    svg = tradeoff_figure(
        points, "read in (ns for each cell)", "bits for each cell", told.codec,
        name="cell-codecs", alt="Size against reading time of every codec",
    )  # fmt: skip
    data = {row.name: {"nanoseconds": row.x, "bits": row.y} for row in points}
    plot = Plot(svg, "Size against reading time; that of the file is ringed.", data)
    intro = "The surface as the cells it fills, for sending and keeping."
    return Section("Coded points", intro, (Paragraph(text), Table(columns, rows, caption), plot))


def cell_metrics(told: ExportedCells) -> list[Metric]:
    """Bits of every codec."""
    return [
        Metric(f"cell_bits_{row.name}", row.bits, "bits", f"Size of a cell by {row.label}.")
        for row in told.codecs
    ]
