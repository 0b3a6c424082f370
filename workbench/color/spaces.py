"""Working spaces of linear RGB, and CIE Lab to judge differences in.

Everything is relative to D50, the white of the chart's published colours and of ICC profiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

SpaceName = Literal["rec709", "prophoto"]

_COLOUR_NAMES = {"rec709": "ITU-R BT.709", "prophoto": "ProPhoto RGB"}
_TITLES = {"rec709": "Linear Rec. 709", "prophoto": "Linear ProPhoto RGB"}
# CIE 15:2018, 8.2.1.
_EPSILON, _KAPPA = 216 / 24389, 24389 / 27


@dataclass(frozen=True)
class WorkingSpace:
    """A space of linear RGB.

    Attributes
    ----------
    name : as settings and files have it.
    title : for people.
    xyz_d50_from_rgb : (3, 3); (1, 1, 1) gives the white D50 with Y 1.
    """

    name: SpaceName
    title: str
    xyz_d50_from_rgb: NDArray[np.float64]

    @property
    def rgb_from_xyz_d50(self) -> NDArray[np.float64]:
        """(3, 3), the inverse."""
        return np.asarray(np.linalg.inv(self.xyz_d50_from_rgb))


@cache
def working_space(name: SpaceName) -> WorkingSpace:
    """A working space by name, its white adapted to D50 by Bradford's transform."""
    import colour

    space = colour.RGB_COLOURSPACES[_COLOUR_NAMES[name]]
    matrix = colour.normalised_primary_matrix(space.primaries, space.whitepoint)
    adapted = _bradford(colour.xy_to_XYZ(space.whitepoint), white_d50()) @ matrix
    return WorkingSpace(name, _TITLES[name], np.asarray(adapted, float))


@cache
def white_d50() -> NDArray[np.float64]:
    """CIE XYZ (3,) of D50, Y 1."""
    import colour

    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D50"]
    return np.asarray(colour.xy_to_XYZ(xy), float)


@cache
def xyz_d65_from_d50() -> NDArray[np.float64]:
    """(3, 3) Bradford's adaptation from D50 to D65."""
    import colour

    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    return _bradford(white_d50(), colour.xy_to_XYZ(xy))


def lab_from_xyz_d50(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE Lab (n, 3) relative to D50; below black its straight part goes on."""
    relative = xyz / white_d50()
    rooted = np.cbrt(np.maximum(relative, _EPSILON))
    f = np.where(relative > _EPSILON, rooted, (_KAPPA * relative + 16.0) / 116.0)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def xyz_d50_from_lab(lab: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE XYZ (n, 3) of Lab colours; the inverse of `lab_from_xyz_d50`."""
    y = (lab[..., 0] + 16.0) / 116.0
    f = np.stack([y + lab[..., 1] / 500.0, y, y - lab[..., 2] / 200.0], axis=-1)
    cubed = f**3
    return np.where(cubed > _EPSILON, cubed, (116.0 * f - 16.0) / _KAPPA) * white_d50()


def delta_e2000(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIEDE2000 difference (n,) of Lab colours (n, 3) (CIE 142:2001)."""
    import colour

    return np.asarray(colour.delta_E(one, other, method="CIE 2000"), float)


def _bradford(white: ArrayLike, other: ArrayLike) -> NDArray[np.float64]:
    import colour

    adaptation = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        white, other, transform="Bradford"
    )
    return np.asarray(adaptation, float)
