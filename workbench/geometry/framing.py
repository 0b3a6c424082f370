"""What a picture of a model has to hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# What lies within half the width of the middle 96 % beyond them belongs to the object: the arms
# of a statue do, a wall far behind a fountain does not.
_SHARE, _BEYOND = 0.02, 0.5


def main_box(points: ArrayLike) -> NDArray[np.float64]:
    """The box (2, 3) of points (n, 3) without the few that lie far from all others.

    It is that of all points where none lies further off than half the width of their middle
    96 %, along each axis.
    """
    given = np.asarray(points, float)
    low, high = np.quantile(given, [_SHARE, 1.0 - _SHARE], axis=0)
    # Of a flat object the thickness does not tell what is far.
    reach = _BEYOND * np.maximum(high - low, 0.1 * (high - low).max())
    return np.stack(
        [np.maximum(low - reach, given.min(axis=0)), np.minimum(high + reach, given.max(axis=0))]
    )
