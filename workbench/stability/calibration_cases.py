"""Charts, even targets and flash frames that tell too little to calibrate with."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.color.calibration import calibrated
from workbench.color.chart import PATCHES, patch_middles, reference_xyz_d50
from workbench.color.linearity import NotChecked, fitted_linearity
from workbench.color.patches import ChartPatches, fitness
from workbench.color.spaces import working_space
from workbench.photos.vignetting import FlatFrame, NoVignetting, fitted_vignetting
from workbench.stability.case import Bound, Case, Measured, Refused

_CHART, _FLAT, _LINEAR = "colour calibration", "vignetting", "linearity of the sensor"
# Of a camera whose channels overlap much; the plainer its inverse, the better it is posed.
_CAMERA_FROM_XYZ = np.array([[0.8, 0.3, -0.1], [-0.2, 1.1, 0.1], [0.0, 0.1, 0.8]])


def _chart(
    camera_from_xyz: NDArray[np.float64], level: float = 0.8, noise: float = 0.0
) -> ChartPatches:
    """Patches of the chart as a camera sees them, and as sure as the noise lets them be."""
    rng = np.random.default_rng(0)
    means = level * reference_xyz_d50("after_2014") @ camera_from_xyz.T
    means = means * (1.0 + noise * rng.standard_normal(means.shape))
    return ChartPatches(means, np.full(PATCHES, noise), np.zeros(PATCHES), patch_middles())


def _calibrated(patches: ChartPatches) -> Measured | Refused:
    """The mean CIEDE2000 of patches that were each foretold by the others."""
    unfit = fitness(patches)
    if unfit is not None:
        return Refused(unfit.reason)
    found = calibrated(patches, working_space("rec709"), edition="after_2014")
    return Measured(found.left_out_mean, f"condition {found.condition:.3g}")


def _gray() -> Measured | Refused:
    """A camera without colour: all channels see the same."""
    return _calibrated(_chart(np.tile([0.0, 1.0, 0.0], (3, 1)), noise=1e-6))


def _dead_channel() -> Measured | Refused:
    return _calibrated(_chart(_CAMERA_FROM_XYZ * np.array([[1.0], [1.0], [0.0]])))


def _overlapping() -> Measured | Refused:
    """Channels that differ by a fiftieth, without noise."""
    return _calibrated(_chart(0.02 * _CAMERA_FROM_XYZ + np.tile([0.2, 0.6, 0.1], (3, 1))))


def _broken_chart() -> Measured | Refused:
    patches = _chart(_CAMERA_FROM_XYZ)
    patches.means[7, 1] = np.nan
    return _calibrated(patches)


def _flat(change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Measured | Refused:
    """The light in the corners, of a lens that lets 70 % of it through, after ``change``."""
    rows, columns = 24, 36
    down = (np.arange(rows) + 0.5 - 0.5 * rows)[:, None]
    right = (np.arange(columns) + 0.5 - 0.5 * columns)[None]
    squared = (down**2 + right**2) / (0.25 * (rows**2 + columns**2))
    frame = FlatFrame(change(0.6 * (1.0 - 0.3 * squared)), 0.0, 100 * rows, 100 * columns)
    found = fitted_vignetting(frame, None, flash_fired=False)
    if isinstance(found, NoVignetting):
        return Refused(found.reason)
    return Measured(abs(found.corner - 0.7), f"residual {found.residual:.1e}")


def _one_block(value: float, levels: NDArray[np.float64]) -> NDArray[np.float64]:
    changed = levels.copy()
    changed[3, 4] = value
    return changed


def _frames(distances: tuple[float, ...], exponent: float = -2.0) -> Measured | Refused:
    """The power of distance of a sensor's levels against the one they were made with."""
    frames = {f"frame {k}": (d, 0.5 * d**exponent) for k, d in enumerate(distances)}
    found = fitted_linearity(frames, metric=True)
    if isinstance(found, NotChecked):
        return Refused(found.reason)
    return Measured(abs(found.exponent - exponent), f"residual {found.residual:.2g}")


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
) -> Case:
    return Case(f"calibration/{name}", method, stiff, run, bound, refusal)


_EXACT = Bound(0.01, "ΔE2000", "no noise: what the least squares' stopping rule leaves")

CALIBRATION_CASES = (
    _case("a chart", _CHART, "An ordinary camera without noise, to compare with.",
          lambda: _calibrated(_chart(_CAMERA_FROM_XYZ)), _EXACT),
    _case("overlapping channels", _CHART, "Channels that differ by a fiftieth.", _overlapping,
          _EXACT),
    _case("gray", _CHART, "A camera whose channels are all the same.", _gray,
          refusal="no colours"),
    _case("dead channel", _CHART, "A channel that sees nothing.", _dead_channel,
          refusal="no colours"),
    _case("black", _CHART, "A chart in the dark.",
          lambda: _calibrated(_chart(_CAMERA_FROM_XYZ, 1e-6)), refusal="too dark"),
    _case("NaN", _CHART, "A patch without a number.", _broken_chart,
          refusal="without a number"),
    _case("a flat frame", _FLAT, "An even target without noise, to compare with.",
          partial(_flat, lambda levels: levels), Bound(1e-6, "", "the model's own shape, exactly")),
    _case("dust", _FLAT, "A block of the target at nine tenths of the light.",
          partial(_flat, partial(_one_block, 0.54)),
          Bound(0.003, "", "one of 864 blocks, weighed down to some 1 / 25")),
    _case("black block", _FLAT, "A part of the target without light.",
          partial(_flat, partial(_one_block, 0.0)), refusal="without light"),
    _case("NaN block", _FLAT, "A part of the target without a number.",
          partial(_flat, partial(_one_block, np.nan)), refusal="without light"),
    _case("a gradient", _FLAT, "A target lit from one side, three times as bright there.",
          partial(_flat, lambda levels: levels * np.linspace(0.5, 1.5, 36)),
          refusal="lit from one side"),
    _case("a slight gradient", _FLAT, "A target a fifth brighter on one side.",
          partial(_flat, lambda levels: levels * np.linspace(0.9, 1.1, 36)),
          Bound(0.005, "", "an exponential and a line over that range: a twelfth of 0.2²")),
    _case("distances 1e-3 to 1e3", _LINEAR, "Light over twelve decades.",
          partial(_frames, (1e-3, 1.0, 1e3)), Bound(1e-12, "", "rounding of logarithms")),
    _case("equal distances", _LINEAR, "All frames from nearly the same distance.",
          partial(_frames, (1.0, 1.001, 0.999)), refusal="about the same distance"),
    _case("two frames", _LINEAR, "Fewer frames than tell a power from a factor.",
          partial(_frames, (1.0, 2.0)), refusal="are needed"),
    _case("not linear", _LINEAR, "Levels that fall with another power are told as such.",
          partial(_frames, (1.0, 2.0, 4.0), -1.7), Bound(1e-12, "", "rounding of logarithms")),
)  # fmt: skip
