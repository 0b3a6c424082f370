"""Normals of a traced picture, from its depths alone (Jaspe 2018, 5.5.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.depth_shading import smoothed_inverse_depths

_WIDEST = 12


def screen_normals(
    depths: NDArray[np.float64],
    rays: NDArray[np.float64],
    cell_sizes: NDArray[np.float64],
    pixel_slope: float,
) -> NDArray[np.float64]:
    """Unit normals (h, w, 3) that face the camera; NaN where there is no surface.

    Depths go up and down with the faces of voxels. They are averaged over a window of a few
    voxels, on either side of an edge for itself, and then differenced to the neighbour that is
    nearer in depth, so that no normal is taken across an edge.

    Parameters
    ----------
    depths : (h, w) along the optical axis; infinite where there is nothing.
    rays : (h, w, 3) directions of the pixels' rays at depth 1.
    cell_sizes : (h, w) side of the cell that is seen, in the unit of depths.
    pixel_slope : side of a pixel at depth 1.
    """
    seen = np.isfinite(depths)
    if not seen.any():
        return np.full(rays.shape, np.nan)
    z = np.where(seen, depths, np.inf)
    inverse = np.where(seen, 1.0 / z, 0.0)
    pixels = float(np.median((cell_sizes / (z * pixel_slope))[seen]))
    radius = int(np.clip(np.ceil(2.0 * pixels), 2, _WIDEST))
    step = 2.0 * inverse * np.maximum(cell_sizes * inverse, np.where(seen, pixel_slope, 0.0))
    smooth = np.empty_like(inverse)
    smoothed_inverse_depths(inverse, step, radius, smooth)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = rays / smooth[..., None]
        across, down = (_difference(points, smooth, axis) for axis in (1, 0))
        normals = np.cross(down, across)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    # A pixel alone has no neighbour to tell its slope: it faces the camera.
    alone = seen & ~np.isfinite(normals).all(axis=-1)
    normals[alone] = (-rays / np.linalg.norm(rays, axis=-1, keepdims=True))[alone]
    normals[~seen] = np.nan
    return np.asarray(normals)


def _difference(
    points: NDArray[np.float64], inverse: NDArray[np.float64], axis: int
) -> NDArray[np.float64]:
    """Differences of points (h, w, 3) to whichever neighbour along ``axis`` is nearer in depth."""
    change = np.full(points.shape, np.nan)
    jump = np.full(inverse.shape, np.inf)
    first = tuple(slice(None, -1) if k == axis else slice(None) for k in range(2))
    second = tuple(slice(1, None) if k == axis else slice(None) for k in range(2))
    there = (inverse[first] > 0.0) & (inverse[second] > 0.0)
    gap = np.where(there, np.abs(inverse[second] - inverse[first]), np.inf)
    step = points[second] - points[first]
    change[first], jump[first] = np.where(there[..., None], step, np.nan), gap
    nearer = gap < jump[second]
    change[second] = np.where(nearer[..., None], step, change[second])
    return change
