"""The surface in blocks: its seams, its error and its memory, against one piece.

python -m tests.benchmarks.bench_infill_blocks              # blocks against one piece
python -m tests.benchmarks.bench_infill_blocks 30000000     # one large surface, its memory
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np

from stages.infill import INFILL
from stages.infill.options import InfillOptions
from workbench.cloud.building import build_cloud
from workbench.cloud.sample_cloud import SampleBlocks, samples_schema
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.samples import Samples
from workbench.pipeline.freshness import settings_hash
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress
from workbench.pipeline.stage import Job, Products
from workbench.pipeline.tasks import Tasks
from workbench.project.project import Project
from workbench.project.simulated import simulate_project

_PART = 1_000_000
_COUNT, _DEPTHS, _BLOCK_SAMPLES = 200_000, (6, 7, 8, 9, 10), (60_000, 1_000_000)


@dataclass(frozen=True)
class Relief:
    """Noisy samples of a ball of 1 m with waves on it and two holes; its surface is a formula."""

    count: int

    @property
    def spacing_m(self) -> float:
        """Distance between samples."""
        return float(np.sqrt(4 * np.pi / self.count))

    def radius(self, way: np.ndarray) -> np.ndarray:
        """Distance of the surface from the middle along unit vectors (n, 3)."""
        x, y, z = way.T
        coarse = 0.03 * np.sin(7 * x + 1) * np.sin(6 * y) * np.sin(5 * z + 2)
        fine = 0.1 * self.spacing_m * np.sin(0.15 * x / self.spacing_m)
        return 1.0 + coarse + fine

    def normals(self, way: np.ndarray) -> np.ndarray:
        """Outward unit normals (n, 3), by differences."""
        step = 1e-3 * self.spacing_m
        slope = np.empty_like(way)
        for axis, unit in enumerate(np.eye(3)):
            ahead, back = way + step * unit, way - step * unit
            for moved in (ahead, back):
                moved /= np.linalg.norm(moved, axis=1, keepdims=True)
            slope[:, axis] = (self.radius(ahead) - self.radius(back)) / (2 * step)
        normal = way - slope / self.radius(way)[:, None]
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def __iter__(self) -> Iterator[Samples]:
        for start in range(0, self.count, _PART):
            k = np.arange(start, min(start + _PART, self.count))
            z = 1 - (2 * k + 1) / self.count
            turn = np.pi * (1 + np.sqrt(5)) * k
            flat = np.sqrt(1 - z * z)
            way = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
            way = way[(way[:, 2] < 0.97) & (np.linalg.norm(way - [1, 0, 0], axis=1) > 0.15)]
            noise = np.random.default_rng(start).normal(scale=0.1 * self.spacing_m, size=len(way))
            normals = self.normals(way)
            n = len(way)
            yield Samples(
                way * self.radius(way)[:, None] + noise[:, None] * normals,
                normals,
                np.full(n, 1.2 * self.spacing_m),
                np.ones(n),
                np.zeros(n, np.int32),
            )

    def error(self, mesh: TriangleMesh) -> np.ndarray:
        """Distance (n,) of measured vertices from the true surface, metres."""
        points = mesh.vertices[mesh.vertex_attributes["provenance"] == 0]
        length = np.linalg.norm(points, axis=1)
        way = points / length[:, None]
        cosine = np.einsum("nd,nd->n", way, self.normals(way))
        return np.abs(length - self.radius(way)) * cosine


def project_with(samples: Relief, folder: Path) -> Project:
    """A project whose samples lie in a cloud, ready for ``infill``."""
    project = simulate_project(
        folder,
        given={"scene": "sphere", "scans": 1},
        settings=("scanner.rows=20", "scanner.cols=20"),
        progress=Progress(quiet=True),
    )
    path = project.store.path("sample_cloud")
    path.parent.mkdir(parents=True)
    build_cloud(path, SampleBlocks(samples), samples_schema(color=False))
    return project


def infilled(project: Project, options: InfillOptions, workers: int) -> tuple[TriangleMesh, Meter]:
    """The surface of a project, and what making it took."""
    stage, progress = INFILL, Progress()
    job = Job(
        products=Products(project, stage.reads, stage.writes),
        options=options,
        scene=project.scene(),
        progress=progress,
        tasks=Tasks(
            root=project.root,
            stage=stage.name,
            fingerprint=settings_hash(stage, options),
            hashes=project.hashes,
            progress=progress,
            reads=stage.reads,
            writes=stage.writes,
            workers=workers,
        ),
    )
    with Meter() as meter:
        result = stage.run(job)
    for metric in result.metrics:
        print(f"  {metric.name} = {metric.value}")
    return project.store.load("surface"), meter


Depth = int | Literal["auto"]


def main(count: int, depths: tuple[Depth, ...], block_samples: tuple[int, ...]) -> None:
    """Print one row for each depth and size of blocks."""
    samples = Relief(count)
    with tempfile.TemporaryDirectory() as folder:
        start = perf_counter()
        project = project_with(samples, Path(folder) / "project")
        print(f"{count} samples {1e3 * samples.spacing_m:.3f} mm apart, stored in "
              f"{perf_counter() - start:.0f} s")  # fmt: skip
        rows = []
        for depth, most in product(depths, block_samples):
            options = InfillOptions(depth=depth, block_samples=most)
            mesh, meter = infilled(project, options, workers=2)
            error = samples.error(mesh) / samples.spacing_m
            rows.append((depth, most, meter, error, len(mesh.triangles)))
    print("depth   samples at once   seconds   CPU s   peak GiB   RMS   95 %   triangles"
          "   (errors in sample spacings)")  # fmt: skip
    for depth, most, meter, error, triangles in rows:
        print(f"{depth!s:>5s}{most:18d}{meter.seconds:10.1f}{meter.cpu_seconds:8.1f}"
              f"{meter.peak_rss_bytes / 2**30:11.2f}{np.sqrt(np.mean(error**2)):6.3f}"
              f"{np.percentile(error, 95):7.3f}{triangles:12d}")  # fmt: skip


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(int(sys.argv[1]), (int(sys.argv[2]) if len(sys.argv) > 2 else "auto",), (1_000_000,))
    else:
        main(_COUNT, _DEPTHS, _BLOCK_SAMPLES)
