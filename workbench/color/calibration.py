"""From a chart's patches to a colour matrix: white balance, matrix, and how well it fits.

The matrix is fitted to the published colours by the colour differences that are left (CIE Lab,
each part in CIEDE2000's units), not by differences of light, in which bright patches would have
all the say. A chart is never lit evenly, by a flash least of all: a slope of light across it is
fitted along with the matrix, and is no part of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from workbench.color.chart import (
    NEUTRALS,
    PATCHES,
    Edition,
    in_chart,
    patch_middles,
    patch_names,
    reference_xyz_d50,
)
from workbench.color.patches import ChartPatches
from workbench.color.spaces import WorkingSpace, delta_e2000, lab_from_xyz_d50

MatrixKind = Literal["linear", "root_polynomial"]

_TERMS = {"linear": 3, "root_polynomial": 6}
# The grey patches whose signal is clear of the noise; white may shine.
_BALANCED = NEUTRALS[:5]


@dataclass(frozen=True)
class ColorMatrix:
    """From the camera's linear RGB to linear RGB of a working space.

    Attributes
    ----------
    white_balance : (3,) multipliers that make the chart's greys equal, green 1.
    kind : ``linear``, or the root polynomial of degree 2 (Finlayson et al. 2015), whose colours
        do not change with exposure.
    matrix : (3, 3) or (3, 6); its columns are for r, g, b, √(rg), √(gb), √(br) of the balanced
        camera RGB.
    """

    white_balance: NDArray[np.float64]
    kind: MatrixKind
    matrix: NDArray[np.float64]

    def applied(self, camera: NDArray[np.float32]) -> NDArray[np.float32]:
        """Working RGB (..., 3) float32 of camera RGB (..., 3)."""
        if self.kind == "linear":
            whole = (self.matrix * self.white_balance).astype(np.float32)
            return np.asarray(camera @ whole.T, np.float32)
        balanced = camera * self.white_balance.astype(np.float32)
        return np.asarray(_expanded(balanced, self.kind) @ self.matrix.T.astype(np.float32))

    @property
    def largest(self) -> float:
        """A bound of what any camera RGB in [0, 1] gives, so that nothing need be clipped."""
        terms = _expanded(self.white_balance[None, :], self.kind)[0]
        return float((np.maximum(self.matrix, 0.0) @ terms).max())

    def as_dict(self) -> dict[str, Any]:
        """Plain data; `from_dict` reads it."""
        return {
            "white_balance": self.white_balance.tolist(),
            "kind": self.kind,
            "matrix": self.matrix.tolist(),
        }

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> ColorMatrix:
        """What `as_dict` gave."""
        return cls(np.array(plain["white_balance"]), plain["kind"], np.array(plain["matrix"]))


@dataclass(frozen=True)
class Calibration:
    """A fitted matrix and what is left of the differences.

    Attributes
    ----------
    color : the matrix.
    edition : which of the maker's published colours fit better.
    shading : natural logarithm of the light, per half a chart's width to the right and down.
    delta_e : (24,) CIEDE2000 of every patch; those that were clipped count in no mean.
    left_out_delta_e : (24,) the same, each patch predicted by a fit to all others.
    used : (24,) patches that were fitted.
    measured_lab : (24, 3) CIE Lab relative to D50 of the patches as calibrated.
    condition : of the equations for the matrix, in light: how much errors of the patches may be
        magnified.
    """

    color: ColorMatrix
    edition: Edition
    shading: tuple[float, float]
    delta_e: NDArray[np.float64]
    left_out_delta_e: NDArray[np.float64]
    used: NDArray[np.bool_]
    measured_lab: NDArray[np.float64]
    condition: float

    @property
    def mean(self) -> float:
        """Mean CIEDE2000 over the fitted patches."""
        return float(self.delta_e[self.used].mean())

    @property
    def worst(self) -> float:
        """Largest CIEDE2000 of a fitted patch."""
        return float(self.delta_e[self.used].max())

    @property
    def left_out_mean(self) -> float:
        """Mean CIEDE2000 of patches that the matrix was not fitted to."""
        return float(self.left_out_delta_e[self.used].mean())


def calibrated(
    patches: ChartPatches,
    space: WorkingSpace,
    kind: MatrixKind = "linear",
    edition: Edition | None = None,
) -> Calibration:
    """White balance and colour matrix from a chart.

    Parameters
    ----------
    patches : of a chart that `workbench.color.patches.fitness` has nothing against.
    space : what the matrix shall lead to; 1 there is a perfect white diffuser in the middle of
        the chart.
    kind : of the matrix.
    edition : of the chart; where none is given, the one that fits better.
    """
    if edition is None:
        editions: tuple[Edition, ...] = ("after_2014", "before_2014")
        return min((calibrated(patches, space, kind, e) for e in editions), key=lambda c: c.mean)
    reference = reference_xyz_d50(edition)
    balance = _white_balance(patches, reference)
    fit = _Fit(patches.means * balance, reference, kind)
    solved = fit.solved(patches.usable, fit.start(patches.usable))
    left_out = np.empty(PATCHES)
    for k in range(PATCHES):
        others = patches.usable & (np.arange(PATCHES) != k)
        left_out[k] = fit.delta_e(fit.solved(others, solved))[k]
    matrix, shading = fit.parts(solved)
    in_space = space.rgb_from_xyz_d50 @ matrix
    return Calibration(
        ColorMatrix(balance, kind, in_space),
        edition,
        (float(shading[0]), float(shading[1])),
        fit.delta_e(solved),
        left_out,
        patches.usable,
        fit.lab(solved),
        fit.condition(patches.usable),
    )


def checked_on(calibration: Calibration, patches: ChartPatches, space: WorkingSpace) -> Calibration:
    """How well a calibration foretells another photograph of the chart.

    Only the light on that chart — its level and slope — is fitted anew, for that is no matter
    of colour.
    """
    reference = reference_xyz_d50(calibration.edition)
    rgb = calibration.color.applied(patches.means.astype(np.float32)).astype(np.float64)
    xyz = rgb @ space.xyz_d50_from_rgb.T
    x, y = in_chart(patch_middles()).T
    target = lab_from_xyz_d50(reference)

    def lab(light: NDArray[np.float64]) -> NDArray[np.float64]:
        return lab_from_xyz_d50(xyz * np.exp(-(light[0] + light[1] * x + light[2] * y))[:, None])

    def unexplained(light: NDArray[np.float64]) -> NDArray[np.float64]:
        return _weighted(lab(light), target)[patches.usable].ravel()

    start = np.array([np.log(np.median(xyz[:, 1] / reference[:, 1])), 0.0, 0.0])
    light = least_squares(unexplained, start).x
    apart = delta_e2000(lab(light), target)
    return replace(
        calibration,
        shading=(float(light[1]), float(light[2])),
        delta_e=apart,
        left_out_delta_e=apart,
        used=patches.usable,
        measured_lab=lab(light),
    )


def described(calibration: Calibration) -> list[dict[str, Any]]:
    """Every patch in plain data: name, whether it was fitted, both differences, Lab as found."""
    target = lab_from_xyz_d50(reference_xyz_d50(calibration.edition))
    return [
        {
            "name": name,
            "fitted": bool(calibration.used[k]),
            "delta_e2000": float(calibration.delta_e[k]),
            "left_out_delta_e2000": float(calibration.left_out_delta_e[k]),
            "measured_lab": calibration.measured_lab[k].tolist(),
            "reference_lab": target[k].tolist(),
        }
        for k, name in enumerate(patch_names())
    ]


class _Fit:
    """Matrix and shading as one vector, and what it leaves unexplained."""

    def __init__(
        self, balanced: NDArray[np.float64], reference: NDArray[np.float64], kind: MatrixKind
    ) -> None:
        self._terms = _expanded(balanced, kind)
        self._reference = reference
        self._target = lab_from_xyz_d50(reference)
        self._places = in_chart(patch_middles())

    def start(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The matrix of least squares in light, weighted as the eye does; even light."""
        weight = self._weight(used)
        solved = np.linalg.lstsq(
            weight * self._terms[used], weight * self._reference[used], rcond=None
        )[0]
        return np.concatenate([solved.T.ravel(), np.zeros(2)])

    def condition(self, used: NDArray[np.bool_]) -> float:
        """Of these least squares."""
        return float(np.linalg.cond(self._weight(used) * self._terms[used]))

    def _weight(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        return np.asarray(1.0 / np.sqrt(self._reference[used, 1:2] + 0.01))

    def solved(self, used: NDArray[np.bool_], start: NDArray[np.float64]) -> NDArray[np.float64]:
        """The best parameters for some of the patches."""

        def unexplained(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
            return _weighted(self.lab(parameters), self._target)[used].ravel()

        return np.asarray(least_squares(unexplained, start, method="lm").x)

    def parts(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Matrix (3, terms) to XYZ, and shading (2,)."""
        return parameters[:-2].reshape(3, -1), parameters[-2:]

    def lab(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """CIE Lab (24, 3) of the patches."""
        matrix, shading = self.parts(parameters)
        return lab_from_xyz_d50((self._terms @ matrix.T) * np.exp(-self._places @ shading)[:, None])

    def delta_e(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """CIEDE2000 (24,) of the patches."""
        return delta_e2000(self.lab(parameters), self._target)


def _expanded(balanced: ArrayLike, kind: MatrixKind) -> NDArray[Any]:
    """The terms (..., 3 or 6) of camera RGB (..., 3); what is below black has no root."""
    camera = np.asarray(balanced)
    if kind == "linear":
        return camera
    r, g, b = (np.sqrt(np.maximum(camera[..., k], 0.0)) for k in range(3))
    return np.concatenate([camera, np.stack([r * g, g * b, b * r], axis=-1)], axis=-1)


def _weighted(lab: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differences (n, 3) in lightness, chroma and hue, in CIEDE2000's units at the target."""
    lightness, chroma = target[:, 0], np.hypot(target[:, 1], target[:, 2])
    along = target[:, 1:] / np.maximum(chroma, 1e-9)[:, None]
    apart = lab - target
    middle = (lightness - 50.0) ** 2
    return np.stack(
        [
            apart[:, 0] / (1.0 + 0.015 * middle / np.sqrt(20.0 + middle)),
            (apart[:, 1] * along[:, 0] + apart[:, 2] * along[:, 1]) / (1.0 + 0.045 * chroma),
            (apart[:, 2] * along[:, 0] - apart[:, 1] * along[:, 1]) / (1.0 + 0.015 * chroma),
        ],
        axis=1,
    )


def _white_balance(patches: ChartPatches, reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multipliers (3,) that make the greys equal on average, green 1."""
    greys = [k for k in _BALANCED if patches.usable[k]]
    level = (patches.means[greys] / reference[greys, 1:2]).mean(axis=0)
    return np.asarray(level[1] / level)
