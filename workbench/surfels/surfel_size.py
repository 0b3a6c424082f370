"""How large surfels are on screen: by the time a frame takes, and by where one looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError

_FRAMES = 3


@dataclass(frozen=True)
class SizeControl:
    """Keeps a frame rate by the size of surfels (Brandt 2019, 4.3).

    Attributes
    ----------
    target_s : seconds a frame should take.
    smallest_px, largest_px : bounds of the size.
    tolerance : frames that are off by up to this share change nothing, so that nothing flickers.

    Raises
    ------
    SettingsError
        Bounds that contradict each other.
    """

    target_s: float
    smallest_px: float = 1.0
    largest_px: float = 8.0
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        if not (self.target_s > 0.0 and 0.0 < self.smallest_px <= self.largest_px):
            raise SettingsError(
                "The size of surfels cannot be kept within these bounds.",
                expected="a time above 0, and a smallest size up to the largest",
                found=f"{self.target_s} s, {self.smallest_px} to {self.largest_px} px",
                fix="Take e.g. 1 / 60 s, 1 and 8 px.",
            )

    def next_px(self, recent_px: Sequence[float], frame_s: float) -> float:
        """The size for the next frame, pixels.

        Parameters
        ----------
        recent_px
            Sizes of the frames so far, at least one; the last three count.
        frame_s
            Seconds the last of them took.
        """
        old = float(np.mean(recent_px[-_FRAMES:]))
        off = frame_s / self.target_s
        if abs(off - 1.0) > self.tolerance:
            old = 0.25 * (3.0 * old + old * off)
        return min(max(old, self.smallest_px), self.largest_px)


@dataclass(frozen=True)
class FoveaZones:
    """Larger surfels away from where one looks (Brandt 2019, 4.4).

    Attributes
    ----------
    center_px : (2,) where one looks, right and down in the picture.
    radii_px : outer radii of the zones, ascending, the first around the centre.
    factors : what the size of surfels is multiplied with at each radius, at least 1; between
        the radii it runs linearly, beyond the last it stays.

    Raises
    ------
    SettingsError
        Numbers that do not fit together.
    """

    center_px: tuple[float, float]
    radii_px: tuple[float, ...]
    factors: tuple[float, ...]

    def __post_init__(self) -> None:
        ascending = bool((np.diff(self.radii_px) > 0.0).all())
        fitting = len(self.radii_px) == len(self.factors) > 0
        if not fitting or not ascending or min(self.factors) < 1.0:
            raise SettingsError(
                "The zones around the point one looks at do not fit together.",
                expected="ascending radii and as many factors, each 1 or more",
                found=f"{self.radii_px} and {self.factors}",
                fix="Take e.g. (200, 400, 600) and (1, 2, 4).",
            )

    def factor(self, places_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) factors for objects seen at places (n, 2) of the picture."""
        away = np.linalg.norm(np.asarray(places_px) - self.center_px, axis=-1)
        return np.asarray(np.interp(away, self.radii_px, self.factors))
