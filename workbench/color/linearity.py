"""Whether a sensor's numbers are proportional to light: a flash at several distances.

Source: Jaspe 2018, 3.4.2 and fig. 3.8: values measured on a white surface against 1/d².
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

_FEWEST = 3
# Nearer together, and any exponent fits.
_LEAST_RATIO = 1.3


@dataclass(frozen=True)
class Linearity:
    """The fit of levels to c / d².

    Attributes
    ----------
    names : (n) frames.
    distances : (n,) metres, or relative to the nearest where only ratios are known.
    metric : whether they are metres.
    levels : (n,) as measured, 1 where the sensor is full.
    factor : c.
    residual : RMS of the levels' relative difference from the fit.
    worst : the largest.
    exponent : of the power of distance that fits best; −2 for a linear sensor.
    """

    names: tuple[str, ...]
    distances: NDArray[np.float64]
    metric: bool
    levels: NDArray[np.float64]
    factor: float
    residual: float
    worst: float
    exponent: float


@dataclass(frozen=True)
class NotChecked:
    """Why linearity could not be checked."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def fitted_linearity(
    frames: dict[str, tuple[float, float]], *, metric: bool
) -> Linearity | NotChecked:
    """The fit of levels against 1/d².

    Parameters
    ----------
    frames : name → distance and level, the level brought to one exposure.
    metric : whether distances are metres; else only their ratios count.
    """
    if len(frames) < _FEWEST:
        return NotChecked(f"{len(frames)} frames at known distances; {_FEWEST} are needed")
    distances, levels = np.array(list(frames.values()), float).T
    if not ((distances > 0).all() and (levels > 0).all()):
        return NotChecked("a distance or a level is zero")
    with np.errstate(over="ignore", under="ignore"):
        strengths = levels * distances**2
    if not ((strengths > 0) & (strengths < np.inf) & (distances < np.inf)).all():
        return NotChecked("a distance or a level is no number that can be")
    if distances.max() < _LEAST_RATIO * distances.min():
        return NotChecked("the frames are all at about the same distance")
    if not metric:
        distances = distances / distances.min()
    # Relative errors count, as do noise and a flash's spread: the mean is taken of c itself.
    factor = float(np.exp(np.mean(np.log(levels * distances**2))))
    apart = levels * distances**2 / factor - 1.0
    exponent = float(np.polyfit(np.log(distances), np.log(levels), 1)[0])
    return Linearity(
        tuple(frames),
        distances,
        metric,
        levels,
        factor,
        float(np.sqrt(np.mean(apart**2))),
        float(np.abs(apart).max()),
        exponent,
    )
