"""Fifth pass: steps of colour at the borders of labels are spread over the surface around.

Source: Arikan et al., section 6.2, after Jeschke et al. 2009: a texture of changes is added,
whose values are given at borders of labels and at steps of depth, and which is as smooth as can
be between: it solves the Laplace equation. Multigrid solves it to a thousandth in half of the
eight iterations that the paper's table 3 has.

The paper lets border pixels spread what makes them equal to their neighbours. Neighbours differ
by the surface's own colours, too: where it grows brighter across a border, both sides would be
levelled for nothing. So border pixels get that value themselves, but spread how much the two
photographs differ in one and the same place, averaged along the border, because photographs lie
a little beside each other. Colours of vertices are stand-ins: they are levelled to the
photographs around them, and never the other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.kernels.levelling_multigrid import (
    BORDER,
    EMPTY,
    FREE,
    STEP,
    Grid,
    along_borders,
    coarser_grid,
    corrected,
    dots,
    finest_grid,
    levelling_constraints,
    relaxed,
    residual,
    summed,
)

_COARSEST_PX = 4


@dataclass(frozen=True)
class LevellingSettings:
    """How exactly the equation is solved.

    Attributes
    ----------
    iterations : at most (Arikan et al., table 3: 8).
    tolerance : it ends where the residual is this share of what it began with for a change of 0.
    radius_px : what a border spreads is averaged along it over so many pixels to either side.
    """

    iterations: int = 8
    tolerance: float = 1e-3
    radius_px: int = 8

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.radius_px < 0 or not self.tolerance >= 0.0:
            raise InputError("settings of levelling out of bounds", found=str(self))


@dataclass(frozen=True)
class Levelling:
    """A levelling texture.

    Attributes
    ----------
    change : (h, w, 3) float32 to add to sRGB-encoded colours; 0 where nothing is.
    kind : (h, w) uint8 ``FREE``, ``BORDER``, ``STEP`` or ``EMPTY`` of the kernels.
    iterations : done.
    residual : of the equation, as share of that of no change at all.
    """

    change: NDArray[np.float32]
    kind: NDArray[np.uint8]
    iterations: int
    residual: float

    def applied(self, color: NDArray[np.float32]) -> NDArray[np.float32]:
        """Levelled colours (h, w, 3), in [0, 1]."""
        return np.asarray(np.clip(color + self.change, np.float32(0.0), np.float32(1.0)))


def levelling(
    color: NDArray[np.float32],
    label: NDArray[np.int32],
    depth: NDArray[np.float32],
    epsilon: float,
    settings: LevellingSettings | None = None,
    seam: NDArray[np.float32] | None = None,
) -> Levelling:
    """The levelling texture of one picture.

    Parameters
    ----------
    color : (h, w, 3) sRGB-encoded in [0, 1].
    label : (h, w) the photograph each colour comes from.
    depth : (h, w) infinite where nothing is.
    epsilon : neighbours whose depths differ by more do not hang together, metres.
    seam : (h, w, 3) how the photographs differ at borders, as in `Textured`; without, neighbours
        tell it.

    Raises
    ------
    InputError : a colour is not finite where something is.
    """
    settings = settings or LevellingSettings()
    full = np.zeros(color.shape, np.float32)
    seen = np.isfinite(depth)
    if not np.isfinite(color[seen]).all():
        # One would spread over all that hangs together with it.
        raise InputError(
            "a picture with colours that are not finite cannot be levelled",
            found=f"{int((~np.isfinite(color[seen])).any(axis=1).sum())} pixels",
            fix="look for broken photographs",
        )
    kinds, given = levelling_constraints(color, label, depth, epsilon)
    if not seen.any():
        return Levelling(full, kinds, 0, 0.0)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    kind, change = np.ascontiguousarray(kinds[box]), np.ascontiguousarray(given[box])
    known = change
    if seam is not None:
        known = np.where((label[box] == NO_PHOTO)[..., None], change, seam[box])
    spread = along_borders(kind, label[box], change, known, settings.radius_px)
    right, down, diagonal, b = finest_grid(kind, spread)
    given = (kind == BORDER) | (kind == STEP)
    reached = _reached(kind, given)
    # An island without any given pixel has nothing to level: its equation has no one answer.
    right, down, diagonal = (
        np.where(reached, part, np.float32(0.0)) for part in (right, down, diagonal)
    )
    guess = _first_guess(given, reached, spread)
    solver = _Multigrid((right, down, diagonal))
    solution, done, left = solver.solved(guess, b, settings)
    full[box] = np.where((kind == FREE)[..., None], solution, change)
    return Levelling(full, kinds, done, left)


def _reached(kind: NDArray[np.uint8], given: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(h, w) the free pixels that hang together with a given one."""
    _, island = cv2.connectedComponents((kind != EMPTY).astype(np.uint8), connectivity=4)
    held = np.bincount(island[given], minlength=int(island.max()) + 1) > 0
    return np.asarray((kind == FREE) & held[island])


def _first_guess(
    given: NDArray[np.bool_], reached: NDArray[np.bool_], change: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Of every free pixel that is reached the change of the closest given one, elsewhere 0."""
    guess = np.zeros_like(change)
    if not given.any():
        return guess
    _, closest = cv2.distanceTransformWithLabels(
        np.where(given, 0, 255).astype(np.uint8),
        cv2.DIST_L2,
        cv2.DIST_MASK_5,
        labelType=cv2.DIST_LABEL_PIXEL,
    )
    table = np.zeros((int(closest.max()) + 1, change.shape[2]), np.float32)
    table[closest[given]] = change[given]
    guess[reached] = table[closest[reached]]
    return guess


class _Multigrid:
    """Conjugate gradients with one V-cycle of 2 × 2 sums as preconditioner.

    The cycle alone converges, too, by about one half each time where given pixels lie anyhow;
    conjugate gradients make a digit of two cycles, and cannot diverge.
    """

    def __init__(self, finest: Grid) -> None:
        self._grids = [finest]
        while min(self._grids[-1][2].shape) > _COARSEST_PX:
            self._grids.append(coarser_grid(*self._grids[-1]))
        shapes = [grid[2].shape for grid in self._grids]
        self._x = [np.zeros((*shape, 3), np.float32) for shape in shapes]
        self._b = [np.zeros((*shape, 3), np.float32) for shape in shapes]
        self._r = [np.zeros((*shape, 3), np.float32) for shape in shapes]

    def solved(
        self, x: NDArray[np.float32], b: NDArray[np.float32], settings: LevellingSettings
    ) -> tuple[NDArray[np.float32], int, float]:
        """Unknowns, iterations done and the relative residual."""
        grid = self._grids[0]
        whole = np.maximum(np.sqrt(dots(b, b)), 1e-12)
        missing = np.zeros_like(x)
        residual(x, b, *grid, missing)
        way, product = np.zeros_like(x), np.zeros_like(x)
        none = np.zeros_like(x)
        before = np.ones(3)
        done, left = 0, float((np.sqrt(dots(missing, missing)) / whole).max())
        while done < settings.iterations and left > settings.tolerance:
            better = self._cycle(missing)
            now = dots(missing, better)
            ratio = np.where(before > 0.0, now / np.where(before > 0.0, before, 1.0), 0.0)
            way = better + way * (ratio if done else np.zeros(3)).astype(np.float32)
            residual(way, none, *grid, product)  # −A · way
            bend = -dots(way, product)
            length = np.where(bend > 0.0, now / np.where(bend > 0.0, bend, 1.0), 0.0)
            x = x + way * length.astype(np.float32)
            missing += product * length.astype(np.float32)
            before = now
            done += 1
            left = float((np.sqrt(dots(missing, missing)) / whole).max())
        return x, done, left

    def _cycle(self, b: NDArray[np.float32], level: int = 0) -> NDArray[np.float32]:
        grid, x = self._grids[level], self._x[level]
        x[:] = 0.0
        relaxed(x, b, *grid, 0)
        relaxed(x, b, *grid, 1)
        if level + 1 == len(self._grids):
            for _ in range(_COARSEST_PX):
                relaxed(x, b, *grid, 0)
                relaxed(x, b, *grid, 1)
            for _ in range(_COARSEST_PX):
                relaxed(x, b, *grid, 1)
                relaxed(x, b, *grid, 0)
        else:
            residual(x, b, *grid, self._r[level])
            summed(self._r[level], self._b[level + 1])
            corrected(x, self._cycle(self._b[level + 1], level + 1), grid[2])
        # In reverse, so that the cycle is symmetric.
        relaxed(x, b, *grid, 1)
        relaxed(x, b, *grid, 0)
        return x
