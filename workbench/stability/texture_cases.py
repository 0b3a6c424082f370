"""Choosing photographs and levelling their seams where costs tie, vanish or are without bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import inverse, looking_at
from workbench.render.stitch.levelling import LevellingSettings, levelling
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.texturing.expansion import expanded
from workbench.texturing.labelling import LabellingProblem
from workbench.texturing.patches import patches_of
from workbench.texturing.seam_levelling import levelled
from workbench.texturing.seams import colors_along, seams_of

_CUT, _SEAMS, _VIEW = "choice of photographs", "levelling of seams", "levelling of a view"
_SHARES = np.linspace(0.0, 1.0, 5)


def chain_problem(
    candidates: Sequence[Sequence[int]],
    costs: Sequence[Sequence[float]],
    lengths: float | Sequence[float] = 1.0,
    seed: int = 0,
    plain: bool = False,
) -> LabellingProblem:
    """Triangles in a row, edges of random colours, or all of one colour where ``plain``."""
    rng = np.random.default_rng(seed)
    m = len(candidates)
    labels = [sorted({*candidates[t], *candidates[t + 1]}) for t in range(m - 1)]
    rows = sum(len(at) for at in labels)
    colors = np.full((rows, 2, 3), 0.5) if plain else rng.random((rows, 2, 3))
    return LabellingProblem(
        np.concatenate([[0], np.cumsum([len(c) for c in candidates])]).astype(np.int64),
        np.array([label for c in candidates for label in c], np.int32),
        np.array([cost for c in costs for cost in c], float),
        np.stack([np.arange(m - 1), np.arange(1, m)], axis=1).astype(np.int32),
        np.broadcast_to(np.asarray(lengths, float), m - 1).copy(),
        np.concatenate([[0], np.cumsum([len(at) for at in labels])]).astype(np.int64),
        np.array([label for at in labels for label in at], np.int32),
        np.round(65535 * colors).astype(np.uint16),
        1.0,
    )


def _least(problem: LabellingProblem) -> float:
    """The least energy of all labellings, one after another."""
    choices = [
        problem.labels[a:b].tolist() or [NO_PHOTO]
        for a, b in zip(problem.starts[:-1], problem.starts[1:], strict=True)
    ]
    return min(problem.energy(np.array(labels, np.int32)).total for labels in product(*choices))


def _gap(problem: LabellingProblem) -> Measured:
    """How far above the least energy the labelling is, and whether its bound is one."""
    found, least = expanded(problem, max_cycles=20, bound_sweeps=20), _least(problem)
    if found.lower_bound > least + 1e-9 * max(least, 1e-300):
        return Measured.nothing(f"bound {found.lower_bound} above the least energy {least}")
    # A ratio, for energies of these cases go from 1e-12 to 1e12.
    over = (found.energy.total - least) / least if least > 0 else found.energy.total
    return Measured(over, f"told gap {found.gap:.1e} after {len(found.cycles)} cycles")


# No photograph shows all of them, so that seams cannot be left out altogether.
_OVERLAPPING: list[tuple[int, ...]] = [(0, 1), (0, 1, 2), (1, 2), (0, 2), (0, 1, 2), (1, 2), (0, 1)]


def _equal_costs() -> Measured:
    return _gap(chain_problem(_OVERLAPPING, [(0.5,) * len(c) for c in _OVERLAPPING]))


def _equal_everything() -> Measured:
    """Costs and colours all alike: any labelling is best, and the same one each time."""
    problem = chain_problem([(0, 1, 2)] * 7, [(0.0,) * 3] * 7, plain=True)
    one, other = expanded(problem), expanded(problem)
    return Measured(float((one.labels != other.labels).sum()) + one.energy.total)


def _zero_areas() -> Measured:
    """Every other triangle without area, whose data cost is 0, and edges without length."""
    costs = [
        (0.0,) * len(c) if t % 2 else tuple(_random((len(c),), t))
        for t, c in enumerate(_OVERLAPPING)
    ]
    return _gap(chain_problem(_OVERLAPPING, costs, [0.0, 1.0, 0.0, 1.0, 1.0, 1.0]))


def _random(shape: tuple[int, ...], seed: int = 4) -> NDArray[np.float64]:
    return np.random.default_rng(seed).random(shape)


def _wide_costs() -> Measured:
    """Costs over 24 decades."""
    costs = 10.0 ** (24 * _random((7, 3)) - 12)
    return _gap(chain_problem([(0, 1, 2)] * 7, costs.tolist()))


def _infinite_costs() -> Measured:
    costs = _random((7, 3))
    costs[3, 1] = np.inf
    return _gap(chain_problem([(0, 1, 2)] * 7, costs.tolist()))


def _exclusive() -> Measured:
    """Neighbours that share no photograph, and some that have none at all."""
    candidates: list[tuple[int, ...]] = [(0,), (1, 2), (0, 3), (), (1,), (0, 2), (1, 3)]
    costs = [tuple(_random((len(c),), t)) for t, c in enumerate(candidates)]
    return _gap(chain_problem(candidates, costs))


_CAMERA = PhotoCamera(
    "SIMPLE_PINHOLE", 120, 120, (200.0, 60.0, 60.0),
    inverse(looking_at((0.0, -4.0, 0.0), (0.0, 0.0, 0.0))),
)  # fmt: skip


def _sheets(parts: int, steps: int = 6) -> TriangleMesh:
    """Flat squares side by side with gaps between, and a vertex grid each."""
    u, v = (w.ravel() for w in np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps)))
    a = (np.arange(steps - 1)[:, None] * steps + np.arange(steps - 1)).ravel()
    one = np.concatenate(
        [np.stack([a, a + 1, a + steps + 1], 1), np.stack([a, a + steps + 1, a + steps], 1)]
    )
    width = 2.0 / parts
    points = [
        np.stack([-1 + width * (k + 0.8 * u), np.zeros_like(u), 2 * v - 1], axis=1)
        for k in range(parts)
    ]
    return TriangleMesh(
        np.concatenate(points),
        np.concatenate([one + k * steps**2 for k in range(parts)]).astype(np.int32),
        {"color": np.full((parts * steps**2, 3), 128, np.uint8)},
    )


def _levelled(
    labels: NDArray[np.int32], mesh: TriangleMesh, grays: Sequence[int]
) -> tuple[NDArray[np.float64], float]:
    """Offsets (m, 3, 3) in the mesh's order, and the residual that is told."""
    m = len(mesh.triangles)
    labelled = LabelledMesh(mesh, labels, np.ones(m, bool), np.zeros(m, np.float32))
    patches = patches_of(labelled, dict.fromkeys(range(len(grays)), _CAMERA))
    seams = seams_of(labelled, patches)
    pictures = [np.full((120, 120, 4), (gray, gray, gray, 255), np.uint8) for gray in grays]
    colors = colors_along(seams, labelled, patches, pictures.__getitem__, _SHARES)
    found = levelled(labelled, patches, seams, colors, _SHARES, anchor=1e-5)
    by_triangle = np.empty((m, 3, 3))
    by_triangle[patches.triangles] = found.offsets
    return by_triangle, found.residual


def _parts_without_seams() -> Measured:
    """Four parts that hang together with nothing; only the first has a seam."""
    mesh = _sheets(4)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    labels = np.where(middle[:, 0] < -0.5, (middle[:, 2] > 0).astype(int), 1).astype(np.int32)
    found, residual = _levelled(labels, mesh, (100, 120))
    alone = middle[:, 0] > -0.5
    step = np.abs(found[~alone & (labels == 0)].mean() - found[~alone & (labels == 1)].mean() - 20)
    return Measured(float(max(np.abs(found[alone]).max(), step)), f"residual {residual:.1e}")


def _no_area() -> Measured:
    """A mesh of which a third of the triangles are lines."""
    mesh = _sheets(1)
    flat = mesh.vertices.copy()
    flat[mesh.vertices[:, 2] > 0.3, 2] = 1.0
    mesh = TriangleMesh(flat, mesh.triangles, mesh.vertex_attributes)
    labels = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 0] > -0.3).astype(np.int32)
    found, residual = _levelled(labels, mesh, (100, 120))
    step = found[labels == 0].mean() - found[labels == 1].mean() - 20
    return Measured(float(abs(step)), f"residual {residual:.1e}")


def _view(
    columns: int, islands: bool
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]:
    """A picture of two photographs about a tenth apart, with parts that touch none if wanted."""
    label = np.zeros((40, columns), np.int32)
    label[:, columns // 4 :] = 1
    row = np.linspace(0.0, 3.0, 40)[:, None, None]
    color = np.where(label[..., None] == 0, 0.4, 0.5 + 0.05 * np.sin(row))
    color = color.astype(np.float32).repeat(3, axis=2)
    depth = np.ones((40, columns), np.float32)
    if islands:
        depth[:, columns // 2 : columns // 2 + 2] = np.inf
        depth[20:22] = np.inf
    return color, label, depth


def _view_islands() -> Measured:
    """What touches no border of photographs must stay as it is."""
    color, label, depth = _view(80, islands=True)
    found = levelling(color, label, depth, 0.1, LevellingSettings(40, 1e-6))
    alone = float(np.abs(found.change[:, 42:]).max())
    border = np.s_[:20, 19:21, 0]
    left = np.abs(np.diff(found.applied(color)[border], axis=1) / np.diff(color[border], axis=1))
    if left.max() > 1e-3:
        return Measured.nothing(f"{left.max():.2g} of the steps at the border are left")
    told = f"residual {found.residual:.1e} after {found.iterations} iterations"
    return Measured(max(alone, found.residual), told)


def _view_of_nothing() -> Measured:
    color, label, _ = _view(80, islands=False)
    found = levelling(color, label, np.full(label.shape, np.inf, np.float32), 0.1)
    return Measured(float(np.abs(found.change).max()))


def _view_one_photograph() -> Measured:
    color, label, depth = _view(80, islands=False)
    found = levelling(color, np.zeros_like(label), depth, 0.1)
    return Measured(float(np.abs(found.change).max()), f"residual {found.residual:.1e}")


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
) -> Case:
    return Case(f"texture/{name}", method, stiff, run, bound, refusal)


_BEST = Bound(1e-9, "relative", "all labellings tried one by one, and rounding")
_DRAWS = Bound(0.1, "relative", "what expansion leaves for eight draws of colours; its gap is told")
_LEVEL = Bound(0.05, "of 255", "known answer: half a step each; the faint anchor's part of it")

TEXTURE_CASES = (
    _case("equal costs", _CUT, "All data costs are the same.", _equal_costs, _DRAWS),
    _case("equal everything", _CUT, "Costs are zero and all photographs look alike.",
          _equal_everything, Bound(0.0, "", "the same labelling each time, at no cost")),
    _case("zero areas", _CUT, "Triangles without area and edges without length.", _zero_areas,
          _BEST),
    _case("costs 1e-12 to 1e12", _CUT, "Costs over 24 decades.", _wide_costs, _BEST),
    _case("infinite costs", _CUT, "A photograph that costs infinitely much.", _infinite_costs,
          refusal="finite"),
    _case("exclusive photographs", _CUT, "Neighbours have no photograph in common, or none.",
          _exclusive, _BEST),
    _case("parts without seams", _SEAMS, "Three of four parts have nothing to be levelled to.",
          _parts_without_seams, _LEVEL),
    _case("triangles without area", _SEAMS, "A third of the triangles are lines.", _no_area,
          _LEVEL),
    _case("islands", _VIEW, "Parts of the picture that touch no border.", _view_islands,
          Bound(1e-6, "of 1", "the tolerance asked for; islands change by nothing")),
    _case("nothing", _VIEW, "A picture in which nothing is.", _view_of_nothing,
          Bound(0.0, "of 1", "nothing changes")),
    _case("one photograph", _VIEW, "No border anywhere.", _view_one_photograph,
          Bound(0.0, "of 1", "nothing changes")),
)  # fmt: skip
