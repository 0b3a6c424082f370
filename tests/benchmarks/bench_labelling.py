"""Energy of labelled depth meshes against run time, by depth-map size, pruning and edge samples.

    python -m tests.benchmarks.bench_labelling OUT PROJECT [--photographs N]

labels depth meshes of N photographs (4 by default), evenly chosen, of a project that ``texture``
has been run on, again and again with one setting changed. A setting's error is how far its
labels' energy, with all candidates and 16 places along each edge, is above the best labelling
found at all, or, for the size of depth maps, how far the middles of the meshes' triangles are from
the surface. Prints a table, and writes
``labelling.csv``, ``labelling_pruning.svg``, ``labelling_samples.svg``, ``labelling_cycles.svg``
and ``labelling_size.svg`` and, where an SVG renderer is at hand, ``.png`` to OUT. Times are of one
thread, pictures in memory: compare them within one run.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from tests.benchmarks.drawing import draw_tradeoff
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.project.project import Project
from workbench.texturing.candidates import candidates_of
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.depth_map import (
    DepthMap,
    depth_map_of_surface,
    small_camera,
    usable_pixels,
)
from workbench.texturing.depth_mesh import DepthMesh, depth_mesh
from workbench.texturing.expansion import expanded
from workbench.texturing.labelling import LabellingProblem
from workbench.texturing.lower_bound import lower_bound
from workbench.texturing.picture_cache import PictureCache
from workbench.texturing.texture_costs import texture_problem
from workbench.verification.figures import TradeoffPoint

SIZES, CANDIDATES, SAMPLES, CYCLES = (
    (64, 128, 256, 512),
    (2, 3, 5, 8, 12, 0),
    (1, 2, 4, 8),
    (1, 2, 5),
)
SIZE, FINEST_SAMPLES, MOST_CYCLES, SWEEPS = 256, 16, 20, 10
CACHE_BYTES = 4 << 30


@dataclass(frozen=True)
class Scene:
    """What is labelled."""

    rays: SurfaceRays
    cameras: dict[int, PhotoCamera]
    pictures: PictureCache
    chosen: tuple[int, ...]


@dataclass(frozen=True)
class Row:
    """One setting, the sums over its meshes."""

    kind: str
    value: int
    seconds: float
    error: float
    triangles: int
    candidates: int
    foreground: int


def scene_of(project: Project, count: int) -> Scene:
    """The project's surface and photographs, and those whose meshes are labelled."""
    store = project.store
    names = store.load("texturing")["photographs"]
    poses = store.load("photo_poses")["photos"]

    def load(number: int) -> np.ndarray:
        return np.asarray(store.load("texture_photos", names[number]))

    pictures = PictureCache(load, CACHE_BYTES)
    cameras = {}
    for number, name in enumerate(names):
        pose = poses[name]
        matrix = np.array(pose["camera_from_world"], float)
        width, height = pose["size"]
        camera = PhotoCamera(pose["model"], width, height, tuple(pose["params"]), matrix)
        found = pictures.get(number).shape[:2]
        if found != (height, width):
            camera = small_camera(camera, max(found))
        cameras[number] = camera
    mesh: TriangleMesh
    if project.scene().geometry:
        mesh = read_surface(project.input_paths("geometry_file")[0])
    else:
        mesh = store.load("surface")
    chosen = tuple(np.linspace(0, len(names), count, endpoint=False).astype(int).tolist())
    return Scene(SurfaceRays(mesh), cameras, pictures, chosen)


def depth_maps(scene: Scene, size: int) -> dict[int, DepthMap]:
    """Of all photographs."""
    maps = {}
    for number, camera in scene.cameras.items():
        small = small_camera(camera, size)
        usable = usable_pixels(scene.pictures.get(number)[..., 3], small)
        maps[number] = depth_map_of_surface(scene.rays, small, usable, closed=True)
    return maps


def problem_of(
    scene: Scene, maps: dict[int, DepthMap], number: int, made: DepthMesh, options: CostOptions
) -> LabellingProblem:
    """Candidates and costs of one mesh."""
    found = candidates_of(made.mesh, maps, options, {number: made.outer})
    return texture_problem(made.mesh, scene.cameras, found, scene.pictures.get, options)


def by_setting(scene: Scene) -> Iterable[Row]:
    """Pruning, samples and cycles: energies above the best of all."""
    maps = depth_maps(scene, SIZE)
    options = CostOptions(far_of_scene(maps.values()))
    made = {number: depth_mesh(maps[number]) for number in scene.chosen}
    finest = replace(options, edge_samples=FINEST_SAMPLES)
    full = {n: problem_of(scene, maps, n, made[n], finest) for n in scene.chosen}
    best = {n: expanded(full[n], MOST_CYCLES).energy.total for n in scene.chosen}
    bounds = [lower_bound(full[n], SWEEPS) for n in scene.chosen]
    print(f"best energy {sum(best.values()):.6g}, no less than {sum(bounds):.6g}", flush=True)
    settings = [
        *(
            ("candidates", value, replace(options, most_candidates=value), 2)
            for value in CANDIDATES
        ),
        *(("samples", value, replace(options, edge_samples=value), 2) for value in SAMPLES),
        *(("cycles", value, options, value) for value in CYCLES),
    ]
    for kind, value, setting, cycles in settings:
        seconds, energy, triangles, candidates, foreground = 0.0, 0.0, 0, 0, 0
        for number in scene.chosen:
            start = perf_counter()
            problem = problem_of(scene, maps, number, made[number], setting)
            labels = expanded(problem, cycles).labels
            seconds += perf_counter() - start
            energy += full[number].energy(labels).total
            triangles += len(labels)
            candidates += len(problem.labels)
            foreground += int((labels == number).sum())
        error = 100.0 * (energy / sum(best.values()) - 1.0)
        yield Row(kind, value, seconds, error, triangles, candidates, foreground)


def by_size(scene: Scene) -> Iterable[Row]:
    """Sizes of depth maps: distances from the surface."""
    extent = float(np.linalg.norm(np.ptp(scene.rays.mesh.vertices, axis=0)))
    for size in SIZES:
        start = perf_counter()
        maps = depth_maps(scene, size)
        options = CostOptions(far_of_scene(maps.values()))
        seconds = (perf_counter() - start) * len(scene.chosen) / len(maps)
        squares, area, triangles, candidates, foreground = 0.0, 0.0, 0, 0, 0
        for number in scene.chosen:
            start = perf_counter()
            made = depth_mesh(maps[number])
            problem = problem_of(scene, maps, number, made, options)
            labels = expanded(problem, 2).labels
            seconds += perf_counter() - start
            middles = made.mesh.vertices[made.mesh.triangles].mean(axis=1)
            away = np.linalg.norm(scene.rays.nearest(middles).points - middles, axis=1)
            _, areas = face_normals_and_areas(made.mesh)
            squares += float((areas * away**2).sum())
            area += float(areas.sum())
            triangles += len(labels)
            candidates += len(problem.labels)
            foreground += int((labels == number).sum())
        error = 1e6 * float(np.sqrt(squares / area)) / extent
        print(f"size {size}: area {area:.6g}", flush=True)
        yield Row("size", size, seconds, error, triangles, candidates, foreground)


UNITS = {
    "candidates": "energy above the best (%)",
    "samples": "energy above the best (%)",
    "cycles": "energy above the best (%)",
    "size": "distance from the surface (millionths of its size, RMS)",
}
DRAWN = {"candidates": "pruning"}
CHOSEN = {"candidates": 0, "samples": 4, "cycles": 2, "size": 256}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("project", type=Path)
    parser.add_argument("--photographs", type=int, default=4)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    scene = scene_of(Project(asked.project), asked.photographs)
    rows = []
    with threadpool_limits(1):
        # Loads what is compiled.
        maps = depth_maps(scene, 32)
        options = CostOptions(far_of_scene(maps.values()))
        number = scene.chosen[0]
        expanded(problem_of(scene, maps, number, depth_mesh(maps[number]), options))
        print("setting             seconds     error  triangles candidates foreground", flush=True)
        for row in (*by_setting(scene), *by_size(scene)):
            print(
                f"{row.kind:12s}{row.value:5d}{row.seconds:10.2f}{row.error:10.3f}"
                f"{row.triangles:11d}{row.candidates:11d}{row.foreground:11d}",
                flush=True,
            )
            rows.append(row)
    with (asked.out / "labelling.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(Row.__dataclass_fields__))
        table.writeheader()
        table.writerows(vars(row) for row in rows)
    for kind, unit in UNITS.items():
        points = [
            TradeoffPoint(f"{kind} {row.value or 'all'}", row.seconds, max(row.error, 1e-4))
            for row in rows
            if row.kind == kind
        ]
        chosen = f"{kind} {CHOSEN[kind] or 'all'}"
        draw_tradeoff(asked.out, f"labelling_{DRAWN.get(kind, kind)}", points, unit, chosen)


if __name__ == "__main__":
    main()
