"""Photographs, lenses and sparse points adjusted together, with the points tied to a surface.

A bundle adjustment in which every point that lies near the surface is pulled onto it along the
surface's normal, robustly. The surface gives the scale, holds the bending that photographs
alone leave free, and fixes the lens. Which points are tied is decided anew in every round.

Source: Pintus and Gobbetti 2015, "A fast and robust framework for semiautomatic and automatic
registration of photographs to 3D geometry"; Triggs et al. 2000, "Bundle adjustment", sections
6 and 7, for the reduced system; the adjustment of scans for the shrinking outlier scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from workbench.formats.colmap import ColmapModel
from workbench.geometry.robust import TUKEY, robust_sigma, tukey_weights
from workbench.geometry.similarity import Similarity
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import from_twist
from workbench.orientation.bundle import Bundle
from workbench.orientation.normal_equations import Linearised

_SHRINK = 0.6
# A surface is not known better than this part of its triangles' edges, however well points
# that have come to lie on it seem to say so.
_FINEST = 0.1
_FIRST_DAMPING = 1e-6
# Motions the surface resists less than this part of the stiffest are left to the step.
_OPEN = 1e-10
# No feature is found better than this, so that no weight grows without bound.
_FINEST_PX = 0.02
# Of the surface's sigma: points that move less in a round stand still.
_STILL = 0.003
# Gaussian residuals: median of the squares, in variances.
_MEDIAN_SQUARE = 0.4549


@dataclass(frozen=True)
class SurfaceAdjustmentOptions:
    """How the joint adjustment goes.

    Attributes
    ----------
    search : how far from the surface a point may lie at first to be tied, in its unit.
    rounds : at most; each finds the nearest places anew and takes one step.
    most_points : those with the longest tracks take part, spread over the photographs.
    tolerance_px : ends when a round moves the images by no more, in the median, nor the points.
    overlap : how many observations share the noise of each pixel; what is said of the cameras'
        uncertainty allows for it.
    """

    search: float
    rounds: int = 60
    most_points: int = 30_000
    tolerance_px: float = 1e-3
    overlap: float = 1.0


@dataclass(frozen=True)
class SurfaceAdjustment:
    """What the joint adjustment found.

    Attributes
    ----------
    model : in the frame of the surface.
    reprojection_sigma_px : robust, per coordinate.
    surface_sigma : robust distance of tied points beyond what triangulation explains.
    tied : points that were held by the surface in the end, of all that took part.
    points : that took part.
    center_sigma : image id → standard deviation of the camera's centre, (3,) in the world.
    rotation_sigma_deg : image id → of its orientation, the worst axis.
    rounds : that were needed.
    converged : False where ``rounds`` ended it.
    condition : of the reduced system, scaled to unit diagonal.
    """

    model: ColmapModel
    reprojection_sigma_px: float
    surface_sigma: float
    tied: int
    points: int
    center_sigma: dict[int, NDArray[np.float64]]
    rotation_sigma_deg: dict[int, float]
    rounds: int
    converged: bool
    condition: float


@dataclass(frozen=True)
class NotAdjusted:
    """Why the surface does not hold the photographs; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class _Ties:
    """Pull of the surface on each point: place, normal, weight per squared unit."""

    places: NDArray[np.float64]
    normals: NDArray[np.float64]
    weight: NDArray[np.float64]
    apart: NDArray[np.float64]


def adjusted_to_surface(
    model: ColmapModel,
    surface: SurfaceRays,
    options: SurfaceAdjustmentOptions,
    progress: Callable[[int], None] = lambda done: None,
    information: Mapping[int, NDArray[np.float64]] | None = None,
) -> SurfaceAdjustment | NotAdjusted:
    """Adjust a model that already lies near its surface.

    Parameters
    ----------
    model : in the surface's frame, with the observations of its points.
    progress : told the round.
    information : how sure each observation is, see `Bundle.of`.
    """
    bundle = Bundle.of(model, options.most_points, information)
    if bundle.problem:
        return NotAdjusted(bundle.problem)
    scale, sigma_surface = options.search, options.search / TUKEY
    damping, converged, round_no = _FIRST_DAMPING, False, 0
    ties = _ties(bundle, surface, scale, sigma_surface)
    sigma_px = robust_sigma(bundle.residuals().ravel())
    for round_no in range(1, options.rounds + 1):
        progress(round_no)
        if (ties.weight > 0).sum() < 12:
            return NotAdjusted("fewer than a dozen points lie near the surface")
        before = bundle
        bundle = _regauged(bundle, ties)
        ties = _ties(bundle, surface, scale, sigma_surface)
        system = bundle.linearised(max(sigma_px, _FINEST_PX))
        bundle, damping, moved_px = _step(bundle, system, ties, damping, max(sigma_px, _FINEST_PX))
        # A change of scale moves no image.
        moved = float(np.median(np.linalg.norm(bundle.points - before.points, axis=1)))
        still = moved_px < options.tolerance_px and moved < _STILL * sigma_surface
        sigma_px = robust_sigma(bundle.residuals().ravel())
        if scale <= TUKEY * sigma_surface and round_no > 3 and still:
            converged = True
            break
        scale *= _SHRINK
        sigma_surface = _surface_sigma(
            bundle, surface, max(sigma_px, _FINEST_PX), scale, sigma_surface
        )
        scale = max(scale, TUKEY * sigma_surface)
        ties = _ties(bundle, surface, scale, sigma_surface)
    return _told(
        bundle, ties, sigma_px, sigma_surface, round_no, converged, max(options.overlap, 1.0)
    )


def _ties(bundle: Bundle, surface: SurfaceRays, scale: float, sigma: float) -> _Ties:
    near = surface.nearest(bundle.points)
    apart = ((bundle.points - near.points) * near.normals).sum(axis=1)
    # Off a border the nearest place is not along the normal: it says less of the point.
    beside = np.linalg.norm(bundle.points - near.points, axis=1)
    weight = tukey_weights(beside, scale / TUKEY) / sigma**2
    return _Ties(near.points, near.normals, weight, apart)


def _regauged(bundle: Bundle, ties: _Ties) -> Bundle:
    """All moved, turned and scaled together towards the surface, which moves no image.

    The step below would creep along this valley: out of it every image is wrong.
    """
    middle = bundle.points.mean(axis=0)
    arms = bundle.points - middle
    rows = np.hstack(
        [np.cross(arms, ties.normals), ties.normals, (arms * ties.normals).sum(axis=1)[:, None]]
    )
    weighted = rows * ties.weight[:, None]
    change = np.linalg.lstsq(rows.T @ weighted, -weighted.T @ ties.apart, rcond=_OPEN)[0]
    rotation = from_twist([*change[:3], 0.0, 0.0, 0.0])[:3, :3]
    factor = float(np.exp(change[6]))
    moved = Similarity(factor, rotation, middle + change[3:6] - factor * rotation @ middle)
    return bundle.transformed(moved)


def _surface_sigma(
    bundle: Bundle, surface: SurfaceRays, sigma_px: float, scale: float, before: float
) -> float:
    """The surface's own share of the distances of freely triangulated points from it."""
    system = bundle.linearised(sigma_px)
    inverse = np.linalg.pinv(system.point_hessian, hermitian=True)
    free = bundle.points - np.einsum("nij,nj->ni", inverse, system.point_gradient)
    near = surface.nearest(free)
    apart = ((free - near.points) * near.normals).sum(axis=1)
    explained = np.einsum("ni,nij,nj->n", near.normals, inverse, near.normals)
    counted = (np.abs(apart) < scale) & np.isfinite(apart) & (explained < scale**2)
    if counted.sum() < 12:
        return before
    apart, explained = apart[counted], explained[counted]
    low, high = _finest(surface), max(float(np.abs(apart).max()), 2.0 * _finest(surface))
    for _ in range(60):
        middle = np.sqrt(low * high)
        if np.median(apart**2 / (explained + middle**2)) > _MEDIAN_SQUARE:
            low = middle
        else:
            high = middle
    return float(np.sqrt(low * high))


def _finest(surface: SurfaceRays) -> float:
    corners = surface.mesh.vertices[surface.mesh.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return _FINEST * float(np.median(edges))


def surface_size(surface: SurfaceRays) -> float:
    """Diagonal of the surface's box."""
    vertices = surface.mesh.vertices
    return float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))


def _step(
    bundle: Bundle, system: Linearised, ties: _Ties, damping: float, sigma_px: float
) -> tuple[Bundle, float, float]:
    """One step that lowers the cost, the next damping, and how far it moved the images."""

    def cost(candidate: Bundle) -> float:
        apart = ((candidate.points - ties.places) * ties.normals).sum(axis=1)
        return candidate.cost(sigma_px, system.weights) + float((ties.weight * apart**2).sum())

    now = cost(bundle)
    point_hessian = system.point_hessian + (
        ties.weight[:, None, None] * ties.normals[:, :, None] * ties.normals[:, None, :]
    )
    point_gradient = system.point_gradient + (ties.weight * ties.apart)[:, None] * ties.normals
    for _ in range(12):
        change = _solved(system, point_hessian, point_gradient, damping)
        if change is not None:
            moved = bundle.moved(*change)
            if cost(moved) <= now * (1 + 1e-12):
                shift = np.linalg.norm(moved.projected() - bundle.projected(), axis=1)
                return moved, max(damping / 10.0, 1e-10), float(np.nanmedian(shift))
        damping *= 10.0
    return bundle, damping, 0.0


def _reduced(
    system: Linearised,
    point_hessian: NDArray[np.float64],
    point_gradient: NDArray[np.float64],
    damping: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The cameras' system with the points eliminated, its right side; the points' inverses."""
    diagonal = np.einsum("nii->ni", point_hessian)
    floor = 1e-12 * max(float(diagonal.max()), 1e-300)
    damped = point_hessian + np.einsum("ni,ij->nij", damping * diagonal + floor, np.eye(3))
    inverse = np.linalg.inv(damped)
    reduced, right = system.without_points(inverse, point_gradient)
    reduced[np.diag_indices_from(reduced)] += damping * np.diag(system.camera_hessian)
    return reduced, right, inverse


def _solved(
    system: Linearised,
    point_hessian: NDArray[np.float64],
    point_gradient: NDArray[np.float64],
    damping: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    reduced, right, inverse = _reduced(system, point_hessian, point_gradient, damping)
    # Metres, radians and pixels side by side: solved in units of their own diagonal.
    unit = 1.0 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    try:
        factor = cho_factor(reduced * unit[:, None] * unit[None, :])
    except LinAlgError:
        return None
    cameras = unit * cho_solve(factor, unit * right)
    back = -point_gradient - (system.coupling @ cameras).reshape(-1, 3)
    return cameras, np.einsum("nij,nj->ni", inverse, back)


def _told(
    bundle: Bundle,
    ties: _Ties,
    sigma_px: float,
    sigma_surface: float,
    rounds: int,
    converged: bool,
    overlap: float,
) -> SurfaceAdjustment | NotAdjusted:
    system = bundle.linearised(max(sigma_px, _FINEST_PX))
    hessian = system.point_hessian + (
        ties.weight[:, None, None] * ties.normals[:, :, None] * ties.normals[:, None, :]
    )
    reduced, _, _ = _reduced(system, hessian, system.point_gradient, 0.0)
    unit = 1.0 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    scaled = reduced * unit[:, None] * unit[None, :]
    values = np.linalg.eigvalsh(scaled)
    if values[0] <= 1e-14 * values[-1]:
        return NotAdjusted("the surface leaves a motion of the photographs open")
    covariance = overlap * np.linalg.inv(scaled) * unit[:, None] * unit[None, :]
    center_sigma, rotation_sigma = bundle.uncertainty(covariance)
    return SurfaceAdjustment(
        bundle.model(),
        sigma_px,
        sigma_surface,
        int((ties.weight > 0).sum()),
        len(bundle.points),
        center_sigma,
        rotation_sigma,
        rounds,
        converged,
        float(values[-1] / values[0]),
    )
