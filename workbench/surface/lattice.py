"""The zero set of a field given by a function, on a body-centred lattice, part by part.

The field is asked only where its surface runs: from seeds on, wave after wave visits the
neighbours across every face that the surface crosses. Triangles name the lattice edges that
their corners lie on, so that parts made apart fit together without a seam.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.bcc_blocks import triangles_of_blocks
from workbench.kernels.bcc_isosurface import EDGE_DIRECTIONS

BRICK_CELLS = 4
_BRICKS_AT_ONCE = 4096
_NEIGHBOURS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])

Field = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Lattice:
    """A body-centred cubic lattice over a box, cut into bricks of 4³ cells.

    Attributes
    ----------
    low : (3,) its lower corner, metres.
    spacing_m : edge of its cells; triangle edges are about 0.6 of it long.
    bricks : (3,) how many bricks along each axis.
    """

    low: NDArray[np.float64]
    spacing_m: float
    bricks: NDArray[np.int64]

    @classmethod
    def over(cls, low: NDArray[np.float64], high: NDArray[np.float64], spacing_m: float) -> Lattice:
        """The smallest that covers a box with a brick to spare on every side."""
        edge = BRICK_CELLS * spacing_m
        bricks = np.ceil((high - low) / edge).astype(np.int64) + 2
        middle = 0.5 * (low + high)
        return cls(middle - 0.5 * edge * bricks, spacing_m, bricks)

    @property
    def stride(self) -> int:
        """Larger than any coordinate of a node."""
        return int(self.bricks.max()) * 2 * BRICK_CELLS + 4

    @property
    def brick_m(self) -> float:
        """Edge of a brick."""
        return BRICK_CELLS * self.spacing_m

    def numbers_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Number (n,) of the brick that holds each point (n, 3); the nearest for those outside."""
        place = np.floor((points - self.low) / self.brick_m).astype(np.int64)
        return self.numbered(np.clip(place, 0, self.bricks - 1))

    def numbered(self, bricks: NDArray[np.int64]) -> NDArray[np.int64]:
        """One number (b,) for each brick (b, 3)."""
        return np.asarray(
            (bricks[:, 0] * self.bricks[1] + bricks[:, 1]) * self.bricks[2] + bricks[:, 2]
        )

    def unnumbered(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Bricks (b, 3) from their numbers."""
        rest, k = np.divmod(numbers, self.bricks[2])
        i, j = np.divmod(rest, self.bricks[1])
        return np.asarray(np.stack([i, j, k], axis=1), np.int64)

    def bricks_of_edges(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """The brick (n, 3) that holds the lower node of each named edge (n,)."""
        nodes = _nodes(keys // len(EDGE_DIRECTIONS), self.stride)
        return np.asarray(np.minimum(nodes // (2 * BRICK_CELLS), self.bricks - 1))

    def positions(self, nodes: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Places (n, 3) in metres of nodes, or of places between them, (n, 3)."""
        return self.low + nodes * (0.5 * self.spacing_m)

    def __post_init__(self) -> None:
        if float(self.stride) ** 3 * len(EDGE_DIRECTIONS) > 2.0**63:
            raise ValueError(f"{self.bricks} bricks cannot be named in 64 bits")


@dataclass(frozen=True)
class Part:
    """Triangles of some bricks.

    Attributes
    ----------
    keys : (t, 3) int64 names of the lattice edges that the corners lie on.
    fractions : (t, 3) where on them.
    brick : (t,) number of the brick each triangle lies in.
    visited : (b,) numbers of the bricks that were looked at, sorted.
    beyond : (c,) numbers of bricks outside the region that the surface runs on into, sorted.
    """

    keys: NDArray[np.int64]
    fractions: NDArray[np.float64]
    brick: NDArray[np.int64]
    visited: NDArray[np.int64]
    beyond: NDArray[np.int64]


def surface_part(
    field: Field,
    lattice: Lattice,
    seeds: NDArray[np.int64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
) -> Part:
    """The zero set of ``field`` in a box of bricks, as far as it hangs together with seeds.

    Parameters
    ----------
    field : values (n,) at places (n, 3), negative inside; must depend on the place alone.
    seeds : (s,) numbers of bricks where a surface may be; those outside the box are passed over.
    first, last : (3,) the box: bricks ``first`` up to and without ``last``.
    """
    first = np.maximum(first, 0)
    last = np.minimum(last, lattice.bricks)

    def inside(bricks: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray(((bricks >= first) & (bricks < last)).all(axis=1))

    wave = np.unique(seeds[inside(lattice.unnumbered(seeds))])
    visited = np.zeros(0, np.int64)
    parts: list[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]] = []
    beyond: list[NDArray[np.int64]] = []
    while len(wave):
        visited = np.union1d(visited, wave)
        reached = []
        for at in range(0, len(wave), _BRICKS_AT_ONCE):
            numbers = wave[at : at + _BRICKS_AT_ONCE]
            bricks = lattice.unnumbered(numbers)
            even, odd = _values(field, lattice, bricks)
            keys, fractions, owner, crossed = triangles_of_blocks(
                bricks * (2 * BRICK_CELLS), even, odd, lattice.stride
            )
            parts.append((keys, fractions, numbers[owner]))
            brick, face = np.nonzero(crossed)
            reached.append(bricks[brick] + _NEIGHBOURS[face])
        found = np.concatenate(reached)
        found = found[((found >= 0) & (found < lattice.bricks)).all(axis=1)]
        among = inside(found)
        beyond.append(lattice.numbered(found[~among]))
        wave = np.setdiff1d(lattice.numbered(found[among]), visited)
    if not parts:
        none = np.zeros(0, np.int64)
        return Part(none.reshape(0, 3), np.zeros((0, 3)), none, none, none)
    keys, fractions, brick = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Part(keys, fractions, brick, visited, np.unique(np.concatenate(beyond)))


def _values(
    field: Field, lattice: Lattice, bricks: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values at the even and the odd nodes of bricks, (b, 5, 5, 5) each; no node asked twice."""
    steps = np.stack(np.meshgrid(*[np.arange(BRICK_CELLS + 1)] * 3, indexing="ij"), axis=-1)
    nodes = (bricks * (2 * BRICK_CELLS))[:, None] + 2 * steps.reshape(-1, 3)
    nodes = np.stack([nodes, nodes + 1]).reshape(-1, 3)
    stride = lattice.stride
    names, place = np.unique(
        (nodes[:, 0] * stride + nodes[:, 1]) * stride + nodes[:, 2], return_inverse=True
    )
    values = field(lattice.positions(_nodes(names, stride)))[place.ravel()]
    side = BRICK_CELLS + 1
    even, odd = values.reshape(2, len(bricks), side, side, side)
    return even, odd


def _nodes(names: NDArray[np.int64], stride: int) -> NDArray[np.int64]:
    """Nodes (n, 3) from their names (n,)."""
    rest, k = np.divmod(names, stride)
    i, j = np.divmod(rest, stride)
    return np.stack([i, j, k], axis=1)
