"""Held-out views by stitching and by simpler ways, and what its settings cost and bring.

    python -m tests.benchmarks.bench_stitching OUT PROJECT [--held N] [--size PX] [--disturb]

leaves N photographs (4 by default), evenly chosen, out of a project that ``texture`` has been run
on, labels the depth meshes of the others anew and renders the views of those left out: stitched,
with every pixel's own choice among equals in rank, with a chance choice, from the z-buffer, by
overwriting, from one labelled mesh of as many triangles as all foregrounds have, and blended.
``--disturb`` turns every camera by a tenth of a degree and changes every exposure by up to 0.3
stops first. Only pixels count that every way colours from a photograph. Prints the table (PSNR,
SSIM, sharpness as share of the photograph's, steps of colour across labels before and after
levelling, share of pixels at borders of labels, mean penalty), then settings of
the vote and of levelling against run time. Writes ``stitching.csv``,
``stitching_vote.svg``, ``stitching_levelling.svg`` and, where an SVG renderer is at hand, ``.png``,
and ``view_METHOD.png`` of the first view to OUT. Times are of one thread, pictures in memory.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tests.benchmarks.bench_labelling import Scene, depth_maps, scene_of
from tests.benchmarks.drawing import draw_tradeoff
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import from_twist
from workbench.project.project import Project
from workbench.render.stitch.alternatives import blended, overwritten, photo_depth, z_buffered
from workbench.render.stitch.levelling import LevellingSettings, levelling
from workbench.render.stitch.renderer import StitchedView, colored_view
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.stitching import (
    Fragments,
    StitchSettings,
    choice,
    chosen_fragments,
    competition,
    stitched,
)
from workbench.render.stitch.visibility import visibility
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.multi_mesh import labelled_depth_mesh
from workbench.texturing.single_mesh import far_of_surface, labelled_surface
from workbench.verification.figures import TradeoffPoint
from workbench.verification.image_quality import color_steps, psnr, sharpness, ssim

ROUNDS, RADII = (0, 1, 2, 3, 5), (1, 2, 5, 8)
ITERATIONS, CONVERGED = (1, 2, 3, 4, 6, 8), 60
TURN_DEG, STOPS = 0.1, 0.3
ALONE = StitchSettings(rounds=0)
CHANCE = StitchSettings(rounds=0, coarseness_weight=0.0)


@dataclass(frozen=True)
class Row:
    """One way to draw, means over the views."""

    method: str
    psnr: float
    psnr_before_levelling: float
    ssim: float
    sharpness: float
    step_before: float
    step_after: float
    borders: float
    penalty: float
    seconds: float


@dataclass(frozen=True)
class Held:
    """What is drawn, and the photographs it is compared with."""

    scene: Scene
    stitch: StitchScene
    single: StitchScene
    own: list[int]
    views: list[int]
    pictures: Callable[[int], NDArray[np.uint8]]

    def truth(self, view: int) -> NDArray[np.uint8]:
        return self.scene.pictures.get(view)


def held_out(project: Project, count: int, size: int, disturbed: bool) -> Held:
    """Depth meshes and one mesh, labelled without the photographs that are held out."""
    scene = scene_of(project, count)
    views = list(scene.chosen)
    own = [number for number in scene.cameras if number not in views]
    cameras, pictures = dict(scene.cameras), scene.pictures.get
    if disturbed:
        rng = np.random.default_rng(0)
        gains = 2.0 ** rng.uniform(-STOPS, STOPS, max(cameras) + 1)
        for number in own:
            axis = rng.normal(size=3)
            turn = from_twist([*(np.radians(TURN_DEG) * axis / np.linalg.norm(axis)), 0, 0, 0])
            pose = turn @ cameras[number].camera_from_world
            cameras[number] = replace(cameras[number], camera_from_world=pose)
        pictures = _exposed(pictures, gains)
    seen = replace(scene, cameras={number: cameras[number] for number in own})
    maps = depth_maps(seen, size)
    options = CostOptions(far_of_scene(maps.values()))
    start = perf_counter()
    meshes = [
        labelled_depth_mesh(number, maps, seen.cameras, pictures, options).labelled
        for number in own
    ]
    multi = perf_counter() - start
    foreground = sum(int(mesh.foreground.sum()) for mesh in meshes)
    start = perf_counter()
    mesh = decimated(scene.rays.mesh, foreground)
    single, _ = labelled_surface(
        mesh, seen.cameras, pictures, CostOptions(far_of_surface(mesh, seen.cameras))
    )
    print(
        f"{len(own)} meshes of {sum(len(m.labels) for m in meshes)} triangles, {foreground} in the"
        f" foreground, in {multi:.1f} s; one of {len(single.labels)} in"
        f" {perf_counter() - start:.1f} s",
        flush=True,
    )
    drawn = replace(scene, cameras=cameras)
    return Held(drawn, StitchScene.of(meshes), _of_one(single), own, views, pictures)


def _of_one(mesh: LabelledMesh) -> StitchScene:
    return StitchScene.of([mesh])


def _exposed(pictures: Callable[[int], NDArray[np.uint8]], gains: NDArray[np.float64]):
    kept: dict[int, NDArray[np.uint8]] = {}

    def load(number: int) -> NDArray[np.uint8]:
        if number not in kept:
            picture = pictures(number).copy()
            value = np.arange(256) / 255.0
            linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
            linear = np.clip(linear * gains[number], 0.0, 1.0)
            coded = np.where(
                linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055
            )
            picture[..., :3] = np.round(255.0 * coded).astype(np.uint8)[picture[..., :3]]
            kept[number] = picture
        return kept[number]

    return load


def decimated(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    """To so many triangles, by quadrics; grey where no photograph is."""
    import open3d as o3d

    solid = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles)
    )
    if triangles < len(mesh.triangles):
        solid = solid.simplify_quadric_decimation(triangles)
    vertices = np.asarray(solid.vertices)
    grey = np.full((len(vertices), 3), 128, np.uint8)
    return TriangleMesh(vertices, np.asarray(solid.triangles, np.int32), {"color": grey})


def drawn(held: Held, view: int) -> dict[str, tuple[StitchScene, Fragments, float]]:
    """Fragments by every way to choose them, and the seconds it took."""
    scene, camera = held.stitch, held.scene.cameras[view]
    rng = np.random.default_rng(1)
    chance = np.repeat(rng.random(scene.meshes).astype(np.float32), np.diff(scene.starts))
    by_chance = replace(scene, penalties=chance)
    ranks = list(range(scene.meshes))
    ways: dict[str, tuple[StitchScene, Callable[[], Fragments]]] = {
        "stitched": (scene, lambda: stitched(scene, camera, visibility(scene, camera))),
        "own choice": (
            scene,
            lambda: stitched(scene, camera, visibility(scene, camera), ALONE),
        ),
        "by chance": (
            scene,
            lambda: stitched(by_chance, camera, visibility(scene, camera), CHANCE),
        ),
        "z-buffer": (scene, lambda: z_buffered(scene, camera)),
        "overwriting": (scene, lambda: overwritten(scene, camera, held.own, ranks)),
        "single mesh": (held.single, lambda: z_buffered(held.single, camera)),
    }
    out = {}
    for name, (of, way) in ways.items():
        start = perf_counter()
        shown = way()
        out[name] = (of, shown, perf_counter() - start)
    return out


def measured(held: Held, view: int, out: Path | None) -> dict[str, tuple[float, ...]]:
    """Of every method: the numbers of `Row`, for one view."""
    cameras = [held.scene.cameras[k] for k in range(max(held.scene.cameras) + 1)]
    picture = held.truth(view)
    truth = picture[..., :3].astype(np.float32) / 255.0
    ways = drawn(held, view)
    mask = picture[..., 3] > 0
    made, times = {}, {}
    for name, (scene, shown, seconds) in ways.items():
        start = perf_counter()
        made[name] = colored_view(scene, shown, cameras, held.pictures)
        times[name] = seconds + perf_counter() - start
        # Stand-ins for photographs are not what is compared.
        mask &= made[name].textured.label != NO_PHOTO
    own_sharpness = sharpness(truth, mask)
    found = {}
    for name, view_made in made.items():
        numbers = _of(view_made, ways[name][0], truth, mask, own_sharpness)
        found[name] = (*numbers, times[name])
        if out:
            _write(out / f"view_{name.replace(' ', '_')}.png", view_made.color)
    start = perf_counter()
    depths = {k: photo_depth(held.stitch, cameras[k]) for k in held.own}
    color = blended(
        ways["stitched"][1], held.stitch, cameras, held.pictures, held.own, depths.__getitem__
    )
    value = psnr(color, truth, mask)
    found["blending"] = (
        value,
        value,
        ssim(color, truth, mask),
        sharpness(color, mask) / own_sharpness,
        *[float("nan")] * 4,
        perf_counter() - start,
    )
    if out:
        _write(out / "view_blending.png", color)
        _write(out / "view_photograph.png", truth * mask[..., None])
    return found


def _of(
    made: StitchedView,
    scene: StitchScene,
    truth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    own_sharpness: float,
) -> tuple[float, ...]:
    shown, bare = made.shown, made.textured
    before = color_steps(bare.color, bare.label, shown.depth, scene.epsilon)
    after = color_steps(made.color, bare.label, shown.depth, scene.epsilon)
    penalty = scene.penalties[shown.triangle[shown.seen]]
    return (
        psnr(made.color, truth, mask),
        psnr(bare.color, truth, mask),
        ssim(made.color, truth, mask),
        sharpness(made.color, mask) / own_sharpness,
        before.across,
        after.across,
        before.pairs / max(int(shown.seen.sum()), 1),
        float(penalty[np.isfinite(penalty)].mean()),
    )


def _write(path: Path, color: NDArray[np.float32]) -> None:
    cv2.imwrite(str(path), np.round(255.0 * color[..., ::-1]).astype(np.uint8))


def vote_points(held: Held) -> list[TradeoffPoint]:
    """Borders of labels against the seconds of the choice, by rounds and radius."""
    settings = {f"rounds {k}": StitchSettings(rounds=k) for k in ROUNDS}
    settings |= {f"radius {k}": StitchSettings(radius_px=k) for k in RADII}
    points = []
    for name, setting in settings.items():
        seconds, borders, seen = 0.0, 0, 0
        for view in held.views:
            camera = held.scene.cameras[view]
            visible = visibility(held.stitch, camera)
            competing = competition(held.stitch, camera, visible, setting)
            start = perf_counter()
            chosen = choice(held.stitch, competing, setting)
            seconds += perf_counter() - start
            shown = chosen_fragments(held.stitch, camera, competing, chosen)
            flat = np.zeros((*shown.label.shape, 3), np.float32)
            borders += color_steps(flat, shown.label, shown.depth, shown.epsilon).pairs
            seen += int(shown.seen.sum())
        points.append(TradeoffPoint(name, seconds / len(held.views), 100.0 * borders / seen))
    return points


def levelling_points(held: Held) -> list[TradeoffPoint]:
    """Distance from the converged texture against seconds, by iterations; RMS of 255."""
    cameras = [held.scene.cameras[k] for k in range(max(held.scene.cameras) + 1)]
    camera = held.scene.cameras[held.views[0]]
    shown = stitched(held.stitch, camera, visibility(held.stitch, camera))
    bare = colored_view(held.stitch, shown, cameras, held.pictures).textured

    def texture(iterations: int) -> NDArray[np.float32]:
        settings = LevellingSettings(iterations, 0.0)
        return levelling(
            bare.color, bare.label, shown.depth, shown.epsilon, settings, bare.seam
        ).change

    best = texture(CONVERGED)
    points = []
    for iterations in ITERATIONS:
        start = perf_counter()
        change = texture(iterations)
        seconds = perf_counter() - start
        error = float(np.sqrt(np.mean((change - best)[shown.seen] ** 2)))
        points.append(TradeoffPoint(f"iterations {iterations}", seconds, 255.0 * error))
    return points


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("project", type=Path)
    parser.add_argument("--held", type=int, default=4)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--disturb", action="store_true")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    with threadpool_limits(1):
        held = held_out(Project(asked.project), asked.held, asked.size, asked.disturb)
        measured(held, held.views[0], None)  # Loads what is compiled, and pictures.
        each = [measured(held, view, None if k else asked.out) for k, view in enumerate(held.views)]
        rows = [Row(name, *np.mean([one[name] for one in each], axis=0)) for name in each[0]]
        print("method         PSNR (before)  SSIM  sharp  step → step  borders penalty seconds")
        for row in rows:
            print(
                f"{row.method:12s}{row.psnr:7.2f} ({row.psnr_before_levelling:5.2f}){row.ssim:8.3f}"
                f"{row.sharpness:7.2f}{row.step_before:7.2f}{row.step_after:7.2f}"
                f"{100 * row.borders:8.1f}%{row.penalty:8.3f}{row.seconds:8.2f}",
                flush=True,
            )
        vote, level = vote_points(held), levelling_points(held)
    for point in (*vote, *level):
        print(f"{point.name:14s}{point.x:8.3f} s{point.y:10.4f}")
    with (asked.out / "stitching.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(Row.__dataclass_fields__))
        table.writeheader()
        table.writerows(vars(row) for row in rows)
    draw_tradeoff(asked.out, "stitching_vote", vote, "borders of labels (% of pixels)", "rounds 3")
    draw_tradeoff(
        asked.out, "stitching_levelling", level, "from converged (RMS of 255)", "iterations 4"
    )


if __name__ == "__main__":
    main()
