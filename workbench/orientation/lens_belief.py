"""What is believed of a lens before any photograph is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import ColmapCamera

Matrices = NDArray[np.float64]

# What is believed of every lens before: a middle near the image's (parts of the longer side),
# square pixels (parts of the focal length), well-centred elements. Photographs of one object
# alone hardly tell these from a turn of all cameras.
_PRINCIPAL_SIGMA, _SQUARE_SIGMA = 0.005, 1e-4
_DISTORTION_SIGMA, _TANGENTIAL_SIGMA = 0.2, 5e-4
_TANGENTIAL = ("p1", "p2")


@dataclass(frozen=True)
class LensBelief:
    """Residuals ``rows @ params − values`` of unit variance, before any photograph is seen."""

    rows: Matrices
    values: Matrices

    @classmethod
    def of(cls, camera: ColmapCamera) -> LensBelief:
        """What is believed of a lens of that model and image size."""
        import pycolmap

        lens = pycolmap.Camera(
            model=camera.model, width=camera.width, height=camera.height, params=camera.params
        )
        names = [name.strip() for name in lens.params_info.split(",")]
        rows, values = [], []
        side = max(camera.width, camera.height)
        middle = (0.5 * camera.width, 0.5 * camera.height)
        unit = np.eye(len(names))
        for index, expected in zip(lens.principal_point_idxs(), middle, strict=True):
            rows.append(unit[index] / (_PRINCIPAL_SIGMA * side))
            values.append(expected / (_PRINCIPAL_SIGMA * side))
        for index in lens.extra_params_idxs():
            sigma = _TANGENTIAL_SIGMA if names[index] in _TANGENTIAL else _DISTORTION_SIGMA
            rows.append(unit[index] / sigma)
            values.append(0.0)
        focal = lens.focal_length_idxs()
        if len(focal) == 2:
            sigma = _SQUARE_SIGMA * camera.params[focal[0]]
            rows.append((unit[focal[0]] - unit[focal[1]]) / sigma)
            values.append(0.0)
        return cls(np.array(rows).reshape(-1, len(names)), np.array(values))

    def residuals(self, params: Matrices) -> Matrices:
        """(k,) how far the parameters are from what is believed, in its standard deviations."""
        return np.asarray(self.rows @ params - self.values)
