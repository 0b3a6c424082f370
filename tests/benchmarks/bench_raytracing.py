"""Culled rays from disk against plain Embree: what is asked, moved and lost (Jaspe 2018, 4.7).

    python -m tests.benchmarks.bench_raytracing [--houses 10] [--width 640] [--frames 3]

Two scenes of more than five million triangles: a city, of which a view from the street sees little,
and a relief, of which a view sees nearly all. The cache holds 20 % of the geometry. Seconds are
those of the processor, of both cores; those of plain Embree are told with and without the building
of its scene, and those of culled rays begin with an empty cache.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.raytracing.chunk_building import build_chunk_file
from workbench.raytracing.chunk_file import ChunkFile
from workbench.raytracing.culled_rays import CulledRays, CullingOptions
from workbench.raytracing.embree_scene import scene_bytes
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.ray_hits import RayCaster
from workbench.raytracing.ray_light import (
    LIGHT_KINDS,
    Fronts,
    LightKind,
    LightOptions,
    picture_light,
    primary_rays,
)
from workbench.raytracing.surface_source import MeshSource
from workbench.raytracing.whole_rays import WholeRays

SHARE = 0.2
THRESHOLDS = (0, 20, 100, 200)


@dataclass(frozen=True)
class View:
    """A walk of an eye that looks at a place."""

    name: str
    eye: tuple[float, float, float]
    step: tuple[float, float, float]
    to: tuple[float, float, float]


@dataclass(frozen=True)
class Walk:
    """What came of one."""

    seconds: float
    pictures: list[NDArray[np.float32]]
    rays: int
    queries: int
    bytes_read: int


def wall(
    corner: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], cells: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A front with relief, as a grid."""
    s, t = np.meshgrid(*2 * [np.linspace(0.0, 1.0, cells + 1)])
    away = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    depth = 0.03 * np.tanh(4.0 * np.sin(25.0 * s) * np.sin(31.0 * t)) * np.sin(np.pi * s)
    depth = depth + 0.004 * np.sin(170.0 * s + 90.0 * t)
    at = corner + s[..., None] * u + t[..., None] * v + depth[..., None] * away
    first = np.arange(cells * (cells + 1)).reshape(cells, -1)[:, :-1].ravel()
    lower = np.stack([first, first + 1, first + cells + 1], axis=1)
    upper = np.stack([first + 1, first + cells + 2, first + cells + 1], axis=1)
    return at.reshape(-1, 3), np.concatenate([lower, upper])


def joined(parts: list[tuple[NDArray[np.float64], NDArray[np.int64]]]) -> TriangleMesh:
    starts = np.cumsum([0, *(len(points) for points, _ in parts)])
    triangles = [t + start for (_, t), start in zip(parts, starts, strict=False)]
    vertices = np.concatenate([points for points, _ in parts])
    colors = 70 + 60 * np.sin(vertices * [3.0, 5.0, 2.0]) + [60, 30, 0]
    return TriangleMesh(
        vertices,
        np.concatenate(triangles).astype(np.int32),
        {"color": np.clip(colors, 0, 255).astype(np.uint8)},
    )


def city(houses: int, cells: int = 85) -> TriangleMesh:
    """Houses in rows, with streets between."""
    random = np.random.default_rng(0)
    size = 1.6 * houses
    parts = [wall(np.zeros(3), np.array([size, 0, 0]), np.array([0, size, 0]), 4 * cells)]
    for row, column in np.ndindex(houses, houses):
        x, y, h = 1.6 * row + 0.3, 1.6 * column + 0.3, random.uniform(1.0, 3.0)
        corners = np.array([[x, y, 0], [x + 1, y, 0], [x + 1, y + 1, 0], [x, y + 1, 0.0]])
        for k in range(4):
            along = corners[(k + 1) % 4] - corners[k]
            parts.append(wall(corners[k], along, np.array([0, 0, h]), cells))
        roof = corners[0] + [0, 0, h]
        parts.append(wall(roof, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), cells))
    return joined(parts)


def relief(houses: int) -> TriangleMesh:
    """One wavy sheet."""
    (points, triangles) = wall(
        np.zeros(3), np.array([16.0, 0, 0]), np.array([0, 16.0, 0]), 160 * houses
    )
    points[:, 2] += 0.8 * np.sin(points[:, 0]) * np.cos(1.3 * points[:, 1])
    return joined([(points, triangles)])


def walk(
    caster: RayCaster, view: View, kind: LightKind, options: LightOptions, width: int, frames: int
) -> Walk:
    """Pictures along a view."""
    fronts, pictures = Fronts(), []
    eyes = [np.array(view.eye) + frame * np.array(view.step) for frame in range(frames)]
    all_rays = [view_rays(caster.frame, eye, np.array(view.to), width) for eye in eyes]
    before, start = (caster.counts.rays, caster.counts.queries, caster.counts.bytes_read), cpu()
    for rays in all_rays:
        pictures.append(picture_light(caster, rays, kind, options, fronts)[0])
    done = (caster.counts.rays, caster.counts.queries, caster.counts.bytes_read)
    counts = [now - then for now, then in zip(done, before, strict=True)]
    return Walk(cpu() - start, pictures, *counts)


def view_rays(
    frame: LocalFrame, eye: NDArray[np.float64], to: NDArray[np.float64], width: int
) -> NDArray[np.float32]:
    """Of a picture of 16 by 9."""
    forward = (to - eye) / np.linalg.norm(to - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    height = width * 9 // 16
    lens = (0.8 * width, 0.8 * width, width / 2, height / 2)
    return primary_rays(frame, PhotoCamera("PINHOLE", width, height, lens, pose))[0]


def cpu() -> float:
    return time.process_time()


def opened(file: ChunkFile, threshold: int = 0) -> CulledRays:
    """With an empty cache."""
    return CulledRays(
        file, int(SHARE * scene_bytes(file.triangles)), CullingOptions(threshold=threshold)
    )


def table(
    name: str,
    mesh: TriangleMesh,
    views: list[View],
    arguments: argparse.Namespace,
    folder: Path,
) -> None:
    source = MeshSource(mesh)
    start = cpu()
    file = build_chunk_file(source, folder / f"{name}.raychunks")
    cut = cpu() - start
    start = cpu()
    whole = WholeRays(source)
    # Open3D has Embree build its hierarchy at the first cast.
    whole.nearest(np.ones((1, 6), np.float32))
    build = cpu() - start
    size = file.path.stat().st_size
    print(
        f"\n{name}: {len(mesh.triangles):,} triangles in {len(file.chunks)} chunks, "
        f"{size / 1e6:.0f} MB on disk, cut in {cut:.1f} s; in core "
        f"{scene_bytes(file.triangles) / 1e6:.0f} MB, built in {build:.1f} s; "
        f"the cache holds {SHARE:.0%}"
    )
    print(
        f"{'view':6s}{'kind':>9s}{'Mrays/s':>9s}{'in core':>9s}{'queries':>10s}{'MB read':>9s}"
        f"{'CPU s':>8s}{'in core':>9s}{'ratio':>7s}{'+ build':>9s}{'other px':>10s}"
    )
    options = LightOptions(samples=arguments.samples)
    for view in views:
        for kind in LIGHT_KINDS:
            plain = walk(whole, view, kind, options, arguments.width, arguments.frames)
            culled = walk(opened(file), view, kind, options, arguments.width, arguments.frames)
            other = sum(
                int((a != b).any(axis=1).sum())
                for a, b in zip(plain.pictures, culled.pictures, strict=True)
            )
            print(
                f"{view.name:6s}{kind:>9s}{culled.rays / culled.seconds / 1e6:9.2f}"
                f"{plain.rays / plain.seconds / 1e6:9.2f}{culled.queries / arguments.frames:10,.0f}"
                f"{culled.bytes_read / arguments.frames / 1e6:9.1f}{culled.seconds:8.2f}"
                f"{plain.seconds:9.2f}{culled.seconds / plain.seconds:7.2f}"
                f"{culled.seconds / (plain.seconds + build):9.2f}{other:10d}",
                flush=True,
            )
    print(
        f"\n{name}, aggressive, kind bounce\n{'view':6s}{'rays':>6s}{'CPU s':>8s}{'speed-up':>10s}"
        f"{'MB read':>9s}{'mean error of 255':>19s}"
    )
    for view in views:
        exact = None
        for threshold in THRESHOLDS:
            done = walk(
                opened(file, threshold), view, "bounce", options, arguments.width, arguments.frames
            )
            exact = exact or done
            error = np.mean(
                [
                    np.abs(encoded(a) - encoded(b)).mean()
                    for a, b in zip(exact.pictures, done.pictures, strict=True)
                ]
            )
            print(
                f"{view.name:6s}{threshold:6d}{done.seconds:8.2f}"
                f"{exact.seconds / done.seconds:10.2f}"
                f"{done.bytes_read / arguments.frames / 1e6:9.1f}"
                f"{error:19.3f}",
                flush=True,
            )


def encoded(linear: NDArray[np.float32]) -> NDArray[np.float64]:
    """About as sRGB, to 255."""
    return 255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--houses", type=int, default=10)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--samples", type=int, default=4)
    arguments = parser.parse_args()
    # The middle of a street.
    half = 1.6 * (arguments.houses // 2)
    scenes: list[tuple[str, Callable[[int], TriangleMesh], list[View]]] = [
        (
            "city",
            city,
            [
                View("near", (half, 0.2, 0.5), (0.0, 0.05, 0.0), (half + 0.2, 6.0, 0.7)),
                View("far", (-6.0, -6.0, 9.0), (0.2, 0.0, 0.0), (half, half, 0.0)),
            ],
        ),
        (
            "relief",
            relief,
            [
                View("near", (8.0, 1.0, 1.6), (0.0, 0.05, 0.0), (8.0, 6.0, 0.0)),
                View("far", (-6.0, -6.0, 9.0), (0.2, 0.0, 0.0), (8.0, 8.0, 0.0)),
            ],
        ),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for name, make, views in scenes:
            table(name, make(arguments.houses), views, arguments, Path(folder))


if __name__ == "__main__":
    main()
