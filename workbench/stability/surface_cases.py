"""Closed surfaces from samples of extreme density, orientation, place and size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.fusion import merged
from workbench.geometry.mesh import TriangleMesh, edge_census, vertex_normals
from workbench.geometry.samples import Samples
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.surface.closing import closed_at_box
from workbench.surface.poisson import PoissonSettings, reconstruct
from workbench.surface.provenance import MEASURED, told_by_samples
from workbench.surface.refinement import moved_onto_samples

_METHOD = "screened Poisson"
_UTM = np.array([512_345.0, 5_412_345.0, 312.0])


def ball_samples(count: int, radius: float = 1.0, outwards: bool = True) -> Samples:
    """Samples spread evenly over a sphere about the origin, along a golden spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    normals = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return _samples(radius * normals, normals if outwards else -normals,
                    1.5 * radius * np.sqrt(4 * np.pi / count))  # fmt: skip


def _samples(
    points: NDArray[np.float64], normals: NDArray[np.float64], reach: float | NDArray[np.float64]
) -> Samples:
    n = len(points)
    return Samples(
        points, normals, np.broadcast_to(reach, n).copy(), np.ones(n), np.zeros(n, np.int32)
    )


def _solved(samples: Samples, depth: int = 6, rounds: int = 2) -> TriangleMesh:
    """The surface as the stage makes it: solved, moved onto its samples, provenance told."""
    mesh = reconstruct(samples.points, samples.normals, PoissonSettings(depth))
    if not edge_census(mesh.triangles).watertight:
        low, high = samples.bounds
        margin = 0.02 * float((high - low).max())
        mesh = closed_at_box(mesh, low - margin, high + margin)
    mesh = moved_onto_samples(mesh, samples, rounds)
    return told_by_samples(mesh.with_attributes(normal=vertex_normals(mesh)), samples, 1.0)


def _off_ball(mesh: TriangleMesh, radius: float = 1.0) -> float:
    return float(np.abs(np.linalg.norm(mesh.vertices, axis=1) - radius).max())


def _measured(mesh: TriangleMesh, value: float) -> Measured:
    """A value that counts only for a closed surface."""
    census = edge_census(mesh.triangles)
    share = float((mesh.vertex_attributes["provenance"] == MEASURED).mean())
    told = f"{len(mesh.triangles)} triangles, {share:.0%} of the vertices measured"
    if not census.watertight:
        return Measured.nothing(f"not closed: {census}")
    return Measured(value, told)


def _density() -> Measured:
    """300 samples over a ball, and a patch of it a million times as dense."""
    sparse = ball_samples(300)
    rng = np.random.default_rng(0)
    # 30 000 samples on what has an area of 4 π · 30 000 / 300 / 10⁶.
    reach = np.sqrt(4 * 30_000 / 300 / 1e6)
    angle, out = rng.uniform(0, 2 * np.pi, 30_000), reach * np.sqrt(rng.random(30_000))
    patch = np.stack([out * np.cos(angle), out * np.sin(angle), np.sqrt(1 - out**2)], axis=1)
    points = np.concatenate([sparse.points, patch])
    radius = np.concatenate([sparse.radius_m, np.full(len(patch), 1.5 * reach / 173)])
    mesh = _solved(_samples(points, points.copy(), radius), depth=7)
    return _measured(mesh, _off_ball(mesh))


def _flipped(share: float) -> Measured:
    ball = ball_samples(4000)
    wrong = np.random.default_rng(1).random(len(ball)) < share
    mesh = _solved(replace(ball, normals=np.where(wrong[:, None], -ball.normals, ball.normals)))
    return _measured(mesh, _off_ball(mesh))


def _coincident() -> Measured:
    """Every sample 20 times, and 5000 more at one of the places."""
    ball = ball_samples(3000)
    rows = np.concatenate([np.repeat(np.arange(3000), 20), np.zeros(5000, np.int64)])
    mesh = _solved(ball.chosen(rows))
    return _measured(mesh, _off_ball(mesh))


def _nested() -> Measured:
    """A hollow ball: the volume between two shells half a radius apart."""
    outer, inner = ball_samples(4000), ball_samples(1500, 0.5, outwards=False)
    both = _samples(
        np.concatenate([outer.points, inner.points]),
        np.concatenate([outer.normals, inner.normals]),
        np.concatenate([outer.radius_m, inner.radius_m]),
    )
    mesh = _solved(both)
    true = 4 / 3 * np.pi * (1 - 0.5**3)
    return _measured(mesh, abs(_volume(mesh) / true - 1))


def _volume(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _open_sheet() -> Measured:
    """A flat square seen from one side: all else of a closed surface is guessed."""
    x, y = (v.ravel() for v in np.meshgrid(*(np.linspace(-0.5, 0.5, 50),) * 2))
    points = np.stack([x, y, np.zeros_like(x)], axis=1)
    mesh = _solved(_samples(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), 0.03))
    away = np.maximum(np.abs(mesh.vertices[:, 2]), np.abs(mesh.vertices[:, :2]).max(axis=1) - 0.5)
    told = mesh.vertex_attributes["provenance"] == MEASURED
    backs = int((told & (mesh.vertex_attributes["normal"][:, 2] < 0.0)).sum())
    if backs:
        return Measured.nothing(f"{backs} vertices of the side that nobody saw count as measured")
    return _measured(mesh, float(away[told].max(initial=0.0)))


@cache
def _solved_ball() -> TriangleMesh:
    return _solved(ball_samples(2000))


def _elsewhere(factor: float, shift: NDArray[np.float64]) -> Measured:
    """The same ball in another unit and at another place, brought back."""
    ball = ball_samples(2000)
    there = replace(ball, points=factor * ball.points + shift, radius_m=factor * ball.radius_m)
    here, mesh = _solved_ball(), _solved(there)
    if here.triangles.shape != mesh.triangles.shape:
        return Measured.nothing(f"{len(mesh.triangles)} triangles, not {len(here.triangles)}")
    return _measured(mesh, float(np.abs((mesh.vertices - shift) / factor - here.vertices).max()))


def _single_precision() -> Measured:
    ball = ball_samples(4000)
    mesh = _solved(replace(ball, points=ball.points.astype(np.float32).astype(np.float64)))
    return _measured(mesh, _off_ball(mesh))


def _one_place() -> Refused | Measured:
    normals = ball_samples(100).normals
    mesh = reconstruct(np.ones((100, 3)), normals, PoissonSettings(6))
    return Measured.nothing(f"{len(mesh.triangles)} triangles of one place")


def _no_reach() -> Measured:
    """Samples that stand for no area at all: nothing is measured, nothing moves."""
    ball = replace(ball_samples(2000), radius_m=np.zeros(2000))
    mesh = _solved(ball)
    measured = float((mesh.vertex_attributes["provenance"] == MEASURED).mean())
    return _measured(mesh, max(_off_ball(mesh), measured))


def _no_confidence() -> Measured | Refused:
    """Samples of one cell whose confidences are all zero."""
    ball = replace(ball_samples(2000), confidence=np.zeros(2000))
    return Measured.nothing(f"{len(merged(ball, 0.2))} samples without weight")


def _two_sides() -> Measured:
    """Both sides of a sheet a hundredth of a cell apart: merging keeps them apart."""
    x, y = (v.ravel() for v in np.meshgrid(*(np.linspace(-0.5, 0.5, 60),) * 2))
    points = np.concatenate([np.stack([x, y, z * np.ones_like(x)], axis=1) for z in (5e-4, -5e-4)])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], len(x), axis=0)
    found = merged(_samples(points, normals, 0.02), 0.1)
    return Measured(float(np.abs(found.points[:, 2] - 5e-4 * found.normals[:, 2]).max()))


def _far_cells() -> Measured | Refused:
    """Samples at UTM coordinates in cells of a micrometre."""
    ball = ball_samples(2000)
    found = merged(replace(ball, points=ball.points + _UTM), 1e-6)
    same = np.sort(found.points - _UTM, axis=0) - np.sort(ball.points, axis=0)
    if len(found) != len(ball):
        return Measured.nothing(f"{len(ball) - len(found)} samples lost")
    return Measured(float(np.abs(same).max()))


def _case(
    name: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
    method: str = _METHOD,
) -> Case:
    return Case(f"surface/{name}", method, stiff, run, bound, refusal)


# A third of a cell, which at depth 6 is 2.2 / 64 of the radius; moving onto the samples' planes
# leaves the sagitta of a sample distance, 4e-4 at 4000 samples.
_BALL = Bound(0.012, "radii", "a third of the octree's finest cell")

SURFACE_CASES = (
    _case("density 1e6:1", "A patch of a ball is sampled a million times as densely as the rest.",
          _density, Bound(0.03, "radii", "six sagittas of the sparse spacing of 0.2 radii")),
    _case("flipped normals 10 %", "Every tenth normal points inwards.", partial(_flipped, 0.1),
          _BALL),
    _case("coincident samples", "Every sample 20 times, and one of them 5000 times.",
          _coincident, _BALL),
    _case("nested shells", "A cavity inside a ball.", _nested,
          Bound(0.01, "of the volume", "a third of a finest cell over both shells")),
    _case("open sheet", "A square seen from one side only has to become a closed surface.",
          _open_sheet, Bound(0.03, "m", "the reach of a sample: farther off all is filled in")),
    _case("scale 1e-6", "A ball of one micrometre.", partial(_elsewhere, 1e-6, np.zeros(3)),
          Bound(1e-10, "radii", "rounding: it is solved at one size")),
    _case("scale 1e5", "A ball of one hundred kilometres.", partial(_elsewhere, 1e5, np.zeros(3)),
          Bound(1e-10, "radii", "rounding: it is solved at one size")),
    _case("UTM offset", "A ball 5400 km from the origin.", partial(_elsewhere, 1.0, _UTM),
          Bound(2e-8, "radii", "places at 5400 km are rounded to 1e-9 m; ten times")),
    _case("float32 samples", "Samples in single precision.", _single_precision, _BALL),
    _case("one place", "All samples lie in one place.", _one_place, refusal="one place"),
    _case("no reach", "Samples stand for no area: 0 / 0 in what fades out.", _no_reach,
          Bound(0.03, "radii", "the finest cell, and no vertex counts as measured"),
          method="moving onto samples"),
    _case("no confidence", "All samples of a cell have no weight.", _no_confidence,
          refusal="confidence above 0", method="merging samples"),
    _case("two sides", "The sides of a sheet a hundredth of a cell apart.", _two_sides,
          Bound(1e-12, "m", "rounding: no sample of one side may be merged with the other"),
          method="merging samples"),
    _case("cells of 1e-6 m at UTM", "Numbers of cells as large as 5e12.", _far_cells,
          Bound(2e-9, "m", "spacing of float64 at 5400 km"), method="merging samples"),
)  # fmt: skip
