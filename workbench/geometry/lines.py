"""Lines in space, such as the rays that cameras see something along."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


def place_nearest_to(
    lines: Iterable[tuple[NDArray[np.float64], NDArray[np.float64]]], worst_condition: float
) -> NDArray[np.float64] | None:
    """The place (3,) with the least sum of squared distances to lines.

    Parameters
    ----------
    lines : a point (3,) of each, and its direction (3,), unit.
    worst_condition : of the 3×3 system, beyond which nothing is told: lines that are parallel, or
        a single one.
    """
    system, right = np.zeros((3, 3)), np.zeros(3)
    for point, way in lines:
        across = np.eye(3) - np.outer(way, way)
        system += across
        right += across @ point
    if not np.linalg.cond(system) <= worst_condition:
        return None
    return np.asarray(np.linalg.solve(system, right))
