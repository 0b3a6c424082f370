"""The Laplace equation over some pixels of a picture, others being given: parts of a multigrid.

A grid holds unknowns x (h, w, 3), the weights of the links to the neighbours at the ``right``
and ``down`` (h, w), 0 where there is no link, and the ``diagonal`` (h, w): the sum of a pixel's
links, those to given pixels too; 0 where there is no unknown. The equation at a pixel is
``diagonal · x − Σ link · x of the neighbour = b``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FREE, BORDER, STEP, EMPTY = 0, 1, 2, 3
_CHANNELS = 3
_NO_PHOTO = -1

Grid = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


@njit(cache=True, nogil=True)
def levelling_constraints(
    color: NDArray[np.float32],
    label: NDArray[np.int32],
    depth: NDArray[np.float32],
    epsilon: float,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Which pixels are given, and the change of colour that is given to them.

    A direct neighbour of another label on the same surface makes a pixel a ``BORDER``: it is to
    have the mean of its own colour and of all such neighbours. One that differs in depth by more
    than ε makes it a ``STEP``, which is to keep its colour, unless it is a border. Colours of no
    photograph give way to those of one: they take the mean of the neighbours alone, for whom
    they are a step.

    Parameters
    ----------
    color : (h, w, 3).
    label : (h, w), −1 for no photograph.
    depth : (h, w), infinite where nothing is: such pixels are ``EMPTY`` and nobody's neighbours.
    epsilon : in the unit of depth.

    Returns
    -------
    (h, w) kinds and (h, w, 3) change, 0 where it is not given.
    """
    height, width = label.shape
    kind = np.full((height, width), EMPTY, np.uint8)
    change = np.zeros((height, width, _CHANNELS), np.float32)
    total = np.empty(_CHANNELS)
    for row in range(height):
        for column in range(width):
            z = depth[row, column]
            if not np.isfinite(z):
                continue
            kind[row, column] = FREE
            total[:] = 0.0
            others = 0
            for side in range(4):
                r = row + (side == 2) - (side == 3)
                c = column + (side == 0) - (side == 1)
                if r < 0 or c < 0 or r == height or c == width or not np.isfinite(depth[r, c]):
                    continue
                if label[r, c] == label[row, column] and abs(depth[r, c] - z) <= epsilon:
                    continue
                if label[r, c] == _NO_PHOTO or abs(depth[r, c] - z) > epsilon:
                    kind[row, column] = STEP
                else:
                    others += 1
                    for k in range(_CHANNELS):
                        total[k] += color[r, c, k] - color[row, column, k]
            if others:
                kind[row, column] = BORDER
                own = label[row, column] != _NO_PHOTO
                for k in range(_CHANNELS):
                    change[row, column, k] = total[k] / (others + own)
    return kind, change


@njit(cache=True, nogil=True)
def along_borders(
    kind: NDArray[np.uint8],
    label: NDArray[np.int32],
    change: NDArray[np.float32],
    seam: NDArray[np.float32],
    radius: int,
) -> NDArray[np.float32]:
    """Changes (h, w, 3) that borders spread: seams, averaged over those of the same label around.

    Parameters
    ----------
    kind, change : of `levelling_constraints`. A border around which no seam is known spreads 0.
    label : (h, w).
    seam : (h, w, 3) change that a border is to spread, NaN where unknown.
    radius : half the side of the square that is around, pixels.
    """
    height, width = kind.shape
    out = change.copy()
    total = np.empty(_CHANNELS)
    for row in range(height):
        for column in range(width):
            if kind[row, column] != BORDER:
                continue
            total[:] = 0.0
            count = 0
            for r in range(max(row - radius, 0), min(row + radius, height - 1) + 1):
                for c in range(max(column - radius, 0), min(column + radius, width - 1) + 1):
                    if kind[r, c] != BORDER or label[r, c] != label[row, column]:
                        continue
                    if np.isnan(seam[r, c, 0]):
                        continue
                    count += 1
                    for k in range(_CHANNELS):
                        total[k] += seam[r, c, k]
            for k in range(_CHANNELS):
                out[row, column, k] = total[k] / max(count, 1)
    return out


@njit(cache=True, nogil=True)
def finest_grid(
    kind: NDArray[np.uint8], change: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Links at the right and down, diagonal and right-hand side of the free pixels."""
    height, width = kind.shape
    right = np.zeros((height, width), np.float32)
    down = np.zeros((height, width), np.float32)
    diagonal = np.zeros((height, width), np.float32)
    b = np.zeros((height, width, _CHANNELS), np.float32)
    for row in range(height):
        for column in range(width):
            if kind[row, column] != FREE:
                continue
            for side in range(4):
                r = row + (side == 2) - (side == 3)
                c = column + (side == 0) - (side == 1)
                if r < 0 or c < 0 or r == height or c == width or kind[r, c] == EMPTY:
                    continue
                diagonal[row, column] += 1.0
                if kind[r, c] == FREE:
                    if side == 0:
                        right[row, column] = 1.0
                    elif side == 2:
                        down[row, column] = 1.0
                else:
                    for k in range(_CHANNELS):
                        b[row, column, k] += change[r, c, k]
    return right, down, diagonal, b


@njit(cache=True, nogil=True)
def coarser_grid(
    right: NDArray[np.float32], down: NDArray[np.float32], diagonal: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """The grid of 2 × 2 pixels' sums.

    A correction that is constant over two pixels steps at every second link only, by twice as
    much, and pays double for a slope: links between the sums count half.
    """
    height, width = diagonal.shape
    shape = ((height + 1) // 2, (width + 1) // 2)
    coarse_right = np.zeros(shape, np.float32)
    coarse_down = np.zeros(shape, np.float32)
    coarse = np.zeros(shape, np.float32)
    for row in range(height):
        for column in range(width):
            if diagonal[row, column] == 0.0:
                continue
            r, c = row // 2, column // 2
            # What remains of the diagonal when links inside a sum and half of those between
            # sums are taken out of it.
            coarse[r, c] += diagonal[row, column]
            link = right[row, column]
            if column % 2 == 1:
                if link > 0.0:
                    coarse_right[r, c] += 0.5 * link
                    coarse[r, c] -= 0.5 * link
                    coarse[r, c + 1] -= 0.5 * link
            else:
                coarse[r, c] -= 2.0 * link
            link = down[row, column]
            if row % 2 == 1:
                if link > 0.0:
                    coarse_down[r, c] += 0.5 * link
                    coarse[r, c] -= 0.5 * link
                    coarse[r + 1, c] -= 0.5 * link
            else:
                coarse[r, c] -= 2.0 * link
    return coarse_right, coarse_down, coarse


@njit(cache=True, nogil=True)
def relaxed(
    x: NDArray[np.float32],
    b: NDArray[np.float32],
    right: NDArray[np.float32],
    down: NDArray[np.float32],
    diagonal: NDArray[np.float32],
    parity: int,
) -> None:
    """Solve the equations of every second pixel, as on one colour of a chessboard, in place."""
    height, width = diagonal.shape
    for row in range(height):
        for column in range((row + parity) % 2, width, 2):
            own = diagonal[row, column]
            if own <= 0.0:
                continue
            e = right[row, column]
            w = right[row, column - 1] if column > 0 else np.float32(0.0)
            s = down[row, column]
            n = down[row - 1, column] if row > 0 else np.float32(0.0)
            # A link of weight 0 may lead out of the grid; its end is then any pixel.
            ce, cw = min(column + 1, width - 1), max(column - 1, 0)
            rs, rn = min(row + 1, height - 1), max(row - 1, 0)
            for k in range(_CHANNELS):
                x[row, column, k] = (
                    b[row, column, k]
                    + e * x[row, ce, k]
                    + w * x[row, cw, k]
                    + s * x[rs, column, k]
                    + n * x[rn, column, k]
                ) / own


@njit(cache=True, nogil=True)
def residual(
    x: NDArray[np.float32],
    b: NDArray[np.float32],
    right: NDArray[np.float32],
    down: NDArray[np.float32],
    diagonal: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """What is missing of the equations, b − A x, into `out`."""
    height, width = diagonal.shape
    for row in range(height):
        for column in range(width):
            own = diagonal[row, column]
            if own <= 0.0:
                continue
            e = right[row, column]
            w = right[row, column - 1] if column > 0 else np.float32(0.0)
            s = down[row, column]
            n = down[row - 1, column] if row > 0 else np.float32(0.0)
            ce, cw = min(column + 1, width - 1), max(column - 1, 0)
            rs, rn = min(row + 1, height - 1), max(row - 1, 0)
            for k in range(_CHANNELS):
                out[row, column, k] = (
                    b[row, column, k]
                    + e * x[row, ce, k]
                    + w * x[row, cw, k]
                    + s * x[rs, column, k]
                    + n * x[rn, column, k]
                    - own * x[row, column, k]
                )


@njit(cache=True, nogil=True)
def summed(fine: NDArray[np.float32], coarse: NDArray[np.float32]) -> None:
    """Sums of 2 × 2 pixels into `coarse`."""
    coarse[:] = 0.0
    for row in range(fine.shape[0]):
        for column in range(fine.shape[1]):
            for k in range(_CHANNELS):
                coarse[row // 2, column // 2, k] += fine[row, column, k]


@njit(cache=True, nogil=True)
def corrected(
    fine: NDArray[np.float32], coarse: NDArray[np.float32], diagonal: NDArray[np.float32]
) -> None:
    """Add to every unknown the correction of its sum, in place."""
    for row in range(fine.shape[0]):
        for column in range(fine.shape[1]):
            if diagonal[row, column] > 0.0:
                for k in range(_CHANNELS):
                    fine[row, column, k] += coarse[row // 2, column // 2, k]


@njit(cache=True, nogil=True)
def dots(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float64]:
    """Scalar product of each channel, (3,)."""
    total = np.zeros(_CHANNELS)
    for row in range(one.shape[0]):
        for column in range(one.shape[1]):
            for k in range(_CHANNELS):
                total[k] += float(one[row, column, k]) * other[row, column, k]
    return total
