"""Bits of a point against the time to read it, for our codecs of point cubes and for others.

python -m tests.benchmarks.bench_pointcodecs MESH|CLOUD… OUT

A mesh becomes voxels at 256³, 512³ and 1024³: *touched*, all that its surface touches, and
*thin*, the 6-separating subset; and *sampled*, the cells of points spread densely over it. A
cloud gives the cells of its points. All programs code the same cells without loss, on one
core; seconds are of processor time, the least of three. Draco (``pip install DracoPy``) and
LAZ (``pip install laspy[lazrs]``) are left out where they are not installed. The G-PCC
reference coder has no package: its published figures for an octree, at its best settings for
one core, are printed for comparison (closed scans: 0.95, 0.72 and 0.60 bits at these
resolutions, 1.7 million points read a second).

The second table tells how far points lie from the middles of their cells.
"""

from __future__ import annotations

import io
import lzma
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.formats.point_files import read_points
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.point_set import PointSet
from workbench.geometry.surface_sampling import sample_surface
from workbench.kernels.morton import morton_cells, morton_codes
from workbench.pointcodecs.codecs import CODECS, PointCodec
from workbench.pointcodecs.cube_file import read_point_cubes, write_point_cubes
from workbench.pointcodecs.point_cells import (
    CellFrame,
    PointCells,
    cells_of_points,
    frame_of_resolution,
)
from workbench.verification.figures import TradeoffPoint, tradeoff_figure
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import voxelise

_LEVELS = (8, 9, 10)
_SAMPLES_PER_CELL, _MOST_SAMPLES = 12, 24_000_000
_G_PCC = {8: 0.95, 9: 0.72, 10: 0.60}

Packed = tuple[int, Callable[[], NDArray[np.integer]]]


def by_codec(codec: PointCodec) -> Callable[[NDArray[np.int32], int], Packed]:
    """Geometry alone, in cubes as files have them."""

    def pack(cells: NDArray[np.int32], level: int) -> Packed:
        size = min(codec.cube_level, level)
        cubes = morton_codes(cells >> size)
        firsts = np.flatnonzero(np.concatenate([[True], cubes[1:] != cubes[:-1]]))
        starts = np.append(firsts, len(cells))
        coded = codec.encoded(cells & ((1 << size) - 1), starts, size)
        corner = np.repeat(cells[firsts] >> size << size, np.diff(starts), axis=0)

        def read() -> NDArray[np.integer]:
            return codec.decoded(coded.data, coded.bytes_at, starts, size) + corner

        return len(coded.data), read

    return pack


def by_file(codec: str) -> Callable[[NDArray[np.int32], int], Packed]:
    """A whole file, with its index."""

    def pack(cells: NDArray[np.int32], level: int) -> Packed:
        with TemporaryDirectory() as folder:
            made = Path(folder) / "a.pcube"
            write_point_cubes(made, PointCells(CellFrame(np.zeros(3), 1.0, level), cells), codec)
            data = made.read_bytes()

        def read() -> NDArray[np.integer]:
            with TemporaryDirectory() as folder:
                made = Path(folder) / "a.pcube"
                made.write_bytes(data)
                return read_point_cubes(made).cells

        return len(data), read

    return pack


def by_steps(
    compress: Callable[[bytes], bytes], decompress: Callable[[bytes], bytes]
) -> Callable[[NDArray[np.int32], int], Packed]:
    """Differences of Morton codes, byte plane by byte plane, in a general packer."""

    def pack(cells: NDArray[np.int32], level: int) -> Packed:
        del level
        steps = np.diff(morton_codes(cells), prepend=np.uint64(0)).astype("<u4")
        packed = compress(steps.view(np.uint8).reshape(-1, 4).T.tobytes())

        def read() -> NDArray[np.integer]:
            planes = np.frombuffer(decompress(packed), np.uint8).reshape(4, -1)
            steps = np.ascontiguousarray(planes.T).view("<u4")[:, 0]
            return morton_cells(np.cumsum(steps, dtype=np.uint64))

        return len(packed), read

    return pack


def by_draco(speed: int) -> Callable[[NDArray[np.int32], int], Packed]:
    """Draco's kd-tree, with as many bits as the grid has, so that nothing is lost."""
    import DracoPy

    def pack(cells: NDArray[np.int32], level: int) -> Packed:
        packed = DracoPy.encode(
            cells.astype(np.float32),
            quantization_bits=level,
            quantization_range=float((1 << level) - 1),
            quantization_origin=np.zeros(3),
            compression_level=10 - speed,
        )

        def read() -> NDArray[np.integer]:
            return np.rint(DracoPy.decode(packed).points).astype(np.int32)

        return len(packed), read

    return pack


def by_laz() -> Callable[[NDArray[np.int32], int], Packed]:
    """LAZ in Morton order, all other fields zero."""
    import laspy

    def pack(cells: NDArray[np.int32], level: int) -> Packed:
        del level
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.scales = np.ones(3)
        las = laspy.LasData(header)
        las.X, las.Y, las.Z = cells.T
        stream = io.BytesIO()
        las.write(stream, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
        packed = stream.getvalue()

        def read() -> NDArray[np.integer]:
            back = laspy.read(io.BytesIO(packed), laz_backend=laspy.LazBackend.Lazrs)
            return np.stack([back.X, back.Y, back.Z], axis=1)

        return len(packed), read

    return pack


def programs() -> dict[str, Callable[[NDArray[np.int32], int], Packed]]:
    """Those that are installed."""
    packer, unpacker = zstandard.ZstdCompressor(level=19), zstandard.ZstdDecompressor()
    found = {name: by_codec(codec) for name, codec in CODECS.items()}
    found |= {f"{name}, file": by_file(name) for name in CODECS}
    found |= {
        "code steps, zstd": by_steps(packer.compress, unpacker.decompress),
        "code steps, lzma": by_steps(lzma.compress, lzma.decompress),
    }
    for name, make in (("Draco", lambda: by_draco(0)), ("LAZ", by_laz)):
        try:
            found[name] = make()
        except ImportError:
            print(f"{name} is not installed")
    return found


def least(run: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of processor time, the least of three, and what came out."""
    seconds = []
    for _ in range(3):
        begin = process_time()
        result = run()
        seconds.append(process_time() - begin)
    return min(seconds), result


def sets_of(mesh: TriangleMesh) -> Iterator[tuple[str, int, NDArray[np.int32]]]:
    """Name, level and cells in Morton order."""
    for level in _LEVELS:
        grid = grid_of_mesh(mesh.vertices, level)
        voxels = voxelise(mesh, grid)
        yield "touched", level, voxels.cells
        yield "thin", level, voxels.cells[voxels.separating]
        samples = sample_surface(mesh, min(_SAMPLES_PER_CELL * len(voxels), _MOST_SAMPLES), 1)[0]
        frame = CellFrame(grid.origin, grid.voxel_size, level)
        yield "sampled", level, cells_of_points(PointSet(samples), frame).cells


def sets_of_cloud(points: NDArray[np.float64]) -> Iterator[tuple[str, int, NDArray[np.int32]]]:
    """Likewise."""
    for level in _LEVELS:
        frame = frame_of_resolution(points, 1 << level)
        yield "cloud", level, cells_of_points(PointSet(points), frame).cells


def compare(path: Path, out: Path) -> NDArray[np.float64]:
    """Print the first table, draw it, and give points of the input for the second one."""
    mesh = read_surface(path) if path.suffix in {".ply", ".obj", ".glb"} else None
    if mesh is not None and len(mesh.triangles):
        sets, points = sets_of(mesh), sample_surface(mesh, 200_000, 2)[0]
    else:
        points = read_points(path).points
        sets = sets_of_cloud(points)
    for kind, level, cells in sets:
        print(f"\n{path.name}, {kind}, {1 << level}³: {len(cells):,} points")
        print(f"{'':22s}bits/point  M points/s read   written")
        drawn = []
        for name, pack in programs().items():
            pack(cells[:1000], level)[1]()
            written, (size, read) = least(partial(pack, cells, level))
            seconds, back = least(read)
            if not np.array_equal(np.sort(morton_codes(back)), morton_codes(cells)):
                raise AssertionError(f"{name} gave back other cells")
            bits, million = 8 * size / len(cells), len(cells) / 1e6
            print(f"{name:22s}{bits:10.3f}{million / seconds:12.2f}{million / written:14.2f}")
            drawn.append(TradeoffPoint(name, 1000 * seconds / million, bits))
        # Of closed scans; it says nothing of an open and sparse cloud.
        if kind != "cloud":
            print(f"{'G-PCC, published':22s}{_G_PCC[level]:10.3f}{1.7:12.2f}")
            drawn.append(TradeoffPoint("G-PCC, published", 1000 / 1.7, _G_PCC[level]))
        svg = tradeoff_figure(drawn, "read (ns per point)", "bits per point", "context")
        (out / f"{path.stem}-{kind}-{1 << level}.svg").write_text(svg, encoding="utf-8")
    return points


def errors(name: str, points: NDArray[np.float64]) -> None:
    """Print the second table: distance of points from the middles of their cells."""
    print(f"\n{name}: {'resolution':>12s}   cell      RMS       largest   bits/point (context)")
    for level in range(5, 13):
        frame = frame_of_resolution(points, 1 << level)
        cells = np.floor((points - frame.origin) / frame.cell_size).astype(np.int32)
        moved = np.linalg.norm(frame.centers(cells) - points, axis=1)
        kept = cells_of_points(PointSet(points), frame).cells
        bits = 8 * by_codec(CODECS["context"])(kept, level)[0] / len(kept)
        place, mean = f"{1 << level:>{len(name) + 14}d}", np.sqrt((moved**2).mean())
        numbers = f"{frame.cell_size:11.3g}{mean:10.3g}{moved.max():10.3g}{bits:12.3f}"
        print(place + numbers, flush=True)


def main() -> None:
    """See the module."""
    *inputs, out = (Path(given) for given in sys.argv[1:])
    out.mkdir(parents=True, exist_ok=True)
    for path in inputs:
        errors(path.name, compare(path, out))


if __name__ == "__main__":
    main()
