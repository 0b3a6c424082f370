"""Rows of varying length: where the values of every row and property start."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

OK, TOO_SHORT, BAD_COUNT = 0, 1, 2


@njit(cache=True, nogil=True)
def walk_number_rows(
    numbers: NDArray[np.float64],
    position: int,
    is_list: NDArray[np.bool_],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> tuple[int, int, int, int]:
    """Find the values of rows in a stream of numbers, as in the text form of PLY.

    Parameters
    ----------
    numbers
        (k,) float64, the whole stream.
    position
        index of the first number of the first row.
    is_list
        (p,) bool: a count precedes the values of this property.
    starts, lengths
        (rows, p) int64, written: index of the first value, number of values.

    Returns
    -------
    status : ``OK``, ``TOO_SHORT`` or ``BAD_COUNT`` (negative, not whole, not finite).
    row, property : where it stopped.
    position : index after the last number of the last row.
    """
    rows, properties = starts.shape
    for row in range(rows):
        for k in range(properties):
            count = 1
            if is_list[k]:
                if position >= numbers.size:
                    return TOO_SHORT, row, k, position
                written = numbers[position]
                if not (written >= 0.0 and written < 2.0**53) or written != np.floor(written):
                    return BAD_COUNT, row, k, position
                count = int(written)
                position += 1
            if count > numbers.size - position:
                return TOO_SHORT, row, k, position
            starts[row, k] = position
            lengths[row, k] = count
            position += count
    return OK, rows, 0, position


@njit(cache=True, nogil=True)
def walk_byte_rows(
    data: NDArray[np.uint8],
    position: int,
    value_sizes: NDArray[np.int64],
    count_sizes: NDArray[np.int64],
    count_signed: NDArray[np.bool_],
    big_endian: bool,
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> tuple[int, int, int, int]:
    """Find the values of rows in bytes, as in the binary forms of PLY.

    Parameters
    ----------
    data
        (b,) uint8, the whole file.
    position
        byte where the first row starts.
    value_sizes
        (p,) int64, bytes of one value.
    count_sizes
        (p,) int64, bytes of the count before a list; 0 for a single value.
    count_signed
        (p,) bool.
    big_endian
        byte order of the counts.
    starts, lengths
        (rows, p) int64, written: byte of the first value, number of values.

    Returns
    -------
    status, row, property, position : as `walk_number_rows`, positions in bytes.
    """
    rows, properties = starts.shape
    for row in range(rows):
        for k in range(properties):
            count = np.int64(1)
            size = count_sizes[k]
            if size > 0:
                if size > data.size - position:
                    return TOO_SHORT, row, k, position
                count = np.int64(0)
                for j in range(size):
                    byte = data[position + (j if big_endian else size - 1 - j)]
                    count = count * 256 + np.int64(byte)
                if count_signed[k] and count >= np.int64(1) << (8 * size - 1):
                    return BAD_COUNT, row, k, position
                position += size
            if count > (data.size - position) // value_sizes[k]:
                return TOO_SHORT, row, k, position
            starts[row, k] = position
            lengths[row, k] = count
            position += count * value_sizes[k]
    return OK, rows, 0, position
