"""Rectangles packed on a page, each as high up as it goes, by the skyline of those before.

Source: Jylänki, *A thousand ways to pack the bin* (2010), section 2.6, bottom-left.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def packed_on_page(sizes: NDArray[np.int32], width: int, height: int) -> NDArray[np.int32]:
    """Column and row of rectangles (n, 2) of width and height on one page, in their order.

    (n, 2) int32; −1 for those that there is no room for.
    """
    places = np.full((len(sizes), 2), -1, np.int32)
    # The skyline: from column left[i] to left[i + 1], everything above level[i] is taken.
    left = np.zeros(2 * len(sizes) + 2, np.int32)
    level = np.zeros(2 * len(sizes) + 2, np.int32)
    count = 1
    for r in range(len(sizes)):
        w, h = sizes[r, 0], sizes[r, 1]
        best, best_level = -1, height + 1
        for i in range(count):
            if left[i] + w > width:
                break
            top, k = level[i], i
            while k + 1 < count and left[k + 1] < left[i] + w:
                k += 1
                top = max(top, level[k])
            if top + h <= height and top < best_level:
                best, best_level = i, top
        if best < 0:
            continue
        start, end = left[best], left[best] + w
        places[r, 0], places[r, 1] = start, best_level
        # What the rectangle covers of the skyline gives way to its lower side.
        last = best
        while last + 1 < count and left[last + 1] <= end:
            last += 1
        rest_level, rest = level[last], end < width and left[last] < end
        if last > best and left[last] == end:
            rest = False
            last -= 1
        new = 2 if rest else 1
        shift = new - (last - best + 1)
        if shift > 0:
            for i in range(count - 1, last, -1):
                left[i + shift], level[i + shift] = left[i], level[i]
        elif shift < 0:
            for i in range(last + 1, count):
                left[i + shift], level[i + shift] = left[i], level[i]
        count += shift
        left[best], level[best] = start, best_level + h
        if rest:
            left[best + 1], level[best + 1] = end, rest_level
    return places
