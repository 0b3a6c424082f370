"""How much less light a lens brings to the corners, from a photograph of an even white target.

Where the flash of the camera lit the target, the target is not lit evenly: a plane before the
camera gets less light off the middle, by distance and incidence. That is no property of the
pixels, and later steps account for it by geometry, so it is taken out of the frame. What is
left — the lens's vignetting and the falloff of the flash's beam, which travels with the camera —
belongs to the pixel, and every photograph is divided by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

_BLOCKS_ALONG_LONGER_SIDE = 36
_LEAST_LEVEL = 0.02
_MOST_CLIPPED = 0.001
# A target with a fold, a shadow or a frame around it leaves more than this.
_MOST_RESIDUAL = 0.02
# A target lit so many times as much on one side is not even: what is left when that is taken out
# passes for the lens's doing.
_MOST_GRADIENT = 2.0


@dataclass(frozen=True)
class Vignetting:
    """Relative light V(r) = 1 + a₁r² + a₂r⁴ + a₃r⁶, r = 1 in the corner.

    Attributes
    ----------
    coefficients : a₁, a₂, a₃.
    residual : relative RMS of what the model does not explain of the frame.
    flash_offset : where the flash stood, right and down, in distances to the target; zero
        where no flash fired.
    """

    coefficients: tuple[float, float, float]
    residual: float
    flash_offset: tuple[float, float] = (0.0, 0.0)

    @property
    def corner(self) -> float:
        """Relative light in the corners, 1 in the middle."""
        return 1.0 + sum(self.coefficients)

    def relative_light(self, height: int, width: int) -> NDArray[np.float32]:
        """V at every pixel of a photograph of that size, (height, width) float32."""
        down = (np.arange(height) + 0.5 - 0.5 * height)[:, None]
        right = (np.arange(width) + 0.5 - 0.5 * width)[None, :]
        squared = (down**2 + right**2) / (0.25 * (height**2 + width**2))
        return _light(squared, self.coefficients).astype(np.float32)

    def at(self, places: ArrayLike, height: int, width: int) -> NDArray[np.float64]:
        """V (n,) at places (n, 2) in pixels, right and down, of a photograph of that size."""
        off = np.asarray(places, float) - 0.5 * np.array([width, height])
        return _light((off**2).sum(axis=1) / (0.25 * (height**2 + width**2)), self.coefficients)


@dataclass(frozen=True)
class NoVignetting:
    """Why nothing was learned of the vignetting."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


@dataclass(frozen=True)
class FlatFrame:
    """An even target's photograph, reduced to blocks.

    Attributes
    ----------
    levels : (rows, cols) mean of all channels, 1 where the sensor is full.
    clipped : share of pixels that are.
    height, width : of the photograph, pixels.
    """

    levels: NDArray[np.float64]
    clipped: float
    height: int
    width: int


def flat_frame(values: NDArray[np.float32], usable: NDArray[np.uint8]) -> FlatFrame:
    """Block means of a photograph (h, w, 3) float32 with its mask of usable pixels."""
    height, width = usable.shape
    side = max(1, max(height, width) // _BLOCKS_ALONG_LONGER_SIDE)
    rows, cols = height // side, width // side
    # Centred, so that the blocks' middles are symmetric about the photograph's.
    top, left = (height - rows * side) // 2, (width - cols * side) // 2
    part = values[top : top + rows * side, left : left + cols * side].mean(axis=2)
    levels = part.reshape(rows, side, cols, side).mean(axis=(1, 3), dtype=np.float64)
    return FlatFrame(levels, float((usable == 0).mean()), height, width)


def fitted_vignetting(
    frame: FlatFrame, focal_length_px: float | None, *, flash_fired: bool
) -> Vignetting | NoVignetting:
    """Vignetting from an even target that faced the camera.

    Parameters
    ----------
    frame : the target's photograph.
    focal_length_px : of that photograph; needed where the flash lit the target.
    flash_fired : whether the camera's flash was its light. Its place beside the lens is found
        along with the vignetting, from the asymmetry of the frame.
    """
    if frame.clipped > _MOST_CLIPPED:
        return NoVignetting(f"the flat frame is clipped in {100 * frame.clipped:.2g} % of its area")
    if not (np.isfinite(frame.levels) & (frame.levels > 0.0)).all():
        return NoVignetting("the flat frame has parts without light, or without a number")
    if float(np.median(frame.levels)) < _LEAST_LEVEL:
        return NoVignetting("the flat frame is too dark")
    if flash_fired and not focal_length_px:
        return NoVignetting(
            "the flat frame was lit by the flash, and its focal length in pixels is not known"
        )
    rows, cols = frame.levels.shape
    side = min(frame.height // rows, frame.width // cols)
    down = ((np.arange(rows) + 0.5 - 0.5 * rows) * side)[:, None] * np.ones(cols)
    right = ((np.arange(cols) + 0.5 - 0.5 * cols) * side)[None, :] * np.ones((rows, 1))
    squared = (down**2 + right**2) / (0.25 * (frame.height**2 + frame.width**2))
    unit = focal_length_px if flash_fired and focal_length_px else float(frame.width)

    def modelled(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        level, a1, a2, a3, x, y = parameters
        shape = level * _light(squared, (a1, a2, a3))
        if flash_fired:
            # cos i / d² on a plane that faces the camera, the flash at (x, y) beside it.
            slope = (right / unit - x) ** 2 + (down / unit - y) ** 2
            return np.asarray(shape * (1.0 + slope) ** -1.5 * (1.0 + x**2 + y**2) ** 1.5)
        return np.asarray(shape * np.exp(x * right / unit + y * down / unit))

    def unexplained(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((modelled(parameters) / frame.levels - 1.0).ravel())

    from scipy.optimize import least_squares

    start = np.array([frame.levels.max(), -0.1, 0.0, 0.0, 0.0, 0.0])
    # Robust, for dust on the target.
    solved = least_squares(unexplained, start, loss="soft_l1", f_scale=0.01)
    _, a1, a2, a3, x, y = (float(value) for value in solved.x)
    residual = float(np.sqrt(np.mean(unexplained(solved.x) ** 2)))
    found = Vignetting((a1, a2, a3), residual, (x, y) if flash_fired else (0.0, 0.0))
    if not flash_fired and np.hypot(x, y) > np.log(_MOST_GRADIENT):
        return NoVignetting(
            f"the flat frame is lit from one side, {np.exp(np.hypot(x, y)):.1f} times as much"
        )
    if residual > _MOST_RESIDUAL:
        return NoVignetting(
            f"the flat frame is uneven by {100 * residual:.1f} % beside its falloff"
        )
    if not 0.05 < found.corner <= 1.1:
        return NoVignetting(
            f"the flat frame would have {100 * found.corner:.0f} % of the light in the corners"
        )
    return found


def _light(
    squared_radius: NDArray[np.float64], coefficients: tuple[float, float, float]
) -> NDArray[np.float64]:
    a1, a2, a3 = coefficients
    return np.asarray(1.0 + squared_radius * (a1 + squared_radius * (a2 + squared_radius * a3)))
