"""Graphs whose diffusion is easy, hard or known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from workbench.color.diffusion_graph import SampleGraph, edges_of_cloud, sample_graph
from workbench.color.inpainting import Inpainting


def grid(n: int, along: float = 1.0, across: float = 1.0, diagonal: float = 0.0) -> SampleGraph:
    """A square of n × n samples, row by row; conductances by direction."""
    number = np.arange(n * n, dtype=np.int32).reshape(n, n)
    parts = [
        (number[:, :-1], number[:, 1:], along),
        (number[:-1], number[1:], across),
        (number[:-1, :-1], number[1:, 1:], diagonal),
    ]
    edges = [np.stack([a.ravel(), b.ravel()], axis=1) for a, b, g in parts if g]
    values = [np.full(a.size, g) for a, _, g in parts if g]
    return SampleGraph(n * n, np.concatenate(edges), np.concatenate(values))


def rim(n: int) -> NDArray[np.bool_]:
    """(n²,) the border of the square."""
    border = np.ones((n, n), bool)
    border[1:-1, 1:-1] = False
    return border.ravel()


def _random_contrast(n: int) -> SampleGraph:
    plain = grid(n)
    decades = np.random.default_rng(0).uniform(-8.0, 0.0, len(plain.edges))
    return SampleGraph(plain.count, plain.edges, 10.0**decades)


def _inclusions(n: int) -> SampleGraph:
    """A checkerboard of 8 × 8 fields, every other of which conducts 10⁻⁸."""
    plain = grid(n)
    row, column = np.divmod(np.arange(n * n), n)
    poor = (row // 8 + column // 8) % 2 == 1
    held = poor[plain.edges].any(axis=1)
    return SampleGraph(plain.count, plain.edges, np.where(held, 1e-8, 1.0))


def _creases(n: int) -> SampleGraph:
    """Ten by ten fields with walls of 10⁻⁸ between."""
    plain = grid(n)
    row, column = np.divmod(np.arange(n * n), n)
    size = max(n // 10, 2)
    field = (row // size) * n + column // size
    across = field[plain.edges[:, 0]] != field[plain.edges[:, 1]]
    return SampleGraph(plain.count, plain.edges, np.where(across, 1e-8, 1.0))


def _cloud(n: int) -> SampleGraph:
    """Random samples on a folded sheet, 8 nearest neighbours, normals that turn at the fold.

    The samples of the border come where those of `rim` are.
    """
    rng = np.random.default_rng(1)
    row, column = np.divmod(np.arange(n * n), n)
    flat = np.stack([row, column], axis=1) + rng.uniform(-0.4, 0.4, (n * n, 2))
    tilt = np.where(flat[:, 0] > n / 2, np.radians(60.0), 0.0)
    rise = np.maximum(flat[:, 0] - n / 2, 0.0) * np.tan(tilt)
    points = np.column_stack([flat, rise])
    normals = np.column_stack([-np.sin(tilt), np.zeros(n * n), np.cos(tilt)])
    return sample_graph(edges_of_cloud(points), points, normals)


# Conductances as stiff as holes can have, and stiffer.
CASES: dict[str, Callable[[int], SampleGraph]] = {
    "even": grid,
    "triangles": lambda n: grid(n, diagonal=1.0),
    "1e-8 along": lambda n: grid(n, along=1e-8),
    "1e-8 across": lambda n: grid(n, across=1e-8),
    "1e-2 along": lambda n: grid(n, along=1e-2),
    "1e-2 across": lambda n: grid(n, across=1e-2),
    "1e3 oblique": lambda n: grid(n, diagonal=1e3),
    "random 1e-8 to 1": _random_contrast,
    "inclusions 1e-8": _inclusions,
    "creases 1e-8": _creases,
    "cloud with a fold": _cloud,
}


def noise_on_rim(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colours (n², 3), random at the border and NaN within, and weights."""
    border = rim(n)
    colors = np.random.default_rng(2).uniform(0.0, 1.0, (n * n, 3))
    colors[~border] = np.nan
    return colors, border.astype(float)


def equations(
    graph: SampleGraph, colors: NDArray[np.float64], open_: NDArray[np.bool_]
) -> tuple[csr_array, NDArray[np.float64]]:
    """Matrix over the open samples and right-hand sides, the plain way."""
    i, j = graph.edges.T
    g = graph.conductances
    n = graph.count
    joins = csr_array((np.r_[g, g], (np.r_[i, j], np.r_[j, i])), shape=(n, n))
    degree = np.asarray(joins.sum(axis=1)).ravel()
    index = np.arange(n)
    laplacian = (csr_array((degree, (index, index)), shape=(n, n)) - joins).tocsr()
    within = laplacian[open_]
    return within[:, open_].tocsr(), -(within[:, ~open_] @ colors[~open_])


def overshoot(found: Inpainting, colors: NDArray[np.float64]) -> float:
    """By how much an inpainted colour leaves the range of those given."""
    given, made = colors[found.flags == 0], found.colors[found.flags == 1]
    return float(
        np.maximum(made.max(axis=0) - given.max(axis=0), given.min(axis=0) - made.min(axis=0)).max()
    )
