"""Strips of a picture by ray casting: what light falls on each pixel, and the truth about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from workbench.kernels import flash_shading as shading
from workbench.kernels.bounced_light import gathered_light
from workbench.kernels.sample_rays import camera_rays, flash_rays
from workbench.synthetic.flash import Flash
from workbench.synthetic.lens import Lens
from workbench.synthetic.scene import OBJECT, SUPPORT
from workbench.synthetic.subject import Subject

STRIP_ROWS = 128
# Neighbouring pixels whose distances differ by more than this share border on an edge.
_EDGE_DEPTH_SHARE = 0.01
# Shadow rays start this far off the surface, so that no facet shades itself by rounding.
_CLEARANCE_M = 2e-4
_COLUMNS = 15

_Value = TypeVar("_Value", bound=np.generic)


@dataclass(frozen=True)
class View:
    """One camera, its flash and how finely the picture is computed.

    Attributes
    ----------
    lens : intrinsics.
    local_from_camera : 4×4 pose.
    flash : in the local frame.
    exposure : level of a white diffuser that faces the flash at 1 m; 1 is the full scale.
    ambient : (3,) level of a white diffuser under the ambient light.
    sky : level behind all things.
    vertex_light : (n, 3) float32 level of light bounced once, at the subject's vertices.
    oren_nayar : (2,) factors A and B of the diffuse reflection.
    varnish : strength of specular reflection.
    aperture : (2,) radius of the aperture and focused distance, metres; radius 0: all sharp.
    blur_sigma_px : blur of the picture.
    samples, edge_samples : rays per pixel, and further ones at edges.
    seed : of all sampling.
    """

    lens: Lens
    local_from_camera: NDArray[np.float64]
    flash: Flash
    exposure: float
    ambient: NDArray[np.float64]
    sky: float
    vertex_light: NDArray[np.float32] | None
    oren_nayar: NDArray[np.float64]
    varnish: float
    aperture: NDArray[np.float64]
    blur_sigma_px: float
    samples: int
    edge_samples: int
    seed: int


@dataclass(frozen=True)
class Strip:
    """Rows of a picture; all levels before vignetting, 1 is the full scale.

    Attributes
    ----------
    light : (rows, width, 3) scene-linear RGB, blurred by the lens.
    albedo : (rows, width, 3) mean over what the pixel sees; 0 where it sees nothing.
    diffuse : (rows, width, 3) mean light on it, in the level of a white diffuser.
    specular : (rows, width) mean specular level, the same in all channels.
    is_object, is_support : (rows, width) bool, for more than half, at least half of a
        pixel's rays: no pixel is both.
    in_shadow : (rows, width) bool, a seen surface that gets less than half of the flash's
        light.
    """

    light: NDArray[np.float64]
    albedo: NDArray[np.float64]
    diffuse: NDArray[np.float64]
    specular: NDArray[np.float64]
    is_object: NDArray[np.bool_]
    is_support: NDArray[np.bool_]
    in_shadow: NDArray[np.bool_]


def rendered_strip(subject: Subject, view: View, first_row: int, rows: int) -> Strip:
    """Rows ``first_row`` to ``first_row + rows`` of a picture.

    A picture is the same however it is cut into strips: every random choice depends on the
    pixel, and the strip is computed with as many rows around it as the blur reaches.
    """
    halo = int(4.0 * view.blur_sigma_px + 0.5) + 1
    top = max(first_row - halo, 0)
    bottom = min(first_row + rows + halo, view.lens.height)
    width = view.lens.width
    totals = np.zeros(((bottom - top) * width, _COLUMNS))
    counts = np.full(len(totals), view.samples)
    everywhere = top * width + np.arange(len(totals))
    _sample(subject, view, everywhere, np.arange(view.samples), view.samples, totals, top)
    if view.edge_samples:
        shape = (bottom - top, width)
        edges = np.flatnonzero(_borders(totals, view.samples, shape))
        # Samples are mirrored in pairs: a lone central one has used up none of them.
        start = view.samples if view.samples > 1 else 2
        numbers = start + np.arange(view.edge_samples)
        _sample(subject, view, edges + top * width, numbers, 2 + view.edge_samples, totals, top)
        counts[edges] += view.edge_samples
    return _strip(totals, counts, view, (bottom - top, width), first_row - top, rows)


def depths(subject: Subject, view: View) -> NDArray[np.float32]:
    """Depth along the optical axis (rows, width) float32 at pixel centres, infinite for none."""
    width, height = view.lens.width, view.lens.height
    depth = np.full(width * height, np.inf, np.float32)
    forward = view.local_from_camera[:3, 2]
    for first in range(0, len(depth), STRIP_ROWS * width):
        pixels = np.arange(first, min(first + STRIP_ROWS * width, len(depth)))
        rays = _rays(subject, view, pixels, np.zeros(len(pixels), np.int64), 1, pinhole=True)
        hits = subject.seen(rays)
        points, _ = subject.points(hits)
        depth[pixels[hits.rays]] = (points - view.local_from_camera[:3, 3]) @ forward
    return depth.reshape(height, width)


def _rays(
    subject: Subject,
    view: View,
    pixels: NDArray[np.int64],
    samples: NDArray[np.int64],
    count: int,
    pinhole: bool = False,
) -> NDArray[np.float32]:
    lens = view.lens
    intrinsics = np.array([lens.focal_px, *lens.center_px, *lens.coefficients])
    rays: NDArray[np.float32] = camera_rays(
        pixels,
        samples,
        count,
        lens.width,
        intrinsics,
        np.ascontiguousarray(view.local_from_camera[:3, :3]),
        view.local_from_camera[:3, 3] - subject.middle,
        np.zeros(2) if pinhole else view.aperture,
        view.seed,
    )
    return rays


def _sample(
    subject: Subject,
    view: View,
    pixels: NDArray[np.int64],
    numbers: NDArray[np.int64],
    count: int,
    totals: NDArray[np.float64],
    top: int,
) -> None:
    """Add the samples ``numbers`` of each of the pixels (n,) to the totals."""
    pixel = np.repeat(pixels, len(numbers))
    sample = np.tile(numbers, len(pixels))
    rays = _rays(subject, view, pixel, sample, count)
    hits = subject.seen(rays)
    if not len(hits.rays):
        return
    pixel, sample, views = pixel[hits.rays], sample[hits.rays], rays[hits.rays, 3:]
    points, normals = subject.points(hits)
    material = subject.material_of(hits.triangle)
    paint = subject.paint.at(points, material)
    flash = view.flash
    to_flash = flash_rays(
        points - subject.middle,
        normals,
        pixel,
        sample,
        flash.middle - subject.middle,
        flash.across,
        flash.down,
        _CLEARANCE_M,
        view.seed,
    )
    direct = shading.reflected_light(
        normals,
        np.ascontiguousarray(views),
        np.ascontiguousarray(to_flash[:, 3:]),
        paint.gloss * np.float32(view.varnish),
        paint.roughness,
        flash.axis,
        flash.falloff,
        view.oren_nayar,
    )
    # Light that leaks in comes from above: half of it at least reaches every surface.
    other = ((0.5 + 0.5 * normals[:, 2:]) * view.ambient).astype(np.float32)
    if view.vertex_light is not None:
        other += gathered_light(hits.triangle, hits.uv, subject.mesh.triangles, view.vertex_light)
    shading.add_to_pixels(
        pixel - top * view.lens.width,
        material,
        hits.distance,
        paint.albedo,
        direct,
        subject.blocked(to_flash),
        other,
        view.exposure,
        totals,
    )


def _borders(
    totals: NDArray[np.float64], samples: int, shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Pixels (rows · width,) that see several things, or another thing than a neighbour."""
    seen = totals[:, 10:14]
    hits = totals[:, 10:13].sum(axis=1)
    border: NDArray[np.bool_] = ((seen > 0) & (seen < samples)).any(axis=1).reshape(shape)
    # Lit or not, and which material: one number that differs where either does.
    kind = (seen @ [1.0, 2.0, 4.0, 8.0]).reshape(shape)
    depth = (totals[:, 14] / np.maximum(hits, 1.0)).reshape(shape)
    for axis in (0, 1):
        near = np.minimum(*_pairs(depth, axis))
        differs = np.abs(np.diff(depth, axis=axis)) > _EDGE_DEPTH_SHARE * near
        differs &= near > 0.0
        differs |= np.diff(kind, axis=axis) != 0.0
        for side in _pairs(border, axis):
            np.logical_or(side, differs, out=side)
    return border.ravel()


def _pairs(values: NDArray[_Value], axis: int) -> tuple[NDArray[_Value], NDArray[_Value]]:
    """Views of all neighbours along an axis: the former and the latter of each pair."""
    if axis == 0:
        return values[:-1], values[1:]
    return values[:, :-1], values[:, 1:]


def _strip(
    totals: NDArray[np.float64],
    counts: NDArray[np.int64],
    view: View,
    shape: tuple[int, int],
    skip: int,
    rows: int,
) -> Strip:
    seen = totals[:, 10:13].sum(axis=1)
    behind = view.sky * (counts - seen)
    light = ((totals[:, :3] + behind[:, None]) / counts[:, None]).reshape(*shape, 3)
    if view.blur_sigma_px > 0.0:
        for axis in (0, 1):
            light = gaussian_filter1d(light, view.blur_sigma_px, axis=axis, mode="nearest")
    keep = slice(skip, skip + rows)
    hits = np.maximum(seen, 1.0)
    means = (totals[:, 3:10] / hits[:, None]).reshape(*shape, 7)[keep]
    half = 0.5 * counts
    shadow = (seen >= half) & (totals[:, 13] < 0.5 * seen) & (view.flash.power > 0.0)
    return Strip(
        light=light[keep],
        albedo=means[..., :3],
        diffuse=means[..., 3:6],
        specular=means[..., 6],
        is_object=(totals[:, 10 + OBJECT] > half).reshape(shape)[keep],
        is_support=(totals[:, 10 + SUPPORT] >= half).reshape(shape)[keep],
        in_shadow=shadow.reshape(shape)[keep],
    )
