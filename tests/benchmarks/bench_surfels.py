"""Orders of surfels: time and evenness beside other samplers, by number and by resolution.

    python -m tests.benchmarks.bench_surfels MESH OUT [COUNT ...]

takes candidates of MESH at several resolutions, one of them about a million, and from each the
COUNTs (1000, 10000 and 50000 where none is named) with every sampler. Of each it prints seconds
(the best of rounds that take turns), the median and the smallest distance of a sample to its
nearest, and the largest distance of a candidate to its nearest sample, all as shares of those of
the exact order. ``fpsample`` is compared where it is installed (``pip install fpsample``). For
10000 of a million it draws the error, the lack of median distance, for the time, and writes
``surfels_tradeoff.svg`` to OUT, and ``surfels_spacing.npz`` with the distances of the paper's
figure 3.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tests.benchmarks.drawing import draw_tradeoff
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.point_set import PointSet
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.orders import RoundOptions, exact_order, progressive_order, random_order
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.spacing import nearest_distances, spacing_distributions
from workbench.verification.figures import TradeoffPoint

ROUNDS = 5
RESOLUTIONS = (256, 512, 1024)
SIDED_SHARE = 0.1
PLOTTED_COUNT, PLOTTED_CANDIDATES = 10_000, 1_000_000
# Eliminating samples takes seconds: one round tells enough.
SLOW = {"Poisson disk, Open3D"}

Sampler = Callable[[], NDArray[np.float64]]


@dataclass(frozen=True)
class Evenness:
    """How evenly samples lie among candidates, in the unit of these."""

    median: float
    smallest: float
    farthest: float

    @classmethod
    def of(cls, samples: NDArray[np.float64], points: NDArray[np.float64]) -> Evenness:
        apart = nearest_distances(samples)
        middle = points.mean(axis=0)
        farthest = cKDTree(samples - middle).query(points - middle, workers=-1)[0].max()
        return cls(float(np.median(apart)), float(apart.min()), float(farthest))


def samplers(mesh: TriangleMesh, candidates: PointSet, count: int) -> dict[str, Sampler]:
    """Name to a function that samples; the first is what all others are compared with."""
    points = candidates.points
    opposite = SIDED_SHARE * float(np.linalg.norm(np.ptp(points, axis=0)))
    found: dict[str, Sampler] = {
        "exact": lambda: points[exact_order(points, count).picks],
        "exact, both sides": lambda: points[
            exact_order(points, count, normals=candidates.normals, opposite=opposite).picks
        ],
    }
    for subset, step in ((50, 500), (200, 500), (200, 5000), (800, 500)):
        options = RoundOptions(subset=subset, grow_every=step)
        found[f"rounds of {subset}, k = {step}"] = lambda options=options: points[  # type: ignore[misc]
            progressive_order(points, count, options=options).picks
        ]
    found["random"] = lambda: points[random_order(points, count).picks]
    if importlib.util.find_spec("fpsample") is not None:
        import fpsample

        short = points.astype(np.float32)
        for height in (5, 7, 9):
            found[f"fpsample kd-line, h = {height}"] = lambda height=height: points[  # type: ignore[misc]
                np.asarray(fpsample.bucket_fps_kdline_sampling(short, count, h=height))
            ]
    if count <= PLOTTED_COUNT:
        shape = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles)
        )
        found["Poisson disk, Open3D"] = lambda: np.asarray(
            shape.sample_points_poisson_disk(count).points
        )
    return found


def measured(
    mesh: TriangleMesh, candidates: PointSet, count: int
) -> dict[str, tuple[float, Evenness]]:
    """Name to the best time of several rounds and the evenness; prints a table."""
    named = samplers(mesh, candidates, count)
    best = dict.fromkeys(named, np.inf)
    samples: dict[str, NDArray[np.float64]] = {}
    for turn in range(ROUNDS):
        for name, sampler in named.items():
            if turn and name in SLOW:
                continue
            start = perf_counter()
            samples[name] = sampler()
            best[name] = min(best[name], perf_counter() - start)
    even = {name: Evenness.of(chosen, candidates.points) for name, chosen in samples.items()}
    exact = even["exact"]
    print(f"\n{count:,} of {len(candidates):,} candidates; median {exact.median:.4g}")
    print(f"{'':28s}seconds  median  smallest  farthest  samples")
    for name, own in even.items():
        print(
            f"{name:28s}{best[name]:7.3f}{own.median / exact.median:8.3f}"
            f"{own.smallest / exact.smallest:10.3f}{own.farthest / exact.farthest:10.3f}"
            f"{len(samples[name]):9,d}"
        )
    return {name: (best[name], even[name]) for name in named}


def main(mesh_path: Path, out: Path, counts: list[int]) -> None:
    mesh = read_surface(mesh_path)
    surface = PaintedSurface.of(mesh)
    out.mkdir(parents=True, exist_ok=True)
    # Numba compiles at the first call.
    few = np.random.default_rng(0).random((5000, 3))
    exact_order(few, 100, normals=few.astype(np.float32), opposite=0.1)
    progressive_order(few, 100)
    many = None
    for resolution in RESOLUTIONS:
        start = perf_counter()
        candidates, _ = surface_candidates(surface, resolution)
        print(f"\n{resolution} pixels: {len(candidates):,} in {perf_counter() - start:.2f} s")
        if resolution == RESOLUTIONS[-1]:
            # The bound speaks of a million: chosen at random, they keep their density.
            rows = np.random.default_rng(0).permutation(len(candidates))[:PLOTTED_CANDIDATES]
            many = candidates.chosen(np.sort(rows))
        for count in counts:
            if 10 * count <= len(candidates):
                measured(mesh, candidates, count)
    assert many is not None
    figures = measured(mesh, many, PLOTTED_COUNT)
    best = figures["exact"][1].median
    # A name, its seconds and by how much the median distance falls short of the exact order's.
    points = [
        TradeoffPoint(name, seconds, max(0.0, 100.0 * (1.0 - own.median / best)))
        for name, (seconds, own) in figures.items()
    ]
    draw_tradeoff(out, "surfels_tradeoff", points, "lack of median distance (%)", "exact")
    size = float(np.linalg.norm(np.ptp(many.points, axis=0)))
    told = spacing_distributions(many.points, normals=many.normals, opposite=SIDED_SHARE * size)
    arrays = {f"{name} {prefix}": own for name, by in told.items() for prefix, own in by.items()}
    np.savez_compressed(out / "surfels_spacing.npz", **arrays)


if __name__ == "__main__":
    main(
        Path(sys.argv[1]),
        Path(sys.argv[2]),
        [int(count) for count in sys.argv[3:]] or [1000, 10_000, 50_000],
    )
