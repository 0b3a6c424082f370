"""What a scan saw through: the space between the scanner and the surface is empty.

Sources: Huber and Hebert 2003 (visibility consistency of range images); Curless and Levoy
1996 (empty space along the line of sight).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.geometry.neighbours import k_nearest, nearest
from workbench.geometry.orientedscan import OrientedScan

# A direction within this many steps between neighbouring lines of sight was looked along.
_STEPS = 1.5


class FreeSpace:
    """The lines of sight of one scan.

    Parameters
    ----------
    scan : trusted samples; a sample on a border proves nothing of its surroundings.
    viewpoint : (3,) where the scanner stood, in the scan's frame, metres.
    """

    def __init__(self, scan: OrientedScan, viewpoint: NDArray[np.float64]) -> None:
        self._viewpoint = viewpoint
        firm = scan.take(~scan.border)
        self._points, self._normals = firm.points, firm.normals
        sight = firm.points - viewpoint
        self._range_m = np.linalg.norm(sight, axis=1)
        self._tree = cKDTree(sight / self._range_m[:, None]) if len(firm) else None
        self._step = 0.0
        if self._tree is not None and len(firm) > 1:
            picked = np.linspace(0, len(firm) - 1, min(len(firm), 500)).astype(int)
            self._step = float(
                np.median(k_nearest(self._tree, self._tree.data[picked], 2)[0][:, 1])
            )

    def violated(self, points: NDArray[np.float64], margin_m: float) -> NDArray[np.bool_]:
        """Which points lie where this scan saw nothing but air.

        Parameters
        ----------
        points : (m, 3) in this scan's frame.
        margin_m : how far in front of the surface seen, along its normal, a point must lie.
        """
        violated = np.zeros(len(points), bool)
        if self._tree is None or not len(points):
            return violated
        sight = points - self._viewpoint
        range_m = np.linalg.norm(sight, axis=1)
        direction = sight / np.where(range_m > 0, range_m, 1.0)[:, None]
        apart, index = nearest(self._tree, direction, _STEPS * self._step)
        looked = np.flatnonzero(np.isfinite(apart))
        seen = index[looked]
        gap = points[looked] - self._points[seen]
        in_front = np.einsum("mi,mi->m", gap, self._normals[seen]) > margin_m
        violated[looked] = in_front & (range_m[looked] < self._range_m[seen] - margin_m)
        return violated
