"""What tells materials apart in a range map, and a picture of it for people.

The reflectance where there is one, else the luminance of the colour, else how rough the
surface is.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.rangemap import RangeMap
from workbench.masking.grid_surface import GridSurface, grid_image, grid_of, grid_surface

Signal = Literal["reflectance", "luminance", "roughness"]
Span = tuple[float, float]

# Of the samples, so that a few glints do not squeeze all others into the lowest levels.
_ROBUST_PERCENT = (0.1, 99.9)
# Roughness in sample spacings; noise of a tenth of the spacing is rough already.
_FIXED_SPANS: dict[Signal, Span] = {"luminance": (0.0, 1.0), "roughness": (0.0, 0.4)}
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_GAMMA = 2.2
# Below a brightness of 10 in 255 the digits are coarser than hues.
_DARKEST_TOTAL = 30.0


def reflectance_span(scans: Iterable[RangeMap]) -> Span:
    """Low and high of the instrument's units over scans, for quantising all of them alike.

    The ends hold all but a thousandth of each scan's samples.

    Raises
    ------
    InputError : no scan has a finite reflectance.
    """
    ends = []
    for scan in scans:
        if scan.reflectance is not None:
            finite = scan.reflectance[np.isfinite(scan.reflectance)]
            if len(finite):
                ends.append(np.percentile(finite.astype(np.float64), _ROBUST_PERCENT))
    if not ends:
        raise InputError("no scan has a reflectance")
    low, high = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))
    return low, high if high > low else low + 1.0


def common_signal(scans: Iterable[RangeMap]) -> Signal:
    """The best signal that all scans have."""
    every = list(scans)
    if every and all(scan.reflectance is not None for scan in every):
        return "reflectance"
    if every and all(scan.color is not None for scan in every):
        return "luminance"
    return "roughness"


def span_of(signal: Signal, scans: Iterable[RangeMap]) -> Span:
    """Low and high of a signal: measured for the reflectance, else fixed."""
    return reflectance_span(scans) if signal == "reflectance" else _FIXED_SPANS[signal]


def sample_signal(scan: RangeMap, surface: GridSurface, signal: Signal) -> NDArray[np.float64]:
    """The signal (n,) float64 of every sample; NaN where unknown.

    The reflectance in the instrument's units, the linear luminance in [0, 1], or the
    roughness in sample spacings.

    Raises
    ------
    InputError : the scan does not have it.
    """
    if signal == "roughness":
        return surface.roughness
    if signal == "reflectance" and scan.reflectance is not None:
        return scan.reflectance.astype(np.float64)
    if signal == "luminance" and scan.color is not None:
        return np.asarray((scan.color / 255.0) ** _GAMMA @ _LUMA, np.float64)
    missing = "reflectance" if signal == "reflectance" else "colour"
    raise InputError(
        f"the scan {scan.name} has no {missing}, but the scans to learn from have",
        fix="mask one of the scans without it, too, and mask them by themselves",
    )


def chroma_bins(
    color: NDArray[np.uint8], levels: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Flat bin (n,) of r and g of r + g + b = 1, and whether a colour is bright enough for it.

    Parameters
    ----------
    color : (n, 3) uint8 sRGB, whose shading does not matter so.
    levels : of each of the two, between 0 and two thirds: hardly any surface is purer.
    """
    total = color.sum(axis=1, dtype=np.float64)
    known = total >= _DARKEST_TOTAL
    part = color[:, :2] / np.maximum(total, 1.0)[:, None]
    level = np.minimum(part * 1.5 * levels, levels - 1).astype(np.int64)
    return level[:, 0] * levels + level[:, 1], known


def range_map_picture(scan: RangeMap, span: Span | None = None) -> NDArray[np.uint8]:
    """A range map as people look at it, one pixel per cell of the grid.

    Parameters
    ----------
    span : reflectances that become black and white; by default the scan's own
        (``reflectance_span``). Of several scans with one span, equal greys are equal
        reflectances.

    Returns
    -------
    (rows, cols, 3) uint8 sRGB: the reflectance, lightened in the shadows; else the colour;
    else a shading as if lit from the scanner, or from above where its place is unknown.
    Cells without a sample are black.

    Raises
    ------
    InputError : the scan has no grid.
    """
    grid_of(scan)
    if scan.reflectance is None and scan.color is not None:
        return np.asarray(grid_image(scan, scan.color, 0), np.uint8)
    if scan.reflectance is not None:
        low, high = span or _own_span(scan)
        shown = np.clip((scan.reflectance.astype(np.float64) - low) / (high - low), 0.0, 1.0)
    else:
        surface = grid_surface(scan)
        lit = np.abs(surface.normals[:, 2])
        shown = np.where(np.isfinite(surface.incidence_cos), surface.incidence_cos, lit)
    grey = np.round(255.0 * np.nan_to_num(shown) ** (1.0 / _GAMMA)).astype(np.uint8)
    return np.asarray(grid_image(scan, np.repeat(grey[:, None], 3, axis=1), 0), np.uint8)


def _own_span(scan: RangeMap) -> Span:
    known = scan.reflectance is not None and bool(np.isfinite(scan.reflectance).any())
    return reflectance_span([scan]) if known else (0.0, 1.0)
