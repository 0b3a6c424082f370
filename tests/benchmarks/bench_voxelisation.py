"""Surface voxels against other programs, and the error of their levels against time and bytes.

python -m tests.benchmarks.bench_voxelisation MESH 2048           # time and memory, each program
python -m tests.benchmarks.bench_voxelisation MESH levels OUT     # pictures of each resolution
"""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import open3d as o3d
import trimesh

from tests.benchmarks.drawing import draw_tradeoff
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.verification.figures import TradeoffPoint, tradeoff_figure
from workbench.verification.voxel_errors import MeshViews
from workbench.voxels.lod_export import LodOptions, write_voxel_lod
from workbench.voxels.lod_file import LodFile
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh
from workbench.voxels.voxelisation import VoxelisationOptions, voxel_parts

_RAYS = 2048
_LEVELS = (6, 7, 8, 9, 10, 11)
_MEMORY_LIMIT = 12 << 30


def by_workbench(mesh: TriangleMesh, grid: VoxelGrid, workers: int) -> int:
    """Voxels, part by part as a writer takes them; nothing is kept."""
    parts = voxel_parts(mesh, grid, VoxelisationOptions(workers=workers))
    return sum(len(part) for part in parts)


def by_writing(mesh: TriangleMesh, grid: VoxelGrid, workers: int) -> int:
    """Voxels of a whole level-of-detail file with geometry."""
    with TemporaryDirectory() as folder:
        options = LodOptions(resolution=grid.resolution, workers=workers)
        return int(write_voxel_lod(mesh, Path(folder) / "a.vlod", options)["voxels"])


def by_open3d(mesh: TriangleMesh, grid: VoxelGrid, workers: int) -> int:
    """Voxels without attributes."""
    del workers
    given = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles)
    )
    found = o3d.geometry.VoxelGrid.create_from_triangle_mesh_within_bounds(
        given, grid.voxel_size, grid.origin, grid.origin + grid.size
    )
    # Its list of voxels in Python would cost more than making them; its name tells how many.
    return int(str(found).split()[2])


def by_trimesh(mesh: TriangleMesh, grid: VoxelGrid, workers: int) -> int:
    """Voxels of points closer than a voxel, without attributes."""
    del workers
    given = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    return int(given.voxelized(grid.voxel_size, method="subdivide").filled_count)


PROGRAMS: dict[str, tuple[Callable[[TriangleMesh, VoxelGrid, int], int], int]] = {
    "workbench, 1 thread": (by_workbench, 1),
    "workbench, 2 threads": (by_workbench, 2),
    "workbench, file with levels": (by_writing, 1),
    "Open3D": (by_open3d, 1),
    "trimesh": (by_trimesh, 1),
}


def measure(path: Path, resolution: int, program: str) -> None:
    """Print what one program takes; run in a process of its own for its memory."""
    mesh = read_surface(path)
    make, workers = PROGRAMS[program]
    grid = grid_of_mesh(mesh.vertices, resolution.bit_length() - 1)
    small = TriangleMesh(mesh.vertices, mesh.triangles[:1000])
    make(small, grid.at_level(7), workers)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_LIMIT, _MEMORY_LIMIT))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    wall, cpu = perf_counter(), process_time()
    try:
        count = f"{make(mesh, grid, workers):,}"
    except MemoryError:
        count = f"more than {_MEMORY_LIMIT >> 30} GiB"
    wall, cpu = perf_counter() - wall, process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{program:30s}{wall:9.1f}{cpu:9.1f}{before:9.2f}{peak:9.2f}  {count}", flush=True)


def compare(path: Path, resolution: int) -> None:
    """A table of all programs, one process each."""
    print(f"{path} at {resolution}\n{'':30s}   wall s    CPU s  GiB before  peak  voxels")
    for program in PROGRAMS:
        command = [sys.executable, "-m", __spec__.name, str(path), str(resolution), program]
        if subprocess.run(command, check=False).returncode:
            print(f"{program:30s} failed")


def levels(path: Path, out: Path) -> None:
    """Difference of pictures by resolution, against the time to make it and its bytes."""
    mesh = read_surface(path)
    points, sizes = [], []
    finest = grid_of_mesh(mesh.vertices, _LEVELS[-1])
    truth = MeshViews.of(mesh, finest, _RAYS)
    print(f"{'':12s}seconds      MB   bytes/voxel   error of 255 (of levels from the finest)")
    with TemporaryDirectory() as folder:
        # Compiled before the clock starts.
        write_voxel_lod(mesh, Path(folder) / "first.vlod", LodOptions(resolution=64))
        for level in reversed(_LEVELS):
            made = Path(folder) / f"{level}.vlod"
            start = perf_counter()
            options = LodOptions(resolution=1 << level, geometry=False, chunk_level=6)
            figures = write_voxel_lod(mesh, made, options)
            seconds = perf_counter() - start
            error = truth.error_of(LodFile(made), level)
            all_of_one = LodFile(Path(folder) / f"{_LEVELS[-1]}.vlod")
            derived = truth.error_of(all_of_one, level)
            label, megabytes = f"{1 << level}", figures["bytes"] / 1e6
            print(
                f"{label:8s}{seconds:11.2f}{megabytes:8.2f}{figures['bytes_per_voxel']:14.2f}"
                f"{error:11.3f}{derived:8.3f}",
                flush=True,
            )
            points.append(TradeoffPoint(label, seconds, error))
            sizes.append(TradeoffPoint(label, megabytes, error))
    draw_tradeoff(out, "voxels-error-time", points, "mean picture difference (of 255)", "2048")
    by_size = tradeoff_figure(sizes, "file (MB)", "mean picture difference (of 255)", "2048")
    (out / "voxels-error-bytes.svg").write_text(by_size, encoding="utf-8")


def main() -> None:
    """See the module."""
    path, what, *rest = sys.argv[1:]
    if what == "levels":
        levels(Path(path), Path(rest[0]))
    elif rest:
        measure(Path(path), int(what), rest[0])
    else:
        compare(Path(path), int(what))


if __name__ == "__main__":
    main()
