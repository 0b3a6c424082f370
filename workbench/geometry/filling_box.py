"""Where scans may have missed something of their object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.regions import Box

# The object may go on beyond what was scanned by this share of the diagonal.
_BEYOND = 0.1


def filling_box(low: NDArray[np.float64], high: NDArray[np.float64]) -> Box:
    """The box that is filled, from the corners (3,), (3,) of that of what was scanned."""
    beyond = _BEYOND * float(np.linalg.norm(high - low))
    return Box(low - beyond, high + beyond)
