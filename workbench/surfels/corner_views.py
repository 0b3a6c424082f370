"""Orthographic views of a box from its corners and sides (Brandt 2019, 3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

# A plate's corners lie in its plane: seen from there it would have no width.
_LEAST_SHARE = 0.25


@dataclass(frozen=True)
class CornerView:
    """A picture whose rays are parallel.

    Attributes
    ----------
    axes : (3, 3) float64 rows right, down and forward, unit, in the frame of the box.
    corner : (3,) float64 place of the upper left corner of the picture, before the box.
    pixel : side of a pixel in the unit of the box.
    width, height : pixels.
    """

    axes: NDArray[np.float64]
    corner: NDArray[np.float64]
    pixel: float
    width: int
    height: int

    @property
    def extent(self) -> float:
        """The longer side of the picture in the unit of the box."""
        return self.pixel * max(self.width, self.height)

    def origins(self, rows: slice) -> NDArray[np.float64]:
        """Where the rays (r · width, 3) through the pixels' middles of some rows begin."""
        across = (np.arange(self.width) + 0.5) * self.pixel
        down = (np.arange(self.height)[rows] + 0.5) * self.pixel
        places = down[:, None, None] * self.axes[1] + across[None, :, None] * self.axes[0]
        return np.asarray(self.corner + places.reshape(-1, 3))


def corner_views(
    lower: NDArray[np.float64], upper: NDArray[np.float64], resolution: int, views: int = 8
) -> list[CornerView]:
    """Views of a box towards its middle.

    Parameters
    ----------
    lower, upper
        (3,) corners of the box; it may be flat. Sides shorter than a quarter of the longest
        count as that long for the directions.
    resolution
        Pixels along the longer side of each picture.
    views
        8 are those from the corners; 14 are also from the middles of the faces, 26 from those of
        the edges, too.
    """
    half = 0.5 * (upper - lower)
    stretched = np.maximum(half, _LEAST_SHARE * max(float(half.max()), 1e-300))
    middle = 0.5 * (lower + upper)
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    found = []
    for sign in _sides()[:views]:
        forward = -sign * stretched / np.linalg.norm(sign * stretched)
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(forward, right), forward])
        seen = (corners * half) @ axes.T
        first, extent = seen.min(axis=0), np.ptp(seen, axis=0)
        longest = max(float(extent[:2].max()), 1e-300)
        # Half a pixel all round: what lies on the very border is seen.
        pixel = longest / max(resolution - 1, 1)
        # The longest side has the resolution itself, whatever rounding does.
        width, height = (math.ceil(side / pixel - 1e-9) + 1 for side in extent[:2])
        start = first - 0.5 * pixel * np.array([1.0, 1.0, 0.0])
        start[2] -= 0.01 * longest
        found.append(CornerView(axes, middle + start @ axes, pixel, width, height))
    return found


def _sides() -> NDArray[np.float64]:
    """(26, 3) signs of the corners of a box, then of its faces, then of its edges."""
    signs = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    zeros = (signs == 0.0).sum(axis=1)
    return np.concatenate([signs[zeros == count] for count in (0, 2, 1)])
