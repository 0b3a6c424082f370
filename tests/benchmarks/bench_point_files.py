"""Seconds, bytes and memory of point exports, beside laspy's plain writing.

python -m tests.benchmarks.bench_point_files [CLOUD]

Without a cloud, five million points with colours and normals on a wavy sheet of four metres
are written as PLY and exported from there, each format in a process of its own. Memory is the
most that the process had beyond what it has after its imports; octrees and layered clouds are
told to use 256 MiB. laspy gets all points in memory and writes LAZ by the same compressor, and
is left out where it is not installed.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from workbench.cloud.point_export import POINT_FORMATS, export_points
from workbench.formats.ply_points import write_ply_points
from workbench.formats.point_files import read_points
from workbench.formats.point_rounding import rounding_of
from workbench.formats.point_stream import BATCH_POINTS, PointStream
from workbench.geometry.point_set import PointSet

POINTS = 5_000_000
MEMORY_BYTES = 256 << 20
_BY_LASPY = "laspy"


def sheet(points: int) -> PointStream:
    """A wavy sheet in scan lines, made as it is read."""

    def batches() -> Iterator[PointSet]:
        for number, start in enumerate(range(0, points, BATCH_POINTS)):
            n = min(BATCH_POINTS, points - start)
            random = np.random.default_rng(number)
            x = np.sort(random.uniform(-2, 2, n))
            y = -2 + 4 * (start + np.arange(n)) / points
            z = 0.2 * np.sin(3 * x) * np.cos(2 * y) + random.normal(0, 2e-4, n)
            slope_x = 0.6 * np.cos(3 * x) * np.cos(2 * y)
            slope_y = -0.4 * np.sin(3 * x) * np.sin(2 * y)
            normals = np.stack([-slope_x, -slope_y, np.ones(n)], axis=1)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            grey = (128 + 100 * np.sin(9 * x) * np.sin(7 * y)).astype(np.uint8)
            color = np.stack([grey, grey // 2, 255 - grey], axis=1)
            yield PointSet(np.stack([x, y, z], axis=1), normals.astype(np.float32), color)

    corner = np.array([2.0, 2.0, 0.25])
    return PointStream(batches, points, -corner, corner, frozenset({"normals", "color"}))


def by_laspy(source: Path, out: Path) -> dict[str, Any]:
    """What laspy makes of all points at once."""
    import laspy

    points = read_points(source)
    start = perf_counter()
    header = laspy.LasHeader(point_format=7, version="1.4")
    rounding = rounding_of(*points.bounds)
    header.scales, header.offsets = np.full(3, rounding.step), rounding.origin
    header.add_extra_dims([laspy.ExtraBytesParams(f"Normal{axis}", "f4") for axis in "XYZ"])
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.points.T
    if points.color is not None:
        las.red, las.green, las.blue = points.color.T.astype(np.uint16) * 257
    if points.normals is not None:
        las.NormalX, las.NormalY, las.NormalZ = points.normals.T
    las.write(out)
    return {"seconds": perf_counter() - start, "bytes": out.stat().st_size, "items": len(points)}


def one(source: Path, out: Path, file_format: str) -> dict[str, Any]:
    """Export once; figures of this process."""
    before = getrusage(RUSAGE_SELF).ru_maxrss
    start = perf_counter()
    if file_format == _BY_LASPY:
        told = by_laspy(source, out)
    else:
        told = export_points(source, out, file_format, memory_bytes=MEMORY_BYTES)
        told["seconds"] = perf_counter() - start
    told["memory"] = (getrusage(RUSAGE_SELF).ru_maxrss - before) * 1024
    return told


def main() -> None:
    """Print one line per format."""
    with TemporaryDirectory() as folder:
        source = Path(folder) / "sheet.ply"
        if len(sys.argv) > 1:
            source = Path(sys.argv[1])
        else:
            write_ply_points(source, sheet(POINTS))
        print(f"{'format':9}{'seconds':>9}{'M points/s':>12}{'bytes/point':>13}{'MiB more':>10}")
        for file_format in (_BY_LASPY, *POINT_FORMATS):
            out = Path(folder) / f"out-{file_format}{'.laz' if file_format == _BY_LASPY else ''}"
            code = (
                "import json, sys; from pathlib import Path; "
                "from tests.benchmarks.bench_point_files import one; "
                "print(json.dumps(one(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])))"
            )
            command = [sys.executable, "-c", code, str(source), str(out), file_format]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                print(f"{file_format:9}", (done.stderr.splitlines() or ["failed"])[-1])
                continue
            told = json.loads(done.stdout.splitlines()[-1])
            print(
                f"{file_format:9}{told['seconds']:9.1f}"
                f"{told['items'] / told['seconds'] / 1e6:12.2f}"
                f"{told['bytes'] / told['items']:13.2f}{told['memory'] / 2**20:10.0f}"
                + (f"   {told['levels']} levels, {told['nodes']} nodes" if "levels" in told else "")
            )
            shutil.rmtree(out, ignore_errors=True)
            out.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
