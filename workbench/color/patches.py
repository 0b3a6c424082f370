"""What a photograph shows of a chart's patches, and whether that is fit to calibrate with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.color.chart import NEUTRALS, PATCHES, WHITE, patch_middles, patch_names
from workbench.color.chart_finding import FoundChart

# Half a patch's middle that is measured, in cells: off the patch's blurred edges.
_REACH_CELLS = 0.27
_LEAST_PIXELS = 20
_TRIMMED = 0.1
# A patch of which more is clipped tells nothing; with more such patches the chart does not.
_CLIPPED_SHARE, _MOST_CLIPPED = 0.01, 3
_LEAST_WHITE = 0.02
_MOST_UNCERTAIN = 0.02
# Of the largest singular value of the patches' colours; that of cameras is some 0.05.
_LEAST_COLOR = 1e-3


@dataclass(frozen=True)
class ChartPatches:
    """The patches of one photograph of a chart.

    Attributes
    ----------
    means : (24, 3) linear RGB of the camera, 1 where the sensor is full.
    uncertain : (24,) relative standard error of the means, the worst of the channels.
    clipped : (24,) share of the measured pixels that are not usable.
    places : (24, 2) middles in pixels, right and down.
    """

    means: NDArray[np.float64]
    uncertain: NDArray[np.float64]
    clipped: NDArray[np.float64]
    places: NDArray[np.float64]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(24,) patches that are not clipped."""
        return np.asarray(self.clipped <= _CLIPPED_SHARE)

    def divided(self, relative_light: NDArray[np.float64]) -> ChartPatches:
        """The same with what each place (24,) gets of the light taken out."""
        means = self.means / relative_light[:, None]
        return ChartPatches(means, self.uncertain, self.clipped, self.places)

    def as_dict(self) -> dict[str, Any]:
        """Plain data; `from_dict` reads it."""
        return {name: getattr(self, name).tolist() for name in self.__dataclass_fields__}

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> ChartPatches:
        """What `as_dict` gave."""
        return cls(**{name: np.array(plain[name], float) for name in cls.__dataclass_fields__})


@dataclass(frozen=True)
class UnfitChart:
    """Why a chart cannot be calibrated with."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def measured_patches(
    values: NDArray[np.float32], usable: NDArray[np.uint8], chart: FoundChart
) -> ChartPatches | UnfitChart:
    """Robust means in the patches' middles.

    Parameters
    ----------
    values : (h, w, 3) float32 linear RGB; of half size, best, where nothing is interpolated.
    usable : (h, w) uint8, 255 where nothing is clipped.
    chart : where the chart lies in this very picture.
    """
    square = _REACH_CELLS * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    means, errors, clipped = np.empty((PATCHES, 3)), np.empty((PATCHES, 3)), np.empty(PATCHES)
    for k, middle in enumerate(patch_middles()):
        seen, fit = _inside(values, usable, chart.pixels(middle + square))
        if len(seen) < _LEAST_PIXELS:
            return UnfitChart(
                f"the chart is too small in the photograph: {len(seen)} pixels in a patch's middle"
            )
        ordered = np.sort(seen, axis=0)
        cut = int(_TRIMMED * len(seen))
        kept = ordered[cut : len(seen) - cut]
        means[k] = kept.mean(axis=0, dtype=np.float64)
        # The spread from the middle two thirds, which strays do not move.
        low, high = np.percentile(seen, [16, 84], axis=0)
        errors[k] = 0.5 * (high - low) / np.sqrt(len(kept))
        clipped[k] = 1.0 - fit
    uncertain = (errors / np.maximum(means, 1e-6)).max(axis=1)
    return ChartPatches(means, uncertain, clipped, chart.pixels(patch_middles()))


def fitness(patches: ChartPatches) -> UnfitChart | None:
    """Why the patches are not fit to calibrate with; None where they are."""
    if not (np.isfinite(patches.means).all() and np.isfinite(patches.uncertain).all()):
        return UnfitChart("the chart has patches without a number: the photograph is broken")
    names = patch_names()
    clipped = np.flatnonzero(~patches.usable)
    if len(clipped):
        told = ", ".join(names[k] for k in clipped)
        if len(clipped) > _MOST_CLIPPED or any(k in NEUTRALS for k in clipped):
            return UnfitChart(f"the chart is clipped ({told}): photograph it with less light")
    white = float(patches.means[WHITE].max())
    if white < _LEAST_WHITE:
        return UnfitChart(
            f"the chart is too dark: its white patch has {100 * white:.2g} % of the sensor's range"
        )
    seen = patches.means[patches.usable]
    spread = np.linalg.svd(seen, compute_uv=False)
    if spread[2] < _LEAST_COLOR * spread[0]:
        return UnfitChart("the chart has no colours: its patches differ in lightness alone")
    neutral = patches.uncertain[list(NEUTRALS[:4])].max()
    if neutral > _MOST_UNCERTAIN:
        return UnfitChart(
            f"the chart is too noisy: its grey patches are uncertain by {100 * neutral:.2g} %"
        )
    return None


def _inside(
    values: NDArray[np.float32], usable: NDArray[np.uint8], polygon: NDArray[np.float64]
) -> tuple[NDArray[np.float32], float]:
    """Pixels (n, 3) inside a polygon and the share of them that is usable."""
    height, width = usable.shape
    left, top = np.maximum(np.floor(polygon.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(polygon.max(axis=0)).astype(int) + 1, [width, height])
    if right <= left or bottom <= top:
        return np.empty((0, 3), np.float32), 0.0
    mask = np.zeros((bottom - top, right - left), np.uint8)
    corners = np.rint(16 * (polygon - [left, top] - 0.5)).astype(np.int32)
    cv2.fillConvexPoly(mask, corners, 1, shift=4)
    chosen = mask > 0
    seen = values[top:bottom, left:right][chosen]
    fit = usable[top:bottom, left:right][chosen] == 255
    return seen, float(fit.mean()) if len(fit) else 0.0
