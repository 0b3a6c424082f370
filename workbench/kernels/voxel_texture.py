"""Mean colours of pieces of a textured surface, to the texel."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE

# Columns of a page's row: first texel, rows and columns of the picture, whether it repeats.
START, ROWS, COLUMNS, REPEATS = range(4)
# Parts along an edge of a piece at most: 32 texels of one voxel are read as 16.
_MOST_PARTS = 16


@njit(cache=True, nogil=True)
def texture_mean(
    polygon: NDArray[np.float64], count: int, u: int, v: int, base: NDArray[np.float64],
    along_u: NDArray[np.float64], along_v: NDArray[np.float64], least: NDArray[np.float64],
    most: NDArray[np.float64], page: NDArray[np.int64], texels: NDArray[np.uint8],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """The mean colour of a convex piece of surface, in linear light.

    The piece is cut into triangles about a texel large, and each takes the colour of its middle.

    Parameters
    ----------
    polygon, count : (k, 3) corners, of which the first ``count`` are in use.
    u, v : the axes of the plane onto which the piece is projected.
    base, along_u, along_v : (3,) column (0) and row (1) in texels as linear functions of u and v;
        the middle of the first texel is at 0, 0.
    least, most : (3,) bounds of column and row, those of the whole triangle.
    page : (4,) of the picture, see above.
    texels : (t, 3) sRGB of all pictures, row by row.
    out : (3,) output.
    """
    out[:] = 0.0
    total = 0.0
    u0, v0 = polygon[0, u], polygon[0, v]
    for k in range(1, count - 1):
        bu, bv = polygon[k, u] - u0, polygon[k, v] - v0
        cu, cv = polygon[k + 1, u] - u0, polygon[k + 1, v] - v0
        weight = abs(bu * cv - bv * cu)
        if not weight > 0.0:
            continue
        longest = 0.0
        for axis in range(2):
            b = along_u[axis] * bu + along_v[axis] * bv
            c = along_u[axis] * cu + along_v[axis] * cv
            longest = max(longest, abs(b), abs(c), abs(c - b))
        parts = int(min(max(math.ceil(longest), 1.0), _MOST_PARTS))
        weight /= parts * parts
        total += weight * parts * parts
        for i in range(parts):
            for j in range(parts - i):
                # The part with its corner at (i, j), and the one that fills up the square.
                for half in range(1 if i + j == parts - 1 else 2):
                    s = (i + (half + 1) / 3.0) / parts
                    t = (j + (half + 1) / 3.0) / parts
                    _add_texel(
                        u0 + s * bu + t * cu, v0 + s * bv + t * cv, base, along_u, along_v,
                        least, most, page, texels, weight, out,
                    )  # fmt: skip
    if total > 0.0:
        for k in range(3):
            out[k] /= total
    else:
        _add_texel(u0, v0, base, along_u, along_v, least, most, page, texels, 1.0, out)


@njit(cache=True, nogil=True)
def _add_texel(
    at_u: float, at_v: float, base: NDArray[np.float64], along_u: NDArray[np.float64],
    along_v: NDArray[np.float64], least: NDArray[np.float64], most: NDArray[np.float64],
    page: NDArray[np.int64], texels: NDArray[np.uint8], weight: float, out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add the bilinear colour of one place, times ``weight``."""
    column = base[0] + along_u[0] * at_u + along_v[0] * at_v
    row = base[1] + along_u[1] * at_u + along_v[1] * at_v
    column = min(max(column, least[0]), most[0])
    row = min(max(row, least[1]), most[1])
    left, top = math.floor(column), math.floor(row)
    right_share, lower_share = column - left, row - top
    for down in range(2):
        y = _inside(int(top) + down, page[ROWS], page[REPEATS])
        row_weight = weight * (lower_share if down else 1.0 - lower_share)
        for right in range(2):
            x = _inside(int(left) + right, page[COLUMNS], page[REPEATS])
            own = row_weight * (right_share if right else 1.0 - right_share)
            texel = texels[page[START] + y * page[COLUMNS] + x]
            for k in range(3):
                out[k] += own * LINEAR_OF_BYTE[texel[k]]


@njit(cache=True, nogil=True)
def _inside(place: int, count: int, repeats: int) -> int:
    """A row or column of the picture for one that may lie outside."""
    if repeats:
        return place % count
    return min(max(place, 0), count - 1)
