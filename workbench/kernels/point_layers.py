"""Extended cell identification: cubes of points as layers of neighbours round a first point.

Mallón, Bóo, Amor and Bruguera 2003, "Algorithms and hardware for data compression in point
rendering applications", sections 2.2, 3.2 and 4.2. A layer is all neighbours (26) of the layer
before that no earlier layer has. Its points are grouped by the point they were reached from,
their seed, and the first of a group are seeds of the next layer; the one that reaches most
comes first. A point is

* its offset from its seed, x, y, z: −1 is ``0``, 0 is ``10``, +1 is ``11``;
* of a seed, ψ, the points that it reaches, in 5 bits, and how many of them are seeds, in
  ⌈log₂ ψ⌉ bits, one at least.

What the paper leaves open: a cube has any number of such pieces, each behind a bit 1, a bit 0
after the last, and the first point of a piece has its place in the cube, x, y, z, level bits
each, instead of an offset. ⌈log₂ ψ⌉ bits cannot tell that all of 2, 4, 8 or 16 points are
seeds: the last of them then is not, and another point reaches what it would have reached, or a
piece of its own begins there.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.bit_stream import bits_at, only_padding, put_bits
from workbench.kernels.point_cubes import CUT_OFF, LEFT_OVER, SOUND, WRONG_COUNT, WRONG_PLACE

_NEIGHBOURS = 26
_REACHED_BITS = 5
_SEED_BITS = np.array([0, 1] + [int(n - 1).bit_length() for n in range(2, 32)], np.int64)
# Of the offsets −1, 0, +1: code and length.
_CODES, _LENGTHS = (0, 2, 3), (1, 2, 2)


@njit(cache=True, nogil=True)
def _near(wide: int, k: int) -> int:
    """Offset of neighbour k, 0…26, in a grid of ``wide`` cells a side; 13 is the cell itself."""
    return ((k // 9 - 1) * wide + k // 3 % 3 - 1) * wide + k % 3 - 1


@njit(cache=True, nogil=True)
def _reachable(waiting: NDArray[np.bool_], at: int, near: NDArray[np.int64]) -> int:
    """Neighbours of a cell that no layer has yet."""
    found = 0
    for k in range(27):
        found += waiting[at + near[k]]
    return found


@njit(cache=True, nogil=True)
def _reach(
    waiting: NDArray[np.bool_],
    seed: int,
    near: NDArray[np.int64],
    queue: NDArray[np.int64],
    labels: NDArray[np.int64],
    end: int,
) -> int:
    """Append the neighbours of a seed that no layer has yet; where the queue ends now."""
    for k in range(27):
        at = seed + near[k]
        if waiting[at]:
            waiting[at] = False
            queue[end], labels[end] = at, k
            end += 1
    return end


@njit(cache=True, nogil=True)
def _best(
    waiting: NDArray[np.bool_],
    near: NDArray[np.int64],
    queue: NDArray[np.int64],
    totals: NDArray[np.int64],
    begin: int,
    end: int,
    base: int,
) -> tuple[int, int]:
    """The point of a group that reaches most now, or else did at first; and how many."""
    best, most = begin, -1
    for i in range(begin, end):
        now = _reachable(waiting, queue[i], near) << 5 | totals[i - base]
        if now > most:
            best, most = i, now
    return best, most >> 5


@njit(cache=True, nogil=True)
def _put_forward(
    queue: NDArray[np.int64],
    labels: NDArray[np.int64],
    totals: NDArray[np.int64],
    source: int,
    target: int,
    base: int,
) -> None:
    """Move one point of a group before others; these keep their order."""
    cell, label, total = queue[source], labels[source], totals[source - base]
    for i in range(source, target, -1):
        queue[i], labels[i] = queue[i - 1], labels[i - 1]
        totals[i - base] = totals[i - 1 - base]
    queue[target], labels[target], totals[target - base] = cell, label, total


@njit(cache=True, nogil=True)
def _walk_piece(
    waiting: NDArray[np.bool_],
    near: NDArray[np.int64],
    queue: NDArray[np.int64],
    labels: NDArray[np.int64],
    reached: NDArray[np.int64],
    seeds: NDArray[np.int64],
    first: int,
) -> int:
    """Layer after layer from the point ``queue[first]``; where the queue ends."""
    totals = np.empty(_NEIGHBOURS, np.int64)
    begins = np.empty(len(queue), np.int64)
    begins[first] = first + 1
    end = int(_reach(waiting, queue[first], near, queue, labels, first + 1))
    reached[first] = end - first - 1
    at = first
    while at < end:
        begin, size = begins[at], reached[at]
        seeds[at] = 0
        at += 1
        if size == 0:
            continue
        group = begin + size
        for i in range(begin, group):
            totals[i - begin] = _reachable(waiting, queue[i], near)
            reached[i] = 0
        allowed = (1 << _SEED_BITS[size]) - 1
        for target in range(begin, group):
            best, most = _best(waiting, near, queue, totals, target, group, begin)
            _put_forward(queue, labels, totals, best, target, begin)
            if most and target - begin < allowed:
                begins[target] = end
                end = _reach(waiting, queue[target], near, queue, labels, end)
                reached[target] = end - begins[target]
                seeds[at - 1] += 1
    return end


@njit(cache=True, nogil=True)
def encode_layers(
    points: NDArray[np.int32],
    starts: NDArray[np.int64],
    level: int,
    data: NDArray[np.uint8],
    ends: NDArray[np.int64],
    order: NDArray[np.int64],
) -> None:
    """Write cubes one after another, each from a whole byte on.

    Parameters
    ----------
    points, starts, level, ends
        As in `workbench.kernels.point_cubes.encode_cells`, level 1…5; pieces begin at the
        first point left of those of a cube.
    data
        Zeros; at least `room_for_layers` of them.
    order
        (n,) filled with the rows of ``points`` in the order they are written.
    """
    side, wide = 1 << level, (1 << level) + 2
    near = np.array([_near(wide, k) for k in range(27)])
    waiting = np.zeros(wide**3, np.bool_)
    rows = np.empty(wide**3, np.int64)
    most = 0
    for cube in range(len(starts) - 1):
        most = max(most, starts[cube + 1] - starts[cube])
    queue, labels = np.empty(most, np.int64), np.empty(most, np.int64)
    reached, seeds = np.empty(most, np.int64), np.empty(most, np.int64)
    place = 0
    for cube in range(len(starts) - 1):
        begin, stop = starts[cube], starts[cube + 1]
        for i in range(begin, stop):
            at = ((points[i, 0] + 1) * wide + points[i, 1] + 1) * wide + points[i, 2] + 1
            waiting[at] = True
            rows[at] = i
        end = 0
        for i in range(begin, stop):
            at = ((points[i, 0] + 1) * wide + points[i, 1] + 1) * wide + points[i, 2] + 1
            if not waiting[at]:
                continue
            waiting[at] = False
            first, queue[end] = end, at
            end = _walk_piece(waiting, near, queue, labels, reached, seeds, first)
            place = put_bits(data, place, 1, 1)
            corner = (points[i, 0] * side + points[i, 1]) * side + points[i, 2]
            place = put_bits(data, place, corner, 3 * level)
            for k in range(first, end):
                order[begin + k] = rows[queue[k]]
                if k > first:
                    for digit in (labels[k] // 9, labels[k] // 3 % 3, labels[k] % 3):
                        place = put_bits(data, place, _CODES[digit], _LENGTHS[digit])
                if k == first or reached[k]:
                    place = put_bits(data, place, reached[k], _REACHED_BITS)
                    place = put_bits(data, place, seeds[k], _SEED_BITS[reached[k]])
        place = place + 8 >> 3 << 3
        ends[cube] = place >> 3


def room_for_layers(points: int, cubes: int, level: int) -> int:
    """Bytes that `encode_layers` needs at most."""
    return (points * max(6 + 10, 1 + 3 * level + _REACHED_BITS) + 8 * cubes) // 8 + 1


@njit(cache=True, nogil=True)
def decode_layers(
    data: NDArray[np.uint8],
    bytes_at: NDArray[np.int64],
    starts: NDArray[np.int64],
    level: int,
    points: NDArray[np.int32],
    status: NDArray[np.int64],
) -> None:
    """Read what `encode_layers` wrote, in the order it was written.

    The parameters are those of `workbench.kernels.point_cubes.decode_cells`.
    """
    wide = (1 << level) + 2
    taken = np.ones(wide**3, np.bool_)
    # A seed: its row among the points, and what it says of the next layer.
    most = 1
    for cube in range(len(starts) - 1):
        most = max(most, starts[cube + 1] - starts[cube])
    seeds = np.empty((most, 3), np.int64)
    for cube in range(len(starts) - 1):
        for x in range(1, wide - 1):
            for y in range(1, wide - 1):
                taken[(x * wide + y) * wide + 1 : (x * wide + y + 1) * wide - 1] = False
        place, end = 8 * bytes_at[cube], 8 * bytes_at[cube + 1]
        row, row_end = starts[cube], starts[cube + 1]
        found = SOUND
        while found == SOUND:
            if end - place < 1:
                found = CUT_OFF
                break
            place += 1
            if bits_at(data, place - 1, 1) == 0:
                break
            if row == row_end:
                found = WRONG_COUNT
                break
            row, place, found = _read_piece(
                data, place, end, row, row_end, level, points, taken, seeds
            )
        if found == SOUND and row != row_end:
            found = WRONG_COUNT
        if found == SOUND and not only_padding(data, place, end):
            found = LEFT_OVER
        status[cube] = found


@njit(cache=True, nogil=True)
def _read_seed(data: NDArray[np.uint8], place: int, end: int) -> tuple[int, int, int, int]:
    """Points reached, seeds among them, the place after, and what is wrong."""
    if end - place < _REACHED_BITS:
        return 0, 0, place, CUT_OFF
    reached = bits_at(data, place, _REACHED_BITS)
    place += _REACHED_BITS
    width = _SEED_BITS[reached]
    if end - place < width:
        return 0, 0, place, CUT_OFF
    seeds = bits_at(data, place, width)
    wrong = reached > _NEIGHBOURS or seeds > reached
    return reached, seeds, place + width, WRONG_PLACE if wrong else SOUND


@njit(cache=True, nogil=True)
def _read_piece(
    data: NDArray[np.uint8],
    place: int,
    end: int,
    row: int,
    row_end: int,
    level: int,
    points: NDArray[np.int32],
    taken: NDArray[np.bool_],
    seeds: NDArray[np.int64],
) -> tuple[int, int, int]:
    """One piece from its first point on; the row and the place after it, and what is wrong."""
    wide, mask = (1 << level) + 2, (1 << level) - 1
    if end - place < 3 * level:
        return row, place, CUT_OFF
    corner = bits_at(data, place, 3 * level)
    place += 3 * level
    x, y, z = corner >> 2 * level, corner >> level & mask, corner & mask
    at = ((x + 1) * wide + y + 1) * wide + z + 1
    if taken[at]:
        return row, place, WRONG_PLACE
    taken[at] = True
    points[row, 0], points[row, 1], points[row, 2] = x, y, z
    reached, among, place, found = _read_seed(data, place, end)
    if found != SOUND:
        return row, place, found
    seeds[0, 0], seeds[0, 1], seeds[0, 2] = row, reached, among
    row += 1
    next_seed, seed_count = 0, 1
    while next_seed < seed_count:
        seed, reached, among = seeds[next_seed]
        next_seed += 1
        for k in range(reached):
            x, y, z = (
                np.int64(points[seed, 0]),
                np.int64(points[seed, 1]),
                np.int64(points[seed, 2]),
            )
            # The longest offset takes six bits; zeros follow the end of the data.
            bits = bits_at(data, place, 6)
            for axis in range(3):
                if bits & 32 == 0:
                    step, width = -1, 1
                else:
                    step, width = bits >> 4 & 1, 2
                bits, place = bits << width & 63, place + width
                if axis == 0:
                    x += step
                elif axis == 1:
                    y += step
                else:
                    z += step
            if place > end:
                return row, place, CUT_OFF
            if row == row_end:
                return row, place, WRONG_COUNT
            at = ((x + 1) * wide + y + 1) * wide + z + 1
            if taken[at]:
                return row, place, WRONG_PLACE
            taken[at] = True
            points[row, 0], points[row, 1], points[row, 2] = x, y, z
            if k < among:
                more, among_more, place, found = _read_seed(data, place, end)
                if found != SOUND:
                    return row, place, found
                if more == 0:
                    return row, place, WRONG_PLACE
                seeds[seed_count, 0], seeds[seed_count, 1] = row, more
                seeds[seed_count, 2] = among_more
                seed_count += 1
            row += 1
    return row, place, SOUND
