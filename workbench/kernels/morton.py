"""Morton codes: three integers of 21 bits woven into one of 63, x lowest in each triple."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BITS_PER_AXIS = 21


@njit(cache=True, nogil=True)
def spread_bits(value: int | np.integer) -> np.uint64:
    """The 21 low bits of ``value`` with two zero bits after each, uint64."""
    v = np.uint64(value) & np.uint64(0x1FFFFF)
    v = (v | (v << np.uint64(32))) & np.uint64(0x001F00000000FFFF)
    v = (v | (v << np.uint64(16))) & np.uint64(0x001F0000FF0000FF)
    v = (v | (v << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    v = (v | (v << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (v | (v << np.uint64(2))) & np.uint64(0x1249249249249249)


@njit(cache=True, nogil=True)
def gathered_bits(code: np.uint64) -> np.uint64:
    """Every third bit of ``code`` from the lowest on, uint64: undoes `spread_bits`."""
    v = np.uint64(code) & np.uint64(0x1249249249249249)
    v = (v | (v >> np.uint64(2))) & np.uint64(0x10C30C30C30C30C3)
    v = (v | (v >> np.uint64(4))) & np.uint64(0x100F00F00F00F00F)
    v = (v | (v >> np.uint64(8))) & np.uint64(0x001F0000FF0000FF)
    v = (v | (v >> np.uint64(16))) & np.uint64(0x001F00000000FFFF)
    return (v | (v >> np.uint64(32))) & np.uint64(0x1FFFFF)


@njit(cache=True, nogil=True)
def morton_code(x: int | np.integer, y: int | np.integer, z: int | np.integer) -> np.uint64:
    """The code (uint64) of one cell; coordinates in [0, 2²¹)."""
    code: np.uint64 = (
        spread_bits(x) | (spread_bits(y) << np.uint64(1)) | (spread_bits(z) << np.uint64(2))
    )
    return code


@njit(cache=True, nogil=True)
def _encode(cells: NDArray[np.integer], codes: NDArray[np.uint64]) -> None:
    for i in range(len(cells)):
        codes[i] = morton_code(cells[i, 0], cells[i, 1], cells[i, 2])


@njit(cache=True, nogil=True)
def _decode(codes: NDArray[np.uint64], cells: NDArray[np.int32]) -> None:
    for i in range(len(codes)):
        for axis in range(3):
            cells[i, axis] = gathered_bits(codes[i] >> np.uint64(axis))


def morton_codes(cells: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Codes (n,) of cells (n, 3), integers in [0, 2²¹): x is bit 0, y bit 1, z bit 2.

    >>> morton_codes(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 3]]))
    array([ 1,  2,  4, 44], dtype=uint64)
    """
    whole = np.ascontiguousarray(cells)
    if whole.dtype.kind not in "iu" or whole.ndim != 2 or whole.shape[1] != 3:
        raise ValueError("cells must be integers (n, 3)")
    if len(whole) and (whole.min() < 0 or whole.max() >= 1 << BITS_PER_AXIS):
        raise ValueError(f"a cell lies outside [0, 2**{BITS_PER_AXIS})")
    codes = np.empty(len(whole), np.uint64)
    _encode(whole, codes)
    return codes


def morton_cells(codes: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Cells (n, 3) of `morton_codes`."""
    whole = np.ascontiguousarray(codes, np.uint64)
    cells = np.empty((len(whole), 3), np.int32)
    _decode(whole, cells)
    return cells
