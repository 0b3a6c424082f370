"""Labelling many depth meshes against labelling one mesh, and photographs that are added.

    python -m tests.benchmarks.bench_texturing OUT [PROJECT] [--sizes 64 128 256] [--published 64]

After Arikan et al., figure 8, on a project that ``texture`` has been run on or, without one, on a
simulated street of 64 photographs, written to OUT: for depth maps of each size all depth meshes
are labelled; one mesh with as many triangles as these have in the foreground, the surface
simplified, is labelled with the same energy. That is done in two ways:

* ``single``: with this project's solver, which reads each photograph once and looks only at
  triangles that a photograph shows;
* ``published``: as Arikan et al., section 7.3, count it, O(e |I|²) to a cycle: every expansion
  goes over all triangles and edges and evaluates data and seams anew, the colours read from the
  photographs it asks for. Favours are done to it: edges are read by photograph, not one by one,
  so that an expansion asks for each photograph once at most, visibility is found once, and what
  a photograph does not show it is not read for.

Photographs are read from their files by way of a cache (least recently used goes first) that
holds a third of them, or the share that ``--memory`` says, anew for every measurement; one thread.
How often a cache of a third would have to load is counted in any case. Then the last two
photographs are taken for added to the others: which meshes are touched, and whether labels are
those of a run from scratch in which every photograph is asked for every mesh.

Prints tables and writes ``texturing.csv``, ``texturing.svg`` and, where an SVG renderer is at
hand, ``texturing.png`` to OUT. Times do not hold from run to run: compare them within one.
"""

from __future__ import annotations

import argparse
import csv
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import maxflow  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tests.benchmarks.bench_labelling import CACHE_BYTES, Scene, depth_maps, scene_of
from tests.benchmarks.drawing import draw_tradeoff
from tests.benchmarks.street import read, street_cameras, street_front, take
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.simplification import simplified
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.data_costs import penalties
from workbench.kernels.edge_colors import read_edges
from workbench.kernels.pair_costs import seam_costs
from workbench.project.project import Project
from workbench.texturing.candidates import Candidates
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.depth_map import DepthMap
from workbench.texturing.labelling import LabellingProblem, by_photo
from workbench.texturing.multi_mesh import LabelledDepthMesh, labelled_depth_mesh, which_see
from workbench.texturing.picture_cache import PictureCache
from workbench.texturing.shown_candidates import shown_candidates
from workbench.texturing.single_mesh import labelled_surface
from workbench.texturing.texture_costs import side_by_side, texture_problem
from workbench.verification.figures import TradeoffPoint

CYCLES, EDGE_SAMPLES, MOST_CANDIDATES, ADDED = 2, 2, 8, 2
WARMING, STREET = 32, 64
_GREY, _NEVER = 128, 1e12

Load = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class Row:
    """One measurement: seconds and of them those of loading, photographs loaded, and how many
    would be if memory held a third of them.
    """

    way: str
    size: int
    triangles: int
    seconds: float
    load_seconds: float
    loads: int
    loads_of_third: int
    energy: float


class CountedCache(PictureCache):
    """Remembers what it was asked for."""

    asked: list[int]

    def get(self, label: int) -> NDArray[np.uint8]:
        self.asked.append(label)
        return super().get(label)

    def loads_with(self, room: int) -> int:
        """How often photographs would be loaded if so many had room."""
        kept: OrderedDict[int, None] = OrderedDict()
        loads = 0
        for label in self.asked:
            if label not in kept:
                loads += 1
                if len(kept) >= room:
                    kept.popitem(last=False)
            kept[label] = None
            kept.move_to_end(label)
        return loads


class Published:
    """α-expansion over all triangles, all costs evaluated when they are asked for."""

    def __init__(
        self, mesh: TriangleMesh, scene: Scene, candidates: Candidates, options: CostOptions
    ) -> None:
        self.mesh, self.cameras, self.options = mesh, scene.cameras, options
        self.normals, self.areas = face_normals_and_areas(mesh)
        self.middles = mesh.vertices[mesh.triangles].mean(axis=1)
        self.edges, self.ends = side_by_side(mesh.triangles)
        lengths = np.linalg.norm(np.diff(mesh.vertices[self.ends], axis=1)[:, 0], axis=1)
        self.weights = options.smoothness_in_world * lengths
        owner = np.repeat(np.arange(len(self.areas), dtype=np.int32), np.diff(candidates.starts))
        self.shown = {photo: owner[rows] for photo, rows in by_photo(candidates.labels).items()}
        self.labels = np.full(len(self.areas), -1, np.int32)
        best = np.full(len(self.areas), np.inf)
        for photo in self.shown:
            cost = self._data(photo)
            self.labels[cost < best] = photo
            best = np.minimum(best, cost)

    def solve(self, pictures: PictureCache) -> None:
        """So many cycles; each tries every photograph."""
        for _ in range(CYCLES):
            for photo in self.shown:
                self.expand(photo, pictures)

    def _data(self, photo: int) -> NDArray[np.float64]:
        """(m,) what the photograph costs everywhere; infinite where it shows nothing."""
        cost = np.full(len(self.areas), np.inf)
        which = self.shown[photo]
        options = self.options
        cost[which] = self.areas[which] * penalties(
            which, self.middles, self.normals, self.cameras[photo].center,
            options.far, options.distance, options.orientation,
        )  # fmt: skip
        return cost

    def expand(self, photo: int, pictures: PictureCache) -> None:
        """Try a photograph."""
        e = len(self.edges)
        asked, now = self._data(photo), np.zeros(len(self.areas))
        for other in self.shown:
            own = self.labels == other
            now[own] = self._data(other)[own]
        may = np.isfinite(asked) & (self.labels != photo)
        # Rows of colours: of one side's photograph, of the other's, and of the one that is tried.
        colors = np.zeros((3 * e, self.options.edge_samples, 3), np.uint16)
        sides = self.labels[self.edges]
        known = np.column_stack([sides >= 0, np.isfinite(asked)[self.edges].any(axis=1)])
        for other in self.shown:
            rows = [k * e + np.flatnonzero(sides[:, k] == other) for k in range(2)]
            if other == photo:
                rows.append(2 * e + np.flatnonzero(known[:, 2]))
            self._read(other, np.concatenate(rows), pictures, colors)
        row = np.arange(3 * e).reshape(3, e).T
        row = np.where(known, row, -1)
        kept, other_keeps, one_keeps = (
            seam_costs(row[:, pair], self.weights, colors) for pair in ([0, 1], [2, 1], [0, 2])
        )
        gain = np.where(may, asked - now, _NEVER)
        here = known.all(axis=1)
        one, other_side = self.edges[here].T
        np.add.at(gain, one, (other_keeps - kept)[here])
        np.add.at(gain, other_side, -other_keeps[here])
        between = np.maximum(other_keeps + one_keeps - kept, 0.0)[here]
        graph = maxflow.GraphFloat(len(gain), max(len(between), 1))
        nodes = np.asarray(graph.add_nodes(len(gain)))
        graph.add_edges(nodes[one], nodes[other_side], between, np.zeros(len(between)))
        graph.add_grid_tedges(nodes, np.maximum(gain, 0.0), np.maximum(-gain, 0.0))
        graph.maxflow()
        taken = np.asarray(graph.get_grid_segments(nodes)) & may
        self.labels[taken] = photo

    def _read(
        self,
        photo: int,
        rows: NDArray[np.int64],
        pictures: PictureCache,
        colors: NDArray[np.uint16],
    ) -> None:
        if not len(rows):
            return
        ends = self.ends[rows % len(self.edges)]
        used, number = np.unique(ends, return_inverse=True)
        pixels, depths = self.cameras[photo].project(self.mesh.vertices[used])
        read_edges(rows, number.reshape(ends.shape), pixels, depths, pictures.get(photo), colors)


def project_scene(project: Project) -> tuple[Scene, Load]:
    """A project's photographs, and how one is read."""
    store = project.store
    names = store.load("texturing")["photographs"]
    return scene_of(project, 1), lambda number: np.asarray(
        store.load("texture_photos", names[number])
    )


def street_scene(folder: Path) -> tuple[Scene, Load]:
    """A simulated street's, which are written first."""
    folder.mkdir(parents=True, exist_ok=True)
    rays, cameras = SurfaceRays(street_front()), street_cameras(STREET)
    paths = {number: folder / f"{number:03d}.png" for number in cameras}
    for number, path in paths.items():
        if not path.exists():
            take(rays, cameras[number], number, path)
    pictures = PictureCache(lambda number: read(paths[number]), CACHE_BYTES)
    return Scene(rays, cameras, pictures, (0,)), lambda number: read(paths[number])


@dataclass(frozen=True)
class Subject:
    """A scene, how a photograph of it is read, and the share of them that memory holds."""

    scene: Scene
    load: Load
    memory: float

    def cache(self) -> CountedCache:
        """An empty one."""
        whole = sum(4 * camera.width * camera.height for camera in self.scene.cameras.values())
        cache = CountedCache(self.load, int(whole * self.memory) + 1)
        cache.asked = []
        return cache

    def row(
        self, way: str, size: int, triangles: int, start: float, cache: CountedCache, energy: float
    ) -> Row:
        """What has been measured since ``start``."""
        seconds = perf_counter() - start
        third = cache.loads_with(max(1, len(self.scene.cameras) // 3))
        return Row(way, size, triangles, seconds, cache.load_seconds, cache.loads, third, energy)


def label_all(
    scene: Scene,
    maps: Mapping[int, DepthMap],
    seen: Mapping[int, tuple[int, ...]],
    cache: PictureCache,
    options: CostOptions,
) -> dict[int, LabelledDepthMesh]:
    """The depth meshes of photographs, each with those that see it."""
    return {
        photo: labelled_depth_mesh(
            photo, {k: maps[k] for k in others}, {k: scene.cameras[k] for k in others},
            cache.get, options, CYCLES,
        )
        for photo, others in seen.items()
    }  # fmt: skip


def costs_of(maps: Mapping[int, DepthMap], most: int = MOST_CANDIDATES) -> CostOptions:
    """Those of the stage ``texture``."""
    far = far_of_scene(maps.values())
    return CostOptions(far, edge_samples=EDGE_SAMPLES, most_candidates=most)


def full_problem(scene: Scene, mesh: TriangleMesh, options: CostOptions) -> LabellingProblem:
    """All candidates, to hold energies against each other."""
    candidates = shown_candidates(mesh, scene.cameras, scene.pictures.get, options)
    return texture_problem(mesh, scene.cameras, candidates, scene.pictures.get, options)


def compare(subject: Subject, size: int, published: bool) -> list[Row]:
    """All ways at one size of depth maps."""
    scene, maps = subject.scene, depth_maps(subject.scene, size)
    options, every = costs_of(maps), costs_of(maps, 0)
    cache, start = subject.cache(), perf_counter()
    made = label_all(scene, maps, which_see(maps), cache, options)
    foreground = sum(int(mesh.labelled.foreground.sum()) for mesh in made.values())
    energy = sum(mesh.labelling.energy.total for mesh in made.values())
    rows = [subject.row("multi", size, foreground, start, cache, energy)]
    triangles = sum(len(mesh.labelled.labels) for mesh in made.values())
    photos = float(np.mean([len(mesh.photos) for mesh in made.values()]))
    print(
        f"size {size}: {triangles} triangles, {foreground} in the foreground, "
        f"{photos:.1f} candidates a mesh of {len(scene.cameras)} photographs",
        flush=True,
    )
    mesh = simplified(scene.rays.mesh, foreground)
    grey = np.full((len(mesh.vertices), 3), _GREY, np.uint8)
    mesh = TriangleMesh(mesh.vertices, mesh.triangles, {"color": grey})
    problem = full_problem(scene, mesh, every)
    cache, start = subject.cache(), perf_counter()
    labelled, _ = labelled_surface(mesh, scene.cameras, cache.get, options, max_cycles=CYCLES)
    row = subject.row("single", size, len(mesh.triangles), start, cache, 0.0)
    rows.append(replace(row, energy=problem.energy(labelled.labels).total))
    if published:
        cache, start = subject.cache(), perf_counter()
        candidates = shown_candidates(mesh, scene.cameras, cache.get, every)
        solver = Published(mesh, scene, candidates, every)
        solver.solve(cache)
        row = subject.row("published", size, len(mesh.triangles), start, cache, 0.0)
        rows.append(replace(row, energy=problem.energy(solver.labels).total))
    return rows


def added(subject: Subject, size: int) -> None:
    """Two photographs more: meshes that are touched, and whether the result is the same."""
    scene, maps = subject.scene, depth_maps(subject.scene, size)
    # Of the scene as a whole, as the stage rounds it so that it stays.
    options = costs_of(maps)
    cache = subject.cache()
    old = {k: maps[k] for k in sorted(maps)[:-ADDED]}
    before = label_all(scene, old, which_see(old), cache, options)
    seen = which_see(maps)
    touched = {k: others for k, others in seen.items() if k not in old or set(others) - set(old)}
    start = perf_counter()
    anew = before | label_all(scene, maps, touched, cache, options)
    seconds = perf_counter() - start
    everyone = dict.fromkeys(sorted(maps), tuple(sorted(maps)))
    start = perf_counter()
    scratch = label_all(scene, maps, everyone, cache, options)
    same = all(
        np.array_equal(value, scratch[photo].arrays()[name])
        for photo, mesh in anew.items()
        for name, value in mesh.arrays().items()
    )
    changed = sum(
        not np.array_equal(before[k].labelled.labels, scratch[k].labelled.labels) for k in old
    )
    print(
        f"{ADDED} photographs added to {len(old)}: {len(touched)} meshes touched, {ADDED} of them "
        f"new, in {seconds:.1f} s (all {len(maps)}: {perf_counter() - start:.1f} s); the labels of "
        f"{changed} of the old ones changed; the same as from scratch: {same}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("project", type=Path, nargs="?")
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--published", type=int, nargs="*", default=[64])
    parser.add_argument("--memory", type=float, default=1 / 3)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    scene, load = (
        project_scene(Project(asked.project))
        if asked.project
        else street_scene(asked.out / "photos")
    )
    subject = Subject(scene, load, asked.memory)
    rows: list[Row] = []
    with threadpool_limits(1):
        # Loads what is compiled.
        compare(Subject(scene, scene.pictures.get, 1.0), WARMING, published=True)
        print("way         size triangles   seconds   loading  loads  of ⅓    energy", flush=True)
        for size in asked.sizes:
            found = compare(subject, size, size in asked.published)
            rows += found
            for row in found:
                print(
                    f"{row.way:10s}{row.size:6d}{row.triangles:10d}{row.seconds:10.2f}"
                    f"{row.load_seconds:10.2f}{row.loads:7d}{row.loads_of_third:6d}"
                    f"{row.energy:10.4g}   {row.seconds / found[0].seconds:.2f} × depth meshes",
                    flush=True,
                )
        added(subject, asked.sizes[0])
    with (asked.out / "texturing.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(Row.__dataclass_fields__))
        table.writeheader()
        table.writerows(vars(row) for row in rows)
    points = [
        TradeoffPoint(f"{row.way} {row.size}", row.triangles, max(row.seconds, 1e-3))
        for row in rows
    ]
    draw_tradeoff(asked.out, "texturing", points, "labelling (s)", f"multi {asked.sizes[-1]}")


if __name__ == "__main__":
    main()
