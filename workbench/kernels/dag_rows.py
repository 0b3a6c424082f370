"""Rows of eight children: gathered from sorted codes, and each kept once."""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

# A child's word is its place in the level below times 64 plus its turn, 0 … 47.
NO_CHILD = np.uint32(0xFFFFFFFF)
TURN_BITS, TURN_MASK = 6, 63

_THREE, _SEVEN, _HALF = np.uint64(3), np.uint64(7), np.uint64(32)
# Odd constants of the splitmix64 generator (Steele et al. 2014).
_ODD_1, _ODD_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@njit(cache=True, nogil=True)
def parent_count(codes: NDArray[np.uint64]) -> int:
    """How many parents the ascending ``codes`` (n,) have."""
    count = 0
    for i in range(len(codes)):
        if i == 0 or codes[i] >> _THREE != codes[i - 1] >> _THREE:
            count += 1
    return count


@njit(cache=True, nogil=True)
def voxel_parents(
    codes: NDArray[np.uint64], parents: NDArray[np.uint64], masks: NDArray[np.uint8]
) -> None:
    """Fill the parents' codes (m,) and which of their 2³ voxels are there, bit by child."""
    k = -1
    for i in range(len(codes)):
        parent = codes[i] >> _THREE
        if k < 0 or parent != parents[k]:
            k += 1
            parents[k] = parent
            masks[k] = 0
        masks[k] |= np.uint8(1 << int64(codes[i] & _SEVEN))


@njit(cache=True, nogil=True)
def node_parents(
    codes: NDArray[np.uint64],
    words: NDArray[np.uint32],
    parents: NDArray[np.uint64],
    rows: NDArray[np.uint32],
) -> None:
    """Fill the parents' codes (m,) and their rows (m, 8) of the nodes' words (n,)."""
    k = -1
    for i in range(len(codes)):
        parent = codes[i] >> _THREE
        if k < 0 or parent != parents[k]:
            k += 1
            parents[k] = parent
            rows[k, :] = NO_CHILD
        rows[k, int64(codes[i] & _SEVEN)] = words[i]


@njit(cache=True, nogil=True)
def _hash(row: NDArray[np.uint32]) -> np.uint64:
    h = np.uint64(0)
    for c in range(0, 8, 2):
        h ^= (np.uint64(row[c]) << _HALF) | np.uint64(row[c + 1])
        h *= _ODD_1
        h ^= h >> np.uint64(29)
    h *= _ODD_2
    return h ^ (h >> _HALF)


@njit(cache=True, nogil=True)
def _slot(row: NDArray[np.uint32], kept: NDArray[np.uint32], table: NDArray[np.uint32]) -> int:
    """Where in the table ``row`` is, or the empty place where it belongs."""
    last = np.uint64(len(table) - 1)
    at = _hash(row) & last
    while True:
        place: int = int64(at)
        entry = table[place]
        if entry == 0:
            return place
        same = True
        for c in range(8):
            if kept[entry - 1, c] != row[c]:
                same = False
                break
        if same:
            return place
        at = (at + np.uint64(1)) & last


@njit(cache=True, nogil=True)
def enter_rows(
    rows: NDArray[np.uint32],
    kept: NDArray[np.uint32],
    count: int,
    table: NDArray[np.uint32],
    places: NDArray[np.uint32],
) -> int:
    """Append each new row of ``rows`` (n, 8) to ``kept`` and fill ``places`` (n,) of all.

    Parameters
    ----------
    rows : to enter, in order; a row is kept where it first appears.
    kept : (m, 8) with room for all; the first ``count`` are taken.
    count : rows already kept.
    table : hash table of places plus one, its length a power of two above 2 m; 0 is empty.
    places : (n,) filled with the place of each row in ``kept``.

    Returns
    -------
    The new count.
    """
    for i in range(len(rows)):
        at = _slot(rows[i], kept, table)
        if table[at] == 0:
            kept[count] = rows[i]
            count += 1
            table[at] = count
        places[i] = table[at] - 1
    return count


@njit(cache=True, nogil=True)
def fill_table(kept: NDArray[np.uint32], count: int, table: NDArray[np.uint32]) -> None:
    """Put the first ``count`` rows of ``kept``, all different, into an empty table."""
    for i in range(count):
        table[_slot(kept[i], kept, table)] = i + 1
