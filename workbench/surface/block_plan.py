"""How a surface too large for one solution is cut into blocks that overlap.

Each block is solved on its own, with samples from beyond its faces, on octree cells of one size
for all. Across a face the solutions of both sides are blended over a ramp, so that the surface
has no seam; beyond the ramp lies a margin that is solved and not used, for a solution is at
fault where its samples end.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.surface.lattice import Lattice

# Lattice cells per octree cell; at 0.5 rods as thin as a cell are lost.
CELLS_PER_OCTREE_CELL = 0.7
# In bricks of 4 lattice cells, which are some 6 octree cells wide.
RAMP_BRICKS, MARGIN_BRICKS = 1, 2
_LEAST_BLOCK_BRICKS = 4


@dataclass(frozen=True)
class BlockPlan:
    """Blocks of bricks of one lattice.

    Attributes
    ----------
    lattice : that the surface is extracted on.
    cell_m : edge of the octree cells of all solutions.
    block_bricks : bricks along the edge of a block.
    blocks : (b, 3) the blocks that hold samples or the coarse surface, in order.
    """

    lattice: Lattice
    cell_m: float
    block_bricks: int
    blocks: NDArray[np.int64]

    def name(self, block: NDArray[np.int64]) -> str:
        """Name of a block, fit for a file."""
        return "block_{}_{}_{}".format(*block)

    def bricks(self, block: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and beyond-last brick (3,) of a block."""
        return block * self.block_bricks, (block + 1) * self.block_bricks

    def core(self, block: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The block's own corners (3,), metres."""
        first, last = self.bricks(block)
        brick = self.lattice.brick_m
        return self.lattice.low + first * brick, self.lattice.low + last * brick

    def used(self, block: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (3,) of where the block's solution is used, metres."""
        return _grown(self.core(block), RAMP_BRICKS * self.lattice.brick_m)

    def solved(self, block: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (3,) of where samples take part in the block's solution, metres."""
        return _grown(self.core(block), (RAMP_BRICKS + MARGIN_BRICKS) * self.lattice.brick_m)

    def weight(self, block: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Say (n,) of a block's solution at points (n, 3), in [0, 1], smooth, 0 beyond its ramp."""
        low, high = self.core(block)
        ramp = RAMP_BRICKS * self.lattice.brick_m
        within = np.minimum(points - low, high - points)
        share = np.clip(0.5 + 0.5 * within / ramp, 0.0, 1.0)
        return np.asarray((share * share * (3.0 - 2.0 * share)).prod(axis=1))

    def neighbours(self, block: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Planned blocks that touch a block, itself among them, in order."""
        planned = {tuple(b) for b in self.blocks.tolist()}
        around = (tuple(int(v) for v in block + step) for step in product((-1, 0, 1), repeat=3))
        return [np.array(b, np.int64) for b in around if b in planned]

    def by_block(
        self, bricks: NDArray[np.int64]
    ) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Blocks (3,), planned or not, and the numbers (b,) among ``bricks`` that lie in each."""
        blocks = self.lattice.unnumbered(bricks) // self.block_bricks
        found, place = np.unique(blocks, axis=0, return_inverse=True)
        return [(block, bricks[place.ravel() == k]) for k, block in enumerate(found)]

    def as_dict(self) -> dict[str, Any]:
        """Plain data, exact."""
        return {
            "low": self.lattice.low.tolist(),
            "spacing_m": self.lattice.spacing_m,
            "bricks": self.lattice.bricks.tolist(),
            "cell_m": self.cell_m,
            "block_bricks": self.block_bricks,
            "blocks": self.blocks.tolist(),
        }

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> BlockPlan:
        """The plan that `as_dict` told."""
        lattice = Lattice(
            np.array(plain["low"]), plain["spacing_m"], np.array(plain["bricks"], np.int64)
        )
        blocks = np.array(plain["blocks"], np.int64).reshape(-1, 3)
        return cls(lattice, plain["cell_m"], plain["block_bricks"], blocks)


def lattice_for(low: NDArray[np.float64], high: NDArray[np.float64], cell_m: float) -> Lattice:
    """The lattice of a box (3,), (3,) whose surface is solved on octree cells of ``cell_m``."""
    return Lattice.over(low, high, cell_m / CELLS_PER_OCTREE_CELL)


def bricks_held(
    lattice: Lattice, places: Iterable[NDArray[np.float64]], vertices: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bricks (b, 3) that hold samples or vertices, and how many samples (b,) each.

    Parameters
    ----------
    places : all samples (n, 3), some at a time.
    vertices : (v, 3) of the coarse surface.
    """
    samples: dict[int, int] = dict.fromkeys(lattice.numbers_of(vertices).tolist(), 0)
    for points in places:
        numbers, count = np.unique(lattice.numbers_of(points), return_counts=True)
        for number, more in zip(numbers.tolist(), count.tolist(), strict=True):
            samples[number] = samples.get(number, 0) + more
    numbers = np.array(sorted(samples), np.int64)
    return lattice.unnumbered(numbers), np.array([samples[n] for n in numbers.tolist()], np.int64)


def plan_blocks(
    lattice: Lattice,
    cell_m: float,
    bricks: NDArray[np.int64],
    samples: NDArray[np.int64],
    most_samples: int,
) -> BlockPlan:
    """The largest blocks, all alike, none of which has to solve too many samples.

    Parameters
    ----------
    lattice, cell_m : of the surface and of the solutions.
    bricks : (b, 3) bricks that hold samples or the coarse surface.
    samples : (b,) how many samples each holds.
    most_samples : wanted at most in one solution. A block is never smaller than four bricks,
        so very dense samples can exceed it.
    """
    edge = int(lattice.bricks.max())
    while edge > _LEAST_BLOCK_BRICKS and _most_solved(bricks, samples, edge) > most_samples:
        edge = max(_LEAST_BLOCK_BRICKS, int(0.8 * edge))
    blocks = np.unique(bricks // edge, axis=0)
    return BlockPlan(lattice, cell_m, edge, blocks)


def _most_solved(bricks: NDArray[np.int64], samples: NDArray[np.int64], edge: int) -> int:
    """Samples in the fullest block with its ramp and margin."""
    reach = RAMP_BRICKS + MARGIN_BRICKS
    solved: dict[tuple[int, ...], int] = {}
    for steps in product((-reach, 0, reach), repeat=3):
        # A brick belongs to the blocks that hold it moved by up to the reach.
        blocks = (bricks + np.array(steps)) // edge
        own = bricks // edge
        moved = (blocks != own) == (np.array(steps) != 0)
        keep = moved.all(axis=1)
        unique, place = np.unique(blocks[keep], axis=0, return_inverse=True)
        count = np.bincount(place.ravel(), samples[keep], len(unique))
        for block, number in zip(unique.tolist(), count.tolist(), strict=True):
            solved[tuple(block)] = solved.get(tuple(block), 0) + int(number)
    return max(solved.values(), default=0)


def _grown(
    box: tuple[NDArray[np.float64], NDArray[np.float64]], by_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return box[0] - by_m, box[1] + by_m
