"""How far the recovered colours are from the albedo that a simulation painted.

Differences are CIEDE2000 between CIE Lab colours relative to D65, the white of Rec. 709, in
which a perfect white diffuser has L* 100.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.color.spaces import (
    SpaceName,
    delta_e2000,
    lab_from_xyz_d50,
    white_d50,
    working_space,
    xyz_d65_from_d50,
)
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.surface.provenance import INPAINTED, PHOTOGRAPHED
from workbench.verification.distances import distance_to_surface, vertex_areas

_AT_ONCE = 1 << 18
# A vertex has the mean of the true surface around it where so much of its area is spoken for.
_LEAST_SAID = 0.5
# A level is matched on so many colours: more change it in no digit that is shown.
_MATCHED_ON = 20_000
# The level is looked for within a factor of e^±2 about the one that agrees in the median.
_MATCHING_REACH, _MATCHING_TOLERANCE = 2.0, 1e-4


@dataclass(frozen=True)
class ColorDifference:
    """Colours of a surface against the truth.

    Attributes
    ----------
    delta_e : (n,) float64 ΔE2000 per vertex; NaN where nothing was compared.
    factor : what the colours were multiplied by.
    """

    delta_e: NDArray[np.float64]
    factor: float

    @property
    def count(self) -> int:
        """Vertices compared."""
        return int(np.isfinite(self.delta_e).sum())

    @property
    def mean(self) -> float:
        """Mean; NaN where nothing was compared."""
        return float(np.nanmean(self.delta_e)) if self.count else float("nan")

    def percentile(self, percent: float) -> float:
        """A percentile; NaN where nothing was compared."""
        return float(np.nanpercentile(self.delta_e, percent)) if self.count else float("nan")


@dataclass(frozen=True)
class AlbedoComparison:
    """Recovered colours and what they would be with less of the correction, against the truth.

    All but ``inpainted`` are on the same vertices: those that photographs tell in each of the
    blends, and in even light. All but ``inpainted`` and ``of_paint`` are against the albedo as
    photographs would tell it in even light.

    Attributes
    ----------
    truth : (n, 3) true albedo of what a vertex stands for, linear Rec. 709.
    corrected : the colours as they are, their level not touched.
    corrected_matched : at the best of one common factor.
    uncorrected, distance_only : blends of the photographs as taken, and with the light's
        distance alone taken out, each at the best of one common factor; None without a flash
        to correct.
    of_paint : the colours as they are, against ``truth``: with what the photographs do not
        resolve.
    inpainted : the colours that were spread, as they are, against ``truth``.
    """

    truth: NDArray[np.float64]
    corrected: ColorDifference
    corrected_matched: ColorDifference
    uncorrected: ColorDifference | None
    distance_only: ColorDifference | None
    of_paint: ColorDifference
    inpainted: ColorDifference

    def metrics(self) -> list[Metric]:
        """Differences of the corrected colours, and of the others to compare with."""
        metrics = [
            Metric("albedo_delta_e_mean", self.corrected.mean, "ΔE2000",
                   "Mean ΔE2000 of photographed vertices from the albedo as photographs would "
                   "tell it in even light, level and all."),
            Metric("albedo_delta_e_median", self.corrected.percentile(50.0), "ΔE2000",
                   "The median of the same."),
            Metric("albedo_delta_e_paint_mean", self.of_paint.mean, "ΔE2000",
                   "Mean ΔE2000 of photographed vertices from the paint around them, with what "
                   "photographs do not resolve."),
        ]  # fmt: skip
        if self.uncorrected is not None:
            metrics.append(
                Metric("albedo_delta_e_uncorrected_mean", self.uncorrected.mean, "ΔE2000",
                       "The mean of photographs blended as taken, their level matched.")
            )  # fmt: skip
        if self.distance_only is not None:
            metrics.append(
                Metric("albedo_delta_e_distance_only_mean", self.distance_only.mean, "ΔE2000",
                       "The mean where only the flash's distance is taken out, level matched.")
            )  # fmt: skip
        if self.inpainted.count:
            metrics.append(
                Metric("albedo_delta_e_inpainted_mean", self.inpainted.mean, "ΔE2000",
                       "Mean ΔE2000 of inpainted vertices from the true albedo.")
            )  # fmt: skip
        return metrics


def true_albedo_of(
    surface: TriangleMesh, truth: TriangleMesh, albedo: NDArray[np.floating]
) -> NDArray[np.float64]:
    """True albedo (n, 3) of what each vertex of a surface stands for.

    Every vertex of the true surface speaks for its area at the nearest place of the other: what
    lies within a triangle is shared among its corners as colours are blended there. A vertex
    that too little speaks for, because the truth is coarser or was filled otherwise, has the
    albedo at the nearest place of the true surface.

    Parameters
    ----------
    surface : with n vertices.
    truth : true surface in the same frame; vertices of no triangle do not count.
    albedo : (m, 3) linear, at its vertices.

    Raises
    ------
    InputError : the albedo is not that of the surface's vertices.
    """
    if albedo.shape != truth.vertices.shape:
        raise InputError(
            "the true albedo does not belong to the true surface",
            expected=f"{len(truth.vertices)} vertices",
            found=f"{len(albedo)}",
            fix="simulate the project again",
        )
    areas = vertex_areas(truth)
    used = np.flatnonzero(areas > 0.0)
    found = distance_to_surface(truth.vertices[used], surface)
    n = len(surface.vertices)
    total, sums = np.zeros(n), np.zeros((n, 3))
    for corner in range(3):
        at = surface.triangles[found.triangle, corner]
        say = areas[used] * found.barycentric[:, corner]
        total += np.bincount(at, say, n)
        for channel in range(3):
            sums[:, channel] += np.bincount(at, say * albedo[used, channel], n)
    enough = total > _LEAST_SAID * vertex_areas(surface)
    mean = sums / np.where(enough, total, 1.0)[:, None]
    nearest = distance_to_surface(surface.vertices[~enough], truth)
    there = albedo[truth.triangles[nearest.triangle]].astype(np.float64)
    mean[~enough] = np.einsum("ij,ijk->ik", nearest.barycentric, there)
    return mean


def compared_albedo(
    colors: NDArray[np.floating],
    provenance: NDArray[np.uint8],
    space: SpaceName,
    truth: NDArray[np.float64],
    uncorrected: NDArray[np.float64] | None = None,
    distance_only: NDArray[np.float64] | None = None,
    even_light: NDArray[np.float64] | None = None,
) -> AlbedoComparison:
    """Hold colours of vertices against their true albedo.

    Parameters
    ----------
    colors : (n, 3) linear in ``space``.
    provenance : (n,) of the colours, as `workbench.surface.provenance` numbers it.
    truth : (n, 3) linear Rec. 709 of what a vertex stands for.
    uncorrected, distance_only : (n, 3) other blends, NaN where photographs tell nothing.
    even_light : (n, 3) linear Rec. 709, what photographs would tell in even light, NaN alike;
        ``truth`` where it is not known.
    """
    shown = truth if even_light is None else even_light
    others = [blend for blend in (uncorrected, distance_only, even_light) if blend is not None]
    told = provenance == PHOTOGRAPHED
    for blend in others:
        told &= np.isfinite(blend).all(axis=1)

    def matched(blend: NDArray[np.floating] | None) -> ColorDifference | None:
        return None if blend is None else matched_difference(blend, space, shown, told)

    return AlbedoComparison(
        truth,
        color_difference(colors, space, shown, told),
        matched_difference(colors, space, shown, told),
        matched(uncorrected),
        matched(distance_only),
        color_difference(colors, space, truth, told),
        color_difference(colors, space, truth, provenance == INPAINTED),
    )


def color_difference(
    colors: NDArray[np.floating],
    space: SpaceName,
    truth: NDArray[np.float64],
    which: NDArray[np.bool_],
    factor: float = 1.0,
) -> ColorDifference:
    """ΔE2000 of some vertices.

    Parameters
    ----------
    colors : (n, 3) linear in ``space``.
    truth : (n, 3) linear Rec. 709.
    which : (n,) vertices to compare.
    factor : that the colours are multiplied by.
    """
    delta_e, chosen = np.full(len(colors), np.nan), np.flatnonzero(which)
    for start in range(0, len(chosen), _AT_ONCE):
        part = chosen[start : start + _AT_ONCE]
        delta_e[part] = delta_e2000(
            lab_d65(factor * colors[part].astype(np.float64), space), lab_d65(truth[part], "rec709")
        )
    return ColorDifference(delta_e, factor)


def matched_difference(
    colors: NDArray[np.floating],
    space: SpaceName,
    truth: NDArray[np.float64],
    which: NDArray[np.bool_],
) -> ColorDifference:
    """The same at that common factor of the colours which makes the mean difference least."""
    chosen = np.flatnonzero(which)
    if not len(chosen):
        return color_difference(colors, space, truth, which)
    from scipy.optimize import minimize_scalar

    some = chosen[:: max(1, len(chosen) // _MATCHED_ON)]
    every = np.ones(len(some), bool)
    levels = np.maximum(colors[some].mean(axis=1), 1e-6)
    start = float(np.median(np.log(np.maximum(truth[some].mean(axis=1), 1e-6) / levels)))

    def mean_at(log_factor: float) -> float:
        factor = float(np.exp(log_factor))
        return color_difference(colors[some], space, truth[some], every, factor).mean

    reach = (start - _MATCHING_REACH, start + _MATCHING_REACH)
    best = minimize_scalar(
        mean_at, bounds=reach, method="bounded", options={"xatol": _MATCHING_TOLERANCE}
    )
    return color_difference(colors, space, truth, which, float(np.exp(best.x)))


def lab_d65(colors: NDArray[np.float64], space: SpaceName) -> NDArray[np.float64]:
    """CIE Lab (n, 3) relative to D65 of linear colours (n, 3)."""
    xyz_d65_from_rgb = xyz_d65_from_d50() @ working_space(space).xyz_d50_from_rgb
    # Lab knows colours by their ratio to the white alone.
    relative = colors @ xyz_d65_from_rgb.T / xyz_d65_from_rgb.sum(axis=1)
    return lab_from_xyz_d50(relative * white_d50())
