"""Normal equations of a bundle adjustment, which observations are added to part by part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrices = NDArray[np.float64]


@dataclass(frozen=True)
class Linearised:
    """Normal equations of the reprojections; c camera unknowns, p points.

    Attributes
    ----------
    camera_hessian : (c, c); every image's rotation and shift, then every lens's parameters.
    camera_gradient : (c,).
    point_hessian : (p, 3, 3).
    point_gradient : (p, 3).
    coupling : (c, 3p) sparse.
    weights : (m,) robust weight of each observation.
    """

    camera_hessian: Matrices
    camera_gradient: Matrices
    point_hessian: Matrices
    point_gradient: Matrices
    coupling: Any
    weights: Matrices

    def __add__(self, other: Linearised) -> Linearised:
        """Of the observations of both, about the same unknowns."""
        return Linearised(
            self.camera_hessian + other.camera_hessian,
            self.camera_gradient + other.camera_gradient,
            self.point_hessian + other.point_hessian,
            self.point_gradient + other.point_gradient,
            self.coupling + other.coupling,
            np.concatenate([self.weights, other.weights]),
        )
