"""The planes that pixels of a depth picture lie in, as the page's shader fits them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_NARROWEST, _WIDEST, _ASIDE = 2, 12, 4
_FEWEST, _FLATTEST = 4, 1e-3


@njit(cache=True, nogil=True)
def plane_normals(
    inverse: NDArray[np.float64],
    sizes: NDArray[np.float64],
    lens: tuple[float, float, float, float],
    out: NDArray[np.float64],
) -> None:
    """Fill unit normals that face the camera, of least squares over a window.

    One over depth is linear over the picture of a plane. The window is as wide as two cells,
    of which at most nine by nine pixels are looked at; what lies further apart in depth than
    steps of cells go is of another surface.

    Parameters
    ----------
    inverse : (h, w) one over depth; 0 where there is nothing.
    sizes : (h, w) sides of the cells seen, in the unit of depths.
    lens : focal lengths and principal point fx, fy, cx, cy, pixels; fx and fy alike.
    out : (h, w, 3) filled in the camera's frame, x right, y down, z forward; NaN where there
        is nothing, towards the camera where too little is around.
    """
    h, w = inverse.shape
    fx, fy, cx, cy = lens
    slope = 1.0 / fx
    for y in range(h):
        for x in range(w):
            middle = inverse[y, x]
            if middle == 0.0:
                out[y, x] = np.nan
                continue
            cell = sizes[y, x] * middle
            radius = int(min(max(math.ceil(2.0 * cell / slope), _NARROWEST), _WIDEST))
            stride = (radius + _ASIDE - 1) // _ASIDE
            step = 2.0 * middle * max(cell, slope)
            n = sx = sy = sv = sxx = sxy = syy = sxv = syv = 0.0
            for j in range(-_ASIDE, _ASIDE + 1):
                for i in range(-_ASIDE, _ASIDE + 1):
                    dx, dy = i * stride, j * stride
                    aside = max(abs(dx), abs(dy))
                    if aside > radius or not (0 <= x + dx < w and 0 <= y + dy < h):
                        continue
                    other = inverse[y + dy, x + dx]
                    if other == 0.0 or abs(other - middle) > step * (1 + aside):
                        continue
                    v = (other - middle) / middle
                    n += 1.0
                    sx += dx
                    sy += dy
                    sv += v
                    sxx += dx * dx
                    sxy += dx * dy
                    syy += dy * dy
                    sxv += dx * v
                    syv += dy * v
            here_x, here_y = (x + 0.5 - cx) / fx, (y + 0.5 - cy) / fy
            a, b, c = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            u, v = sxv - sx * sv / n, syv - sy * sv / n
            det = a * c - b * b
            if n < _FEWEST or det <= 0.0 or det < _FLATTEST * a * c:
                nx, ny, nz = here_x, here_y, 1.0
            else:
                # Change along the picture for a pixel; then for a slope of 1.
                px, py = (c * u - b * v) / det, (a * v - b * u) / det
                nx, ny = px / slope, py / slope
                level = 1.0 + (sv - px * sx - py * sy) / n
                nz = level - nx * here_x - ny * here_y
            length = -math.sqrt(nx * nx + ny * ny + nz * nz)
            out[y, x, 0] = nx / length
            out[y, x, 1] = ny / length
            out[y, x, 2] = nz / length
