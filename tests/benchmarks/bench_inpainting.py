"""Error of inpainted colours against run time, by cycles and by method.

    python -m tests.benchmarks.bench_inpainting OUT [SIDE ...] [--mesh PLY]

fills squares of SIDE × SIDE samples (102, 318 and 1002 by default) from noise at their borders,
with the conductances of `tests.color.diffusion_cases`, and, where a mesh is given, half of it.
Each is solved by the workbench's cycle as preconditioner, as plain iteration, and with its coarse
graphs visited once (a V-cycle); by PyAMG's hierarchies (``pip install "pyamg>=5.2,<6"``) with and
without conjugate gradients; and, up to 10⁵ unknowns, by conjugate gradients with the diagonal and
directly: in turn within one run, three channels each, to the same residual, on one thread. Prints
tables and writes ``inpainting_CASE.svg`` and, where an SVG renderer is at hand, ``.png`` to OUT.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy.sparse import csr_array, csr_matrix, diags_array
from scipy.sparse.linalg import cg, splu
from threadpoolctl import threadpool_limits

from tests.benchmarks.drawing import draw_tradeoff
from tests.color.diffusion_cases import CASES, equations, noise_on_rim
from workbench.color.diffusion_graph import SampleGraph, edges_of_mesh, sample_graph
from workbench.color.diffusion_hierarchy import Graph, Hierarchy
from workbench.color.inpainting import InpaintingSettings, inpainted
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import vertex_normals
from workbench.verification.figures import TradeoffPoint

SIDES = (102, 318, 1002)
DRAWN_SIDE = 318
CYCLES = (1, 2, 3, 5, 7, 10, 15, 20)
TOLERANCE, MOST = 1e-8, 200
DIRECT = 110_000
CHOSEN = "workbench, to 1e-8"
SETTINGS = InpaintingSettings(trusted=0.0)


@dataclass(frozen=True)
class Problem:
    """A hole as the workbench and as others take it."""

    graph: SampleGraph
    colors: NDArray[np.float64]
    weights: NDArray[np.float64]
    matrix: csr_array
    right: NDArray[np.float64]
    exact: NDArray[np.float64]


def problem(
    graph: SampleGraph, colors: NDArray[np.float64], weights: NDArray[np.float64]
) -> Problem:
    """With the converged answer."""
    open_ = weights == 0.0
    best = inpainted(colors, weights, graph, InpaintingSettings(1e-13, 100, 0.0))
    matrix, right = equations(graph, colors, open_)
    reached = best.flags[open_] == 1
    return Problem(
        graph, colors, weights, matrix[reached][:, reached].tocsr(), right[reached],
        best.colors[best.flags == 1],
    )  # fmt: skip


class _VCycle(Hierarchy):
    """Coarse graphs are visited once, and their corrections taken as they are."""

    def _coarse(self, depth: int, right: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._cycle(depth, right)


def by_workbench(p: Problem, settings: InpaintingSettings) -> tuple[NDArray[np.float64], int]:
    """All of `inpainted`: checks, numbering, hierarchy, estimates."""
    found = inpainted(p.colors, p.weights, p.graph, settings)
    return found.colors[found.flags == 1], found.cycles


def by_iteration(p: Problem, kind: type[Hierarchy]) -> tuple[NDArray[np.float64], int]:
    """The cycle alone, without conjugate gradients around it."""
    off = -p.matrix
    off.setdiag(0.0)
    off.eliminate_zeros()
    off.sort_indices()
    excess = np.maximum(np.asarray(p.matrix.sum(axis=1)).ravel(), 0.0)
    graph = Graph(off.indptr.astype(np.int64), off.indices.astype(np.int32), off.data, excess)
    hierarchy = kind(graph)
    right = np.column_stack([p.right, np.zeros(len(p.right))])
    values, rest, count = np.zeros_like(right), right.copy(), 0
    norm = np.linalg.norm(right[:, :3], axis=0)
    while count < MOST and (np.linalg.norm(rest[:, :3], axis=0) > TOLERANCE * norm).any():
        step = hierarchy.cycle(rest)
        values += step
        rest -= graph.applied(step)
        count += 1
    return values[:, :3], count


def by_pyamg(p: Problem, build: Callable, accel: str | None) -> tuple[NDArray[np.float64], int]:
    """One of PyAMG's hierarchies, as it comes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        levels = build(csr_matrix(p.matrix))
        found, most = [], 0
        for channel in p.right.T:
            residuals: list[float] = []
            found.append(
                levels.solve(channel, tol=TOLERANCE, maxiter=MOST, accel=accel, residuals=residuals)
            )
            most = max(most, len(residuals) - 1)
    return np.stack(found, axis=1), most


def by_gradients(p: Problem) -> tuple[NDArray[np.float64], int]:
    """Conjugate gradients with the diagonal."""
    steps = []
    inverse = diags_array(1.0 / p.matrix.diagonal())
    found = []
    for channel in p.right.T:
        values, _ = cg(
            p.matrix, channel, rtol=TOLERANCE, maxiter=3000, M=inverse, callback=steps.append
        )
        found.append(values)
    return np.stack(found, axis=1), len(steps) // 3


def directly(p: Problem) -> tuple[NDArray[np.float64], int]:
    """SuperLU."""
    return splu(p.matrix.tocsc()).solve(p.right), 1


def methods(p: Problem) -> Iterator[tuple[str, Callable[[], tuple[NDArray[np.float64], int]]]]:
    """Name and how it is solved."""
    yield CHOSEN, lambda: by_workbench(p, SETTINGS)
    yield "workbench, no gradients", lambda: by_iteration(p, Hierarchy)
    yield "workbench, V, no gradients", lambda: by_iteration(p, _VCycle)
    for name, build in (
        ("smoothed aggregation", pyamg.smoothed_aggregation_solver),
        ("Ruge-Stüben", pyamg.ruge_stuben_solver),
        ("root-node", pyamg.rootnode_solver),
    ):
        yield f"PyAMG {name} + CG", lambda build=build: by_pyamg(p, build, "cg")
        yield f"PyAMG {name}", lambda build=build: by_pyamg(p, build, None)
    if len(p.right) <= DIRECT:
        yield "CG with diagonal", lambda: by_gradients(p)
        yield "direct (SuperLU)", lambda: directly(p)


def measure(name: str, p: Problem) -> list[TradeoffPoint]:
    """One table; its rows as points."""
    print(f"\n{name}: {len(p.right)} unknowns", flush=True)
    print(
        "method                            seconds  cycles  factor   residual   error", flush=True
    )
    points = []
    for label, solve in methods(p):
        start = perf_counter()
        try:
            values, count = solve()
        except TypeError:
            print(f"{label:32s}  cannot read this SciPy's matrices", flush=True)
            continue
        seconds = perf_counter() - start
        rest = np.linalg.norm(p.right - p.matrix @ values, axis=0)
        residual = float((rest / np.linalg.norm(p.right, axis=0)).max())
        error = float(np.abs(values - p.exact).max())
        factor = residual ** (1.0 / max(count, 1))
        print(
            f"{label:32s}{seconds:9.2f}{count:8d}{factor:8.3f}{residual:11.1e}{error:9.1e}",
            flush=True,
        )
        points.append(TradeoffPoint(label, seconds, max(error, 1e-16)))
    return points


def by_cycles(p: Problem) -> list[TradeoffPoint]:
    """Ever more cycles of the workbench's."""
    print("cycles  seconds  residual   error    estimate", flush=True)
    points = []
    for cycles in CYCLES:
        settings = InpaintingSettings(TOLERANCE, cycles, 0.0)
        start = perf_counter()
        found = inpainted(p.colors, p.weights, p.graph, settings)
        seconds = perf_counter() - start
        error = float(np.abs(found.colors[found.flags == 1] - p.exact).max())
        residual = found.residuals[-1].max()
        print(
            f"{found.cycles:6d}{seconds:9.2f}{residual:10.1e}{error:9.1e}{found.error:9.1e}",
            flush=True,
        )
        if found.cycles == cycles:
            points.append(TradeoffPoint(f"workbench, {cycles} cycles", seconds, error))
    return points


def half_of(path: Path) -> Problem:
    """A mesh whose lower half, by its longest axis, is to be filled from a coloured upper one."""
    mesh = read_surface(path)
    points = mesh.vertices
    axis = int(np.argmax(np.ptp(points, axis=0)))
    low, high = points.min(axis=0), points.max(axis=0)
    hole = points[:, axis] < 0.5 * (low + high)[axis]
    colors = (points - low) / (high - low).max()
    edges = edges_of_mesh(mesh.triangles, len(points), hole)
    graph = sample_graph(edges, points, vertex_normals(mesh))
    return problem(graph, colors, (~hole).astype(float))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("sides", type=int, nargs="*", default=SIDES)
    parser.add_argument("--mesh", type=Path)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    asked = parser.parse_args()
    # Loads what is compiled.
    inpainted(*_problem_of("even", 40))
    with threadpool_limits(1):
        for side in asked.sides:
            for case in asked.cases:
                p = problem(*_as_problem(case, side))
                points = measure(case, p)
                if side == DRAWN_SIDE:
                    name = f"inpainting_{case.replace(' ', '_')}"
                    points += by_cycles(p)
                    draw_tradeoff(asked.out, name, points, "largest error of a colour", CHOSEN)
        if asked.mesh:
            measure(asked.mesh.stem, half_of(asked.mesh))


def _as_problem(case: str, side: int):
    return CASES[case](side), *noise_on_rim(side)


def _problem_of(case: str, side: int):
    graph, colors, weights = _as_problem(case, side)
    return colors, weights, graph


if __name__ == "__main__":
    main()
