"""How light falls on a model in the page, for pictures made without one."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Light = Literal["even", "camera"]
AMBIENT = 0.3
"""Share of the light that comes from everywhere when the lamp at the camera is on."""
PLAIN = 0.55
"""Linear albedo of what has no colours."""


def lit(
    albedo: NDArray[np.float64],
    normals: NDArray[np.float64],
    ways: NDArray[np.float64],
    light: Light,
) -> NDArray[np.float64]:
    """Linear light (n, 3) that comes from places, 0 … 1.

    Parameters
    ----------
    albedo
        (n, 3) linear, 0 … 1.
    normals
        (n, 3), of any length; 0 for places without one, which are lit in full.
    ways
        (n, 3) from the eye to the places, of any length. Normals may point either way.
    light
        ``even`` shows colours as they are, ``camera`` lights them from the eye.
    """
    if light == "even":
        return albedo
    long = np.linalg.norm(normals, axis=1)
    size = long * np.linalg.norm(ways, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = np.abs((normals * ways).sum(axis=1)) / size
    facing = np.where(size > 0.0, facing, 1.0)
    return np.asarray(albedo * (AMBIENT + (1.0 - AMBIENT) * np.minimum(facing, 1.0))[:, None])
