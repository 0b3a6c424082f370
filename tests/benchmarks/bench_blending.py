"""Error of blended colours against run time, for photo size and number, beside plain averaging.

    python -m tests.benchmarks.bench_blending OUT

photographs a painted ball with a flash beside the lens (1 % noise; one photograph in eight has
a clump of highlights) and colours 40,962 vertices of it with each setting, and by what is left
when nothing of it is done: projecting every vertex that faces the camera into each photograph
and taking the mean. Prints tables and writes ``blending_size.svg`` and ``blending_count.svg``
and, where an SVG renderer is at hand, ``.png`` to OUT. Times are wall times of one process and
leave out the drawing of the photographs: compare them within one run.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from tests.color.blending_scene import FLASH, ball, camera_at, paint, photographed
from workbench.color.blending import blended
from workbench.color.blending_colors import Colored, corrected
from workbench.color.blending_observations import observed, weighed_photo
from workbench.color.blending_samples import blocks_of_mesh
from workbench.color.blending_weights import WeightOptions, feathered, pixel_weights
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import lit_by_flash, view_of_surface
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import apply, rotate
from workbench.verification.figures import TradeoffPoint

MESH = ball(6)
SIZES, COUNTS = (100, 200, 400, 800), (6, 12, 24, 48)
Photo = tuple[PhotoCamera, NDArray[np.float32], NDArray[np.bool_]]


def taken(count: int, size: int) -> list[Photo]:
    """Photographs from all round, evenly; every eighth with a highlight."""
    photos = []
    for k in range(count):
        camera = camera_at(2.399963 * k, 1.6 * (k + 0.5) / count - 0.8, size)
        picture, mask = photographed(camera, seed=k)
        if k % 8 == 0:
            middle = size // 2
            picture[middle - size // 16 : middle, middle : middle + size // 16] *= 2.5
        photos.append((camera, picture, mask))
    return photos


def by_workbench(photos: Sequence[Photo]) -> tuple[NDArray[np.float64], int]:
    """Colours (n, 3), and how many observations they rest on."""
    rays, blocks = SurfaceRays(MESH), blocks_of_mesh(MESH)
    found: list[Colored] = []
    for camera, picture, usable in photos:
        view = view_of_surface(rays, blocks[0].normals, camera).smoothed(5)
        weights = pixel_weights(view, picture, usable, WeightOptions())
        lit = lit_by_flash(view, rays, FLASH.position_in_camera)
        weights *= feathered(lit, WeightOptions().feather)
        seen = observed(weighed_photo(view, picture, usable, weights, 8.0), blocks)
        points = MESH.vertices[seen.index]
        found.append(corrected(seen, points, camera.camera_from_world, FLASH, 1.0))
    colors = blended(found, len(MESH.vertices)).colors
    return colors, sum(len(photo.index) for photo in found)


def by_projection(photos: Sequence[Photo]) -> tuple[NDArray[np.float64], int]:
    """The mean of the nearest pixels' albedo over the photographs a vertex faces."""
    normals = MESH.vertex_attributes["normal"]
    sums, count = np.zeros((len(MESH.vertices), 3)), np.zeros(len(MESH.vertices))
    for camera, picture, _ in photos:
        pixels, depths = camera.project(MESH.vertices)
        facing = (normals * (camera.center - MESH.vertices)).sum(axis=1) > 0.0
        at = np.flatnonzero(facing & (depths > 0.0))
        column, row = np.clip(pixels[at].astype(int), 0, camera.width - 1).T
        pose = camera.camera_from_world
        received = FLASH.received(apply(pose, MESH.vertices[at]), rotate(pose, normals[at]))
        sums[at] += picture[row, column] / np.maximum(received, 0.02)[:, None]
        count[at] += 1
    return sums / np.where(count > 0, count, np.nan)[:, None], int(count.sum())


def error_of(colors: NDArray[np.float64]) -> float:
    """RMS of the colours relative to the paint, %, where there are some."""
    relative = colors / paint(MESH.vertices) - 1.0
    return 100.0 * float(np.sqrt(np.nanmean(relative**2)))


def table(title: str, settings: Sequence[tuple[str, int, int]]) -> list[TradeoffPoint]:
    """Measure settings (label, photographs, pixels); prints as it goes."""
    print(f"\n{title}, {len(MESH.vertices)} vertices")
    print("setting                          seconds   observations/s   RMS error   coloured")
    points = []
    for label, count, size in settings:
        photos = taken(count, size)
        for name, way in (("", by_workbench), ("plain mean, ", by_projection)):
            start = perf_counter()
            colors, observations = way(photos)
            seconds = perf_counter() - start
            error = error_of(colors)
            share = 100.0 * np.isfinite(colors).all(axis=1).mean()
            print(
                f"{name + label:32s}{seconds:8.2f}{observations / seconds:17.0f}"
                f"{error:11.2f} %{share:9.1f} %",
                flush=True,
            )
            points.append(TradeoffPoint(name + label, seconds, error))
    return points


def main(out: Path) -> None:
    by_workbench(taken(1, 50))  # kernels are compiled once
    axis = "RMS error of the colours (%)"
    sized = table("photo size", [(f"{size} px", 24, size) for size in SIZES])
    draw_tradeoff(out, "blending_size", sized, axis, f"{SIZES[2]} px")
    counted = table("number", [(f"{count} photographs", count, 400) for count in COUNTS])
    draw_tradeoff(out, "blending_count", counted, axis, f"{COUNTS[2]} photographs")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
