"""Sparse voxel graphs of a mesh: bytes beside the paper's, build time, rays, error for time.

    python -m tests.benchmarks.bench_dag MESH OUT [LEVEL ...]

cuts MESH into 2^LEVEL voxels a side for each LEVEL (9 and 11 where none is named) and prints
for each the tables 5.1 to 5.4 of Jaspe 2018 and the million rays a second of each encoding, in
seconds of this thread so that others on the machine do not count. Of the last LEVEL it draws the
error of traced depths against the mesh for the time of a picture, by detail and with or without
common starts of blocks, and writes ``dag_tradeoff.svg``, ``dag.voxgraph`` and ``dag.png`` to OUT.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from time import perf_counter, thread_time

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.cube_turns import MIRRORS, TURNS
from workbench.verification.figures import TradeoffPoint
from workbench.voxels.dag_encoding import ENCODINGS, encoded
from workbench.voxels.dag_file import VoxelGraph, write_voxel_graph
from workbench.voxels.dag_reduction import reduced_parts
from workbench.voxels.graph_export import encoding_figures, reduced_for
from workbench.voxels.graph_pictures import (
    PictureOptions,
    camera_around,
    traced_view,
    write_graph_picture,
)
from workbench.voxels.symmetric_dag import symmetric_dag
from workbench.voxels.tracing import VoxelTracer
from workbench.voxels.voxel_dag import VoxelDag
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh
from workbench.voxels.voxelisation import voxel_parts

ROUNDS = 5
PART_LEVEL = 8


def built(mesh: TriangleMesh, grid: VoxelGrid) -> VoxelDag:
    """The graph of equal subtrees; prints what it and those of images took."""
    start = perf_counter()
    codes = [part.codes for part in voxel_parts(mesh, grid, part_level=PART_LEVEL)]
    times = [perf_counter()]
    dag = reduced_parts(codes, grid.level, max(0, grid.level - PART_LEVEL))
    times.append(perf_counter())
    for order in (MIRRORS, TURNS):
        symmetric_dag(dag, order)
        times.append(perf_counter())
    cut, equal, mirrors, turns = np.diff([start, *times])
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"\n{grid.resolution}³: {sum(map(len, codes)):,} voxels in {cut:.1f} s; "
        f"equal subtrees {equal:.2f} s, mirrored {mirrors:.2f} s or turned {turns:.2f} s more; "
        f"peak {peak_gib:.2f} GiB"
    )
    return dag


def print_table(dag: VoxelDag, rays: dict[str, float]) -> None:
    """Nodes, bytes and rays of all encodings."""
    print("encoding       nodes        MiB  bits/voxel  of svdag  Mrays/s   published bits/voxel")
    for row in encoding_figures(dag):
        told = ", ".join(f"{k} {v:.3f}" for k, v in row.published_bits_per_voxel.items())
        print(
            f"{row.encoding:8s}{row.nodes:12,d}{row.bytes / 2**20:11.3f}{row.bits_per_voxel:12.3f}"
            f"{row.share_of_svdag:10.3f}{rays[row.encoding]:9.2f}   {told}"
        )


def million_rays(
    tracers: dict[str, VoxelTracer], camera: PhotoCamera, rays: NDArray[np.float64]
) -> dict[str, float]:
    """Million rays a second down to the voxels; the best of rounds that take turns."""
    best = dict.fromkeys(tracers, np.inf)
    for _ in range(ROUNDS):
        for name, tracer in tracers.items():
            start = thread_time()
            tracer.first_met(camera.center, rays)
            best[name] = min(best[name], thread_time() - start)
    return {name: 1e-6 * len(rays) / seconds for name, seconds in best.items()}


def error_for_time(
    tracer: VoxelTracer, mesh: TriangleMesh, camera: PhotoCamera
) -> list[TradeoffPoint]:
    """Median error of depth, in voxels, for the seconds of a picture."""
    surface, points = SurfaceRays(mesh), []
    for detail in (0.0, 1.0, 2.0, 4.0, 8.0):
        for block in (0, 8):
            options = PictureOptions(detail_px=detail, block_px=block)
            seconds = np.inf
            for _ in range(3):
                start = thread_time()
                view = traced_view(tracer, camera, options)
                seconds = min(seconds, thread_time() - start)
            met = surface.first_met(camera.center, view.directions)
            depth = np.linalg.norm(met.points - camera.center, axis=1)
            off = np.abs(view.hits.distance - depth)[met.found & view.hits.found]
            error = float(np.median(off)) / tracer.grid.voxel_size
            name = f"{detail:g} px, {'blocks' if block else 'single rays'}"
            print(f"{name:20s} {seconds:7.3f} s  {error:7.3f} voxels")
            points.append(TradeoffPoint(name, float(seconds), error))
    return points


def main(mesh_path: Path, out: Path, levels: list[int]) -> None:
    mesh = read_surface(mesh_path)
    out.mkdir(parents=True, exist_ok=True)
    for level in levels:
        grid = grid_of_mesh(mesh.vertices, level)
        dag = built(mesh, grid)
        graphs = {name: encoded(reduced_for(dag, name), name) for name in ENCODINGS}
        tracers = {name: VoxelTracer(graph, grid) for name, graph in graphs.items()}
        camera = camera_around(grid)
        columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
        rays = camera.directions(np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2))
        print_table(dag, million_rays(tracers, camera, rays))
    points = error_for_time(tracers["ssvdag"], mesh, camera)
    draw_tradeoff(out, "dag_tradeoff", points, "median depth error (voxels)", "1 px, blocks")
    write_voxel_graph(out / "dag.voxgraph", VoxelGraph(graphs["ssvdag"], grid))
    write_graph_picture(out / "dag.voxgraph", out / "dag.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [int(level) for level in sys.argv[3:]] or [9, 11])
