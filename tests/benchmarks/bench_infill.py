"""Error of the surface against run time, for octree depth and rounds of refinement.

    python -m tests.benchmarks.bench_infill OUT

scans the small statue, reconstructs it with each setting at the true poses, prints a table
and writes ``infill_tradeoff.svg`` and, where an SVG renderer is at hand, ``.png`` to OUT.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from tests.benchmarks.drawing import draw_tradeoff
from workbench.cloud.fusion import joined, merged, placed_samples
from workbench.geometry.mesh import TriangleMesh, edge_census, vertex_normals
from workbench.geometry.orientedscan import OrientationSettings, orient
from workbench.geometry.samples import Samples
from workbench.surface.closing import closed_at_box
from workbench.surface.poisson import PoissonSettings, cell_size_m, depth_for_spacing, reconstruct
from workbench.surface.provenance import MEASURED, support_of
from workbench.surface.refinement import moved_onto_samples
from workbench.synthetic import SimulationOptions, build_scene, simulate_scans
from workbench.verification.distances import distance_to_surface
from workbench.verification.figures import TradeoffPoint

DEPTHS, ROUNDS = (6, 7, 8, 9, 10), (0, 2)


def statue() -> tuple[Samples, TriangleMesh]:
    """Merged samples of the small statue (seed 1) and its true surface."""
    options = SimulationOptions(scene="statue", size="small", seed=1)
    scene = build_scene(options)
    scans = list(simulate_scans(options, scene=scene))
    oriented = [orient(s.range_map, OrientationSettings()) for s in scans]
    spacing = float(np.median(np.concatenate([s.spacing_m for s in oriented])))
    poses = [s.local_from_scan for s in scans]
    placed = [
        placed_samples(scan, pose, None, number)
        for number, (scan, pose) in enumerate(zip(oriented, poses, strict=True))
    ]
    return merged(joined(placed), 0.5 * spacing), scene.surface


def surface(samples: Samples, depth: int, rounds: int) -> TriangleMesh:
    """The closed and refined surface."""
    mesh = reconstruct(samples.points, samples.normals, PoissonSettings(depth))
    if not edge_census(mesh.triangles).watertight:
        low, high = samples.bounds
        cell = cell_size_m(low, high, depth)
        low, high = low - cell, high + cell
        mesh = closed_at_box(mesh, low, high)
    return moved_onto_samples(mesh, samples, rounds)


def measured_rms_m(mesh: TriangleMesh, samples: Samples, truth: TriangleMesh) -> float:
    """Root mean square distance of the measured vertices to the truth."""
    support = support_of(mesh.vertices, vertex_normals(mesh), samples, 1.0)
    measured = mesh.vertices[support.provenance == MEASURED]
    return float(np.sqrt(np.mean(distance_to_surface(measured, truth).distance_m ** 2)))


def main(out: Path) -> None:
    samples, truth = statue()
    print(f"{len(samples)} samples\ndepth  rounds  seconds  RMS (mm)  watertight")
    points = []
    for depth in DEPTHS:
        for rounds in ROUNDS:
            start = perf_counter()
            mesh = surface(samples, depth, rounds)
            seconds = perf_counter() - start
            error_mm = 1e3 * measured_rms_m(mesh, samples, truth)
            closed = edge_census(mesh.triangles).watertight
            print(f"{depth:5d}{rounds:8d}{seconds:9.2f}{error_mm:10.4f}  {closed}", flush=True)
            points.append(TradeoffPoint(f"depth {depth}, {rounds} rounds", seconds, error_mm))
    auto = depth_for_spacing(*samples.bounds, float(np.median(samples.radius_m)))
    chosen = f"depth {auto}, 2 rounds"
    draw_tradeoff(out, "infill_tradeoff", points, "RMS error, measured (mm)", chosen)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
