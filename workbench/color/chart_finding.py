"""Where in a photograph a ColorChecker lies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.color.chart import COLS, PATCHES, ROWS, WHITE, patch_middles, reference_xyz_d50
from workbench.color.spaces import lab_from_xyz_d50

# Detection works on small pictures; a chart that is small in the frame needs a larger one.
_LONGER_SIDES_PX = (1000, 2000)
# What people mean by a chart's corners, as left, top, right, bottom in cells: its outermost
# patches', the cells' (also the crosses printed on it), the boards' of two generations.
_OUTLINES = (
    (0.06, 0.06, 5.94, 3.94),
    (0.0, 0.0, 6.0, 4.0),
    (-0.10, -0.20, 6.10, 4.20),
    (-0.25, -0.36, 6.25, 4.36),
)
# Of a patch, on either side of its middle, in cells: where its colour is read, and where it is
# still of one colour when the grid lies right; patches are 0.88 cells wide.
_INNER, _WIDE = 0.25, 0.40
_CELL_CORNERS = np.array([[0.0, 0.0], [COLS, 0.0], [COLS, ROWS], [0.0, ROWS]])
_PX_PER_CELL, _MARGIN_CELLS = 32, 1
# How far a patch is looked for from where the corners put it, round by round, in cells.
_SEARCH_CELLS = (0.34, 0.22, 0.12)
_STRAY_CELLS = 0.05
# Mean colour difference (CIE 1976) after a linear fit: charts stay below 10 in any light, and
# nothing else comes below 20.
_MOST_DELTA_E = 15.0
_CLIPPED_LEVEL, _FEWEST_SOUND = 0.98, 10


@dataclass(frozen=True)
class FoundChart:
    """A chart's place in a photograph.

    Attributes
    ----------
    corners : (4, 2) of its 6 × 4 cells in pixels, right and down, in the order dark skin,
        bluish green, black, white.
    pixel_from_cell : (3, 3) homography.
    by : ``detector`` or ``corners``, that the user gave.
    """

    corners: NDArray[np.float64]
    pixel_from_cell: NDArray[np.float64]
    by: Literal["detector", "corners"]

    def pixels(self, cells: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places (n, 2) in pixels of places (n, 2) in cells."""
        return _mapped(self.pixel_from_cell, cells)

    def scaled(self, factor: float) -> FoundChart:
        """The same in a photograph ``factor`` times as large."""
        return _chart(self.corners * factor, self.by)

    def share_of(self, values: NDArray[np.float32]) -> float:
        """Share of a photograph's lit pixels, in [0, 1], that belong to the chart's board.

        Lit is what is brighter than a tenth of the chart's white.
        """
        height, width = values.shape[:2]
        left, top, right, bottom = _OUTLINES[-1]
        outline = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
        board = np.zeros((height, width), np.uint8)
        cv2.fillConvexPoly(board, np.rint(self.pixels(outline)).astype(np.int32), 1)
        white = float(np.median(_sampled(values, self, _INNER, 5)[WHITE, :, 1]))
        lit = values[..., 1] > 0.1 * white
        return float(lit[board > 0].sum() / max(int(lit.sum()), 1))

    @property
    def width_px(self) -> float:
        """Square root of its area, a measure of its apparent size whatever its tilt, pixels."""
        x, y = self.corners.T
        doubled = np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))
        return float(np.sqrt(abs(0.5 * doubled)))


@dataclass(frozen=True)
class NoChart:
    """Why there is no chart to measure."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


_NOT_FOUND = NoChart("no chart was found")


def found_chart(values: NDArray[np.float32]) -> FoundChart | NoChart:
    """The chart in a photograph, by OpenCV's detector, its grid then laid onto the patches.

    Parameters
    ----------
    values : (h, w, 3) float32 linear RGB, of the camera or any other.
    """
    picture = _encoded(values)
    longer = max(picture.shape[:2])
    for side in _LONGER_SIDES_PX:
        if side > _LONGER_SIDES_PX[0] and longer < 1.2 * _LONGER_SIDES_PX[0]:
            break
        share = min(side / longer, 2.0)
        how = cv2.INTER_AREA if share < 1.0 else cv2.INTER_LINEAR
        small = cv2.resize(picture, None, fx=share, fy=share, interpolation=how)
        corners = _detected(np.asarray(small, np.uint8))
        if corners is not None:
            return _laid(values, corners / share, "detector")
    return _NOT_FOUND


def chart_at(values: NDArray[np.float32], corners: ArrayLike) -> FoundChart | NoChart:
    """The chart whose four corners are given.

    Parameters
    ----------
    values : (h, w, 3) float32 linear RGB.
    corners : (4, 2) pixels, right and down, in turn round the chart: of its board, of the
        crosses printed on it or of its outermost patches, beginning with any.
    """
    return _laid(values, np.asarray(corners, float).reshape(4, 2), "corners")


def _detected(picture: NDArray[np.uint8]) -> NDArray[np.float64] | None:
    """Corners (4, 2) of what OpenCV takes for a chart."""
    cv2.setRNGSeed(0)
    detector: Any = cv2.mcc.CCheckerDetector.create()
    if hasattr(detector, "setColorChartType"):  # since OpenCV 5
        detector.setColorChartType(cv2.mcc.MCC24)
        detector.setUseDnnModel(False)
        found = detector.process(picture, 1)
    else:
        found = detector.process(picture, cv2.mcc.MCC24, 1)
    if not found:
        return None
    return np.asarray(detector.getBestColorChecker().getBox(), float)


def _laid(
    values: NDArray[np.float32], corners: NDArray[np.float64], by: Literal["detector", "corners"]
) -> FoundChart | NoChart:
    """The best of all readings of the corners, then moved to where the patches are even."""
    if not np.isfinite(corners).all() or abs(_area(corners)) < 24 * 9:
        return NoChart("the chart's corners enclose too little")
    root = np.sqrt(np.maximum(values, 0.0))
    readings = [_chart(quad, by) for quad in _readings(corners)]
    best = min(readings, key=lambda chart: _strangeness(values, chart))
    best = _centred(root, best)
    height, width = values.shape[:2]
    middles = best.pixels(patch_middles())
    inside = (middles >= 0).all() and (middles < [width, height]).all()
    if not inside:
        return NoChart("the chart is not wholly in the photograph")
    strange = _strangeness(values, best)
    if by == "corners" and np.isinf(strange):
        return best  # that its patches are clipped will be told of it
    if strange > _MOST_DELTA_E:
        if by == "detector":
            return _NOT_FOUND
        return NoChart("there are no colours of a chart where its corners were given")
    return best


def _readings(corners: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Corners of the cells (4, 2) for each meaning and each beginning of the given ones."""
    around = corners if _area(corners) > 0 else corners[::-1]
    for turn in range(4):
        turned = np.roll(around, -turn, axis=0)
        for left, top, right, bottom in _OUTLINES:
            outline = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
            yield _mapped(_homography(outline, turned), _CELL_CORNERS)


def _centred(root: NDArray[np.float32], chart: FoundChart) -> FoundChart:
    """The grid moved to the patches, each of which is looked for where light is most even."""
    for reach in _SEARCH_CELLS:
        cells, sure = _even_places(root, chart, reach)
        if not sure.any():
            return chart  # nothing but one colour: no chart, as will be found
        target, weight = chart.pixels(cells), sure
        stray = _STRAY_CELLS * chart.width_px / np.sqrt(PATCHES)
        for _ in range(5):  # a patch that strays from what the others say is heard less
            fitted = _homography(patch_middles(), target, weight)
            apart = np.linalg.norm(_mapped(fitted, patch_middles()) - target, axis=1)
            weight = sure / (1.0 + (apart / stray) ** 2)
        moved = _chart(_mapped(fitted, _CELL_CORNERS), chart.by)
        if not 0.5 * chart.width_px < moved.width_px < 2.0 * chart.width_px:
            return chart
        chart = moved
    return chart


def _even_places(
    root: NDArray[np.float32], chart: FoundChart, reach: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where in cells (24, 2) the patches' middles seem to be, and how clearly (24,)."""
    size = _PX_PER_CELL
    shape = ((COLS + 2 * _MARGIN_CELLS) * size, (ROWS + 2 * _MARGIN_CELLS) * size)
    cell_from_px = np.array(
        [[1 / size, 0, -_MARGIN_CELLS], [0, 1 / size, -_MARGIN_CELLS], [0, 0, 1.0]]
    )
    # Pixel centres lie at halves, OpenCV's at whole numbers.
    to_opencv = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    pixel_from_px = to_opencv @ chart.pixel_from_cell @ cell_from_px
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    flat = cv2.warpPerspective(root, pixel_from_px, shape, flags=flags)
    side = 2 * round(_WIDE * size) + 1
    mean, square = (cv2.blur(picture, (side, side)) for picture in (flat, flat * flat))
    uneven = np.sqrt(np.maximum(square - mean * mean, 0.0)).mean(axis=2)
    steps = round(reach * size)
    line = np.arange(-steps, steps + 1)
    places, sure = np.empty((PATCHES, 2)), np.empty(PATCHES)
    for k, middle in enumerate(patch_middles()):
        right, down = np.rint((middle + _MARGIN_CELLS) * size).astype(int)
        around = uneven[down - steps : down + steps + 1, right - steps : right + steps + 1]
        least = float(around.min())
        contrast = float(np.median(around)) - least
        weight = np.exp(-(around - least) / max(0.15 * contrast, 1e-9))
        weight /= weight.sum()
        shift = np.array([(weight.sum(axis=0) * line).sum(), (weight.sum(axis=1) * line).sum()])
        places[k], sure[k] = middle + shift / size, contrast
    return places, sure / max(float(sure.max()), 1e-9)


def _strangeness(values: NDArray[np.float32], chart: FoundChart) -> float:
    """Mean colour difference from the published colours after the best linear fit.

    Of patches that are not clipped; infinite where they are too few to tell.
    """
    seen = _sampled(values, chart, _INNER, 5).mean(axis=1).astype(np.float64)
    sound = seen.max(axis=1) < _CLIPPED_LEVEL
    if sound.sum() < _FEWEST_SOUND:
        return float("inf")
    seen, reference = seen[sound], reference_xyz_d50("after_2014")[sound]
    weight = 1.0 / np.sqrt(reference[:, 1:2] + 0.01)
    solved = np.linalg.lstsq(weight * seen, weight * reference, rcond=None)[0]
    apart = lab_from_xyz_d50(seen @ solved) - lab_from_xyz_d50(reference)
    return float(np.linalg.norm(apart, axis=1).mean())


def _sampled(
    picture: NDArray[np.float32], chart: FoundChart, reach: float, count: int
) -> NDArray[np.float32]:
    """Values (24, count², 3) on a grid in every patch; what is outside repeats the border."""
    line = np.linspace(-reach, reach, count)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    cells = (patch_middles()[:, None, :] + grid).reshape(-1, 2)
    places = (chart.pixels(cells) - 0.5).astype(np.float32)
    none: Any = None  # the second map is not used; OpenCV's stubs do not know that
    seen = cv2.remap(picture, places[None], none, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.float32).reshape(PATCHES, count * count, 3)


def _encoded(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A picture (h, w, BGR) uint8 for the detector: balanced, and bright where anything is."""
    some = values.reshape(-1, 3)[:: max(1, values.size // 600_000)]
    lit = some[some[:, 1] > 0.1 * np.percentile(some[:, 1], 99.5)]
    white = np.maximum(np.percentile(lit if len(lit) else some, 98.0, axis=0), 1e-6)
    level = np.clip(values[..., ::-1] / white[::-1].astype(np.float32), 0.0, 1.0)
    return np.asarray(np.rint(255.0 * level ** (1 / 2.2)), np.uint8)


def _chart(corners: NDArray[np.float64], by: Literal["detector", "corners"]) -> FoundChart:
    return FoundChart(corners, _homography(_CELL_CORNERS, corners), by)


def _homography(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    weight: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """(3, 3) that takes four or more places near to others (Hartley and Zisserman 2004, 4.1)."""
    offset = target.mean(axis=0)
    scale = max(float(np.abs(target - offset).max()), 1e-9)
    rows = []
    for (x, y), (u, v) in zip(source, (target - offset) / scale, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    system = np.array(rows, float)
    if weight is not None:
        system *= np.repeat(weight, 2)[:, None]
    solved = np.linalg.svd(system)[2][-1].reshape(3, 3)
    back = np.array([[scale, 0.0, offset[0]], [0.0, scale, offset[1]], [0.0, 0.0, 1.0]])
    return np.asarray(back @ solved)


def _mapped(homography: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    raised = places @ homography[:, :2].T + homography[:, 2]
    return np.asarray(raised[:, :2] / raised[:, 2:])


def _area(corners: NDArray[np.float64]) -> float:
    """Signed area, positive for corners that go clockwise as seen."""
    x, y = corners.T
    return float(0.5 * (np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))
