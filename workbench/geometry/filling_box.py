"""Where scans may have missed something of their object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# The object may go on beyond what was scanned by this share of the diagonal.
_BEYOND = 0.1


def filling_box(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (3,), (3,) of the box that is filled, from those of the box of what was scanned."""
    beyond = _BEYOND * float(np.linalg.norm(high - low))
    return low - beyond, high + beyond
