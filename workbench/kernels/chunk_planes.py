"""Point attributes as byte planes that compress well, and back, bit for bit.

Coordinates become integers on the finest binary grid that holds all of a chunk, are put in
Morton order and kept as gaps between Morton codes plus low bits: n sorted codes cost
log2(n) − 1.4 bits a point less than n codes in any order. Unit vectors keep two components
and what the third differs from √(1 − a² − b²).
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

#: Grid exponent of an axis that no common grid holds: its ordered float bits are kept.
NO_GRID = -100_000
_SIGN = np.uint64(1 << 63)
_FRACTION = np.uint64((1 << 52) - 1)
_HIDDEN = np.uint64(1 << 52)
_AXIS_BITS = 21


@nb.njit(cache=True, nogil=True, inline="always")
def _ordered(bits: np.uint64) -> np.uint64:
    """Float bits to an integer of the same order."""
    return ~bits if bits & _SIGN else bits | _SIGN


@nb.njit(cache=True, nogil=True, inline="always")
def _unordered(key: np.uint64) -> np.uint64:
    return key ^ _SIGN if key & _SIGN else ~key


@nb.njit(cache=True, nogil=True, inline="always")
def _bit_length(value: np.uint64) -> int:
    n = 0
    while value:
        value >>= np.uint64(1)
        n += 1
    return n


@nb.njit(cache=True, nogil=True, inline="always")
def _spread(value: np.uint64) -> np.uint64:
    """Put the low 21 bits three apart."""
    v = value & np.uint64(0x1FFFFF)
    v = (v | (v << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    v = (v | (v << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    v = (v | (v << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    v = (v | (v << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (v | (v << np.uint64(2))) & np.uint64(0x1249249249249249)


@nb.njit(cache=True, nogil=True, inline="always")
def _gather(code: np.uint64) -> np.uint64:
    """Undo ``_spread``."""
    v = code & np.uint64(0x1249249249249249)
    v = (v | (v >> np.uint64(2))) & np.uint64(0x10C30C30C30C30C3)
    v = (v | (v >> np.uint64(4))) & np.uint64(0x100F00F00F00F00F)
    v = (v | (v >> np.uint64(8))) & np.uint64(0x1F0000FF0000FF)
    v = (v | (v >> np.uint64(16))) & np.uint64(0x1F00000000FFFF)
    return (v | (v >> np.uint64(32))) & np.uint64(0x1FFFFF)


@nb.njit(cache=True, nogil=True)
def grid_exponents(points: NDArray[np.float64], bits: NDArray[np.uint64]) -> NDArray[np.int64]:
    """(3,) int64 e per axis: every coordinate is a whole multiple of 2^e, below 2^61 of them.

    ``NO_GRID`` where there is no such e, or where a coordinate is −0.0 or subnormal.

    Parameters
    ----------
    points, bits : (n, 3) the coordinates and the same memory as uint64.
    """
    exponents = np.empty(3, np.int64)
    for axis in range(3):
        lowest, highest, usable = 100_000, -100_000, True
        for i in range(len(points)):
            b = bits[i, axis]
            if b == 0:
                continue
            raw = np.int64((b >> np.uint64(52)) & np.uint64(0x7FF))
            if raw == 0:
                usable = False
                break
            highest = max(highest, int(raw - 1022))
            mantissa = (b & _FRACTION) | _HIDDEN
            e = raw - 1075
            if e >= lowest:
                continue
            while not mantissa & np.uint64(1):
                mantissa >>= np.uint64(1)
                e += 1
            lowest = min(lowest, int(e))
        if not usable or (highest > -100_000 and highest - lowest > 61):
            exponents[axis] = NO_GRID
        elif highest == -100_000:
            exponents[axis] = 0
        else:
            exponents[axis] = lowest
    return exponents


@nb.njit(cache=True, nogil=True)
def local_integers(
    points: NDArray[np.float64], bits: NDArray[np.uint64], exponents: NDArray[np.int64]
) -> tuple[NDArray[np.uint64], NDArray[np.uint64], NDArray[np.int64]]:
    """Coordinates as unsigned integers from the chunk's own corner.

    Returns
    -------
    local : (n, 3) uint64, ≥ 0.
    base : (3,) uint64, added to ``local`` (modulo 2^64) gives the grid number or float key.
    shifts : (3,) int64, how many low bits of each axis lie below the Morton cell. Cells are
        cubes where the axes have grids.
    """
    n = len(points)
    local = np.empty((n, 3), np.uint64)
    base = np.zeros(3, np.uint64)
    shifts = np.zeros(3, np.int64)
    top = -200_000
    length = np.zeros(3, np.int64)
    for axis in range(3):
        e = exponents[axis]
        if e == NO_GRID:
            low = ~np.uint64(0)
            for i in range(n):
                local[i, axis] = _ordered(bits[i, axis])
                low = min(low, local[i, axis])
        else:
            # Two factors: 2^-e alone overflows for coordinates below 2^-1023 + 61.
            first = 2.0 ** (-(e // 2))
            second = 2.0 ** (-(e - e // 2))
            least = np.int64(0x7FFFFFFFFFFFFFFF)
            for i in range(n):
                k = np.int64(points[i, axis] * first * second)
                least = min(least, k)
                local[i, axis] = np.uint64(k)
            low = np.uint64(least)
        base[axis] = low
        high = np.uint64(0)
        for i in range(n):
            local[i, axis] -= low
            high = max(high, local[i, axis])
        length[axis] = _bit_length(high)
        if e != NO_GRID and high:
            top = max(top, e + length[axis])
    for axis in range(3):
        if exponents[axis] == NO_GRID:
            shifts[axis] = max(0, length[axis] - _AXIS_BITS)
        elif length[axis]:
            shifts[axis] = min(max(0, top - _AXIS_BITS - exponents[axis]), length[axis])
    return local, base, shifts


@nb.njit(cache=True, nogil=True)
def morton_codes(local: NDArray[np.uint64], shifts: NDArray[np.int64]) -> NDArray[np.uint64]:
    """(n,) uint64 Morton codes of the high bits, x lowest."""
    codes = np.empty(len(local), np.uint64)
    sx, sy, sz = np.uint64(shifts[0]), np.uint64(shifts[1]), np.uint64(shifts[2])
    for i in range(len(local)):
        codes[i] = (
            _spread(local[i, 0] >> sx)
            | (_spread(local[i, 1] >> sy) << np.uint64(1))
            | (_spread(local[i, 2] >> sz) << np.uint64(2))
        )
    return codes


@nb.njit(cache=True, nogil=True)
def sorted_order(codes: NDArray[np.uint64]) -> tuple[NDArray[np.int32], NDArray[np.uint64]]:
    """Stable order of unsigned integers and the integers in that order (radix sort)."""
    n = len(codes)
    order, other = np.arange(n).astype(np.int32), np.empty(n, np.int32)
    keys, spare = codes.copy(), np.empty(n, np.uint64)
    varying = np.uint64(0)
    for i in range(1, n):
        varying |= codes[i] ^ codes[0]
    for digit in range(6):
        shift = np.uint64(11 * digit)
        if not (varying >> shift) & np.uint64(2047):
            continue
        counts = np.zeros(2049, np.int64)
        for i in range(n):
            counts[((keys[i] >> shift) & np.uint64(2047)) + np.uint64(1)] += 1
        for k in range(2048):
            counts[k + 1] += counts[k]
        for i in range(n):
            d = (keys[i] >> shift) & np.uint64(2047)
            to = counts[d]
            counts[d] = to + 1
            spare[to] = keys[i]
            other[to] = order[i]
        keys, spare = spare, keys
        order, other = other, order
    return order, keys


@nb.njit(cache=True, nogil=True)
def position_planes(
    local: NDArray[np.uint64],
    order: NDArray[np.int32],
    keys: NDArray[np.uint64],
    shifts: NDArray[np.int64],
) -> NDArray[np.uint8]:
    """(planes, n) uint8: gaps of the sorted codes, then low bits of x, y, z; low bytes first."""
    n = len(keys)
    widest = np.uint64(0)
    previous = np.uint64(0)
    for i in range(n):
        widest = max(widest, keys[i] - previous)
        previous = keys[i]
    gap_bytes = (_bit_length(widest) + 7) // 8
    low_bytes = (shifts + 7) // 8
    planes = np.empty((gap_bytes + low_bytes.sum(), n), np.uint8)
    previous = np.uint64(0)
    for i in range(n):
        gap = keys[i] - previous
        previous = keys[i]
        for b in range(gap_bytes):
            planes[b, i] = np.uint8((gap >> np.uint64(8 * b)) & np.uint64(255))
    row = gap_bytes
    lows = np.empty(n, np.uint64)
    for axis in range(3):
        mask = (np.uint64(1) << np.uint64(shifts[axis])) - np.uint64(1)
        for i in range(n):
            lows[i] = local[order[i], axis] & mask
        for b in range(low_bytes[axis]):
            for i in range(n):
                planes[row, i] = np.uint8((lows[i] >> np.uint64(8 * b)) & np.uint64(255))
            row += 1
    return planes


@nb.njit(cache=True, nogil=True)
def points_from_planes(
    planes: NDArray[np.uint8],
    base: NDArray[np.uint64],
    shifts: NDArray[np.int64],
    exponents: NDArray[np.int64],
    points: NDArray[np.float64],
    bits: NDArray[np.uint64],
) -> None:
    """Fill ``points`` (n, 3), of which ``bits`` is the memory as uint64."""
    n = planes.shape[1]
    low_bytes = (shifts + 7) // 8
    gap_bytes = len(planes) - low_bytes.sum()
    code = np.uint64(0)
    for i in range(n):
        gap = np.uint64(0)
        for b in range(gap_bytes):
            gap |= np.uint64(planes[b, i]) << np.uint64(8 * b)
        code += gap
        for axis in range(3):
            high = _gather(code >> np.uint64(axis))
            bits[i, axis] = high << np.uint64(shifts[axis])
    row = gap_bytes
    for axis in range(3):
        for b in range(low_bytes[axis]):
            for i in range(n):
                bits[i, axis] |= np.uint64(planes[row, i]) << np.uint64(8 * b)
            row += 1
        e = exponents[axis]
        if e == NO_GRID:
            for i in range(n):
                bits[i, axis] = _unordered(bits[i, axis] + base[axis])
        else:
            first = 2.0 ** (e // 2)
            second = 2.0 ** (e - e // 2)
            for i in range(n):
                points[i, axis] = np.float64(np.int64(bits[i, axis] + base[axis])) * first * second


@nb.njit(cache=True, nogil=True)
def zigzag_steps(values: NDArray[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """Steps of unsigned integers (modulo their width), small ones of either sign first."""
    steps = np.empty_like(values)
    top = 8 * values.itemsize - 1
    previous = values.dtype.type(0)
    for i in range(len(values)):
        step = values.dtype.type(values[i] - previous)
        previous = values[i]
        steps[i] = (step << 1) ^ (values.dtype.type(0) - values.dtype.type(step >> top))
    return steps


@nb.njit(cache=True, nogil=True)
def from_zigzag_steps(steps: NDArray[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """Undo ``zigzag_steps``."""
    values = np.empty_like(steps)
    total = steps.dtype.type(0)
    for i in range(len(steps)):
        s = steps[i]
        half = steps.dtype.type(s >> 1)
        total = steps.dtype.type(total + (half ^ (steps.dtype.type(0) - steps.dtype.type(s & 1))))
        values[i] = total
    return values


@nb.njit(cache=True, nogil=True)
def plane_bits(planes: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(planes,) order-0 entropy of every plane, bits in all."""
    found = np.zeros(len(planes))
    n = planes.shape[1]
    for p in range(len(planes)):
        # Four tables: consecutive equal bytes would wait for each other's count.
        counts = np.zeros((4, 256), np.int64)
        for i in range(n):
            counts[i & 3, planes[p, i]] += 1
        total = 0.0
        for k in range(256):
            c = counts[0, k] + counts[1, k] + counts[2, k] + counts[3, k]
            if c:
                total -= c * np.log2(c / n)
        found[p] = total
    return found


@nb.njit(cache=True, nogil=True)
def unit_vector_parts(
    vectors: NDArray[np.float32], bits: NDArray[np.uint32]
) -> tuple[bool, NDArray[np.uint8], NDArray[np.uint32]]:
    """Unit vectors without their largest component.

    Parameters
    ----------
    vectors, bits : (n, 3) float32 and the same memory as uint32.

    Returns
    -------
    unit : False, and the rest meaningless, where a length is off 1 by more than 1e-4.
    dropped : (n,) uint8, axis of the largest component, + 4 where its sign bit is set.
    parts : (3, n) uint32: float bits of the other two, then what the magnitude bits of the
        largest exceed those of √(1 − a² − b²), as zigzag.
    """
    n = len(vectors)
    dropped = np.empty(n, np.uint8)
    parts = np.empty((3, n), np.uint32)
    root = np.empty(1, np.float32)
    as_bits = root.view(np.uint32)
    for i in range(n):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        if not abs(x * x + y * y + z * z - 1.0) < 2e-4:
            return False, dropped, parts
        axis = 0
        if abs(y) > abs(x):
            axis = 1
        if abs(z) > max(abs(x), abs(y)):
            axis = 2
        first, second = (axis + 1) % 3, (axis + 2) % 3
        a, b = np.float64(vectors[i, first]), np.float64(vectors[i, second])
        root[0] = np.sqrt(max(0.0, 1.0 - (a * a + b * b)))
        c = bits[i, axis]
        dropped[i] = axis + (4 if c & np.uint32(0x80000000) else 0)
        parts[0, i], parts[1, i] = bits[i, first], bits[i, second]
        excess = np.int64(c & np.uint32(0x7FFFFFFF)) - np.int64(as_bits[0])
        parts[2, i] = np.uint32(2 * excess if excess >= 0 else -2 * excess - 1)
    return True, dropped, parts


@nb.njit(cache=True, nogil=True)
def unit_vectors_from_parts(
    dropped: NDArray[np.uint8], parts: NDArray[np.uint32]
) -> NDArray[np.uint32]:
    """(n, 3) uint32 float bits: undo ``unit_vector_parts``."""
    n = len(dropped)
    bits = np.empty((n, 3), np.uint32)
    root = np.empty(1, np.float32)
    as_bits = root.view(np.uint32)
    pair_bits = np.empty(2, np.uint32)
    pair = pair_bits.view(np.float32)
    for i in range(n):
        axis = dropped[i] & 3
        pair_bits[0], pair_bits[1] = parts[0, i], parts[1, i]
        a, b = np.float64(pair[0]), np.float64(pair[1])
        root[0] = np.sqrt(max(0.0, 1.0 - (a * a + b * b)))
        coded = np.int64(parts[2, i])
        excess = -((coded + 1) // 2) if coded & 1 else coded // 2
        c = np.uint32(np.int64(as_bits[0]) + excess)
        if dropped[i] & 4:
            c |= np.uint32(0x80000000)
        bits[i, (axis + 1) % 3], bits[i, (axis + 2) % 3] = parts[0, i], parts[1, i]
        bits[i, axis] = c
    return bits
