"""An organised range scanner: rays, footprints, mixed pixels, dropouts and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.kernels.beam_footprint import footprint_echoes
from workbench.synthetic.options import ScannerOptions
from workbench.synthetic.raycasting import Hits
from workbench.synthetic.scene import Scene

_RAYS_PER_BATCH = 150_000


@dataclass(frozen=True)
class Samples:
    """What one scan measured and the truth about every sample; n samples, scan order.

    Attributes
    ----------
    pixel : (n,) int64 index into the flattened grid (row by row).
    points_in_scan : (n, 3) float64 measured points, on the nominal rays.
    reflectance : (n,) float32 measured reflectance × cosine of incidence, not negative.
    material : (n,) uint8 of the surface that was hit.
    true_points_in_scan : (n, 3) float64 where the beam truly met the surface. For a mixed
        pixel: the hit of the one sub-ray that stands for it.
    true_range_m : (n,) float64 noise-free range; for a mixed pixel the mean over the footprint.
    near_range_m, far_range_m : (n,) float64 ends of the echo within the footprint.
    depth_sigma_m : (n,) float64 standard deviation that the range noise was drawn with.
    is_mixed : (n,) bool, the footprint lay across a depth step.
    is_stray : (n,) bool, a random range before the surface.
    """

    pixel: NDArray[np.int64]
    points_in_scan: NDArray[np.float64]
    reflectance: NDArray[np.float32]
    material: NDArray[np.uint8]
    true_points_in_scan: NDArray[np.float64]
    true_range_m: NDArray[np.float64]
    near_range_m: NDArray[np.float64]
    far_range_m: NDArray[np.float64]
    depth_sigma_m: NDArray[np.float64]
    is_mixed: NDArray[np.bool_]
    is_stray: NDArray[np.bool_]


def ray_directions(options: ScannerOptions) -> NDArray[np.float64]:
    """Unit directions (rows · cols, 3) in the scan frame (x right, y down, z forward)."""
    vertical = np.radians(options.vertical_fov_deg)
    horizontal = np.radians(options.horizontal_fov_deg)
    down = (np.arange(options.rows) + 0.5) / options.rows - 0.5
    right = (np.arange(options.cols) + 0.5) / options.cols - 0.5
    if options.projection == "perspective":
        v, u = np.meshgrid(
            2 * np.tan(0.5 * vertical) * down, 2 * np.tan(0.5 * horizontal) * right, indexing="ij"
        )
        directions = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    else:
        pitch, yaw = np.meshgrid(vertical * down, horizontal * right, indexing="ij")
        directions = np.stack(
            [np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)], axis=-1
        ).reshape(-1, 3)
    unit: NDArray[np.float64] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return unit


def dropout_probability(
    incidence_deg: NDArray[np.float64], signal: NDArray[np.float64], options: ScannerOptions
) -> NDArray[np.float64]:
    """Probability (n,) that a sample is lost to grazing incidence or to too dark a surface.

    Parameters
    ----------
    incidence_deg : (n,) angle between beam and surface normal, 0 to 90.
    signal : (n,) reflectance × cosine of incidence.
    options : the start and the end of both ramps.
    """
    ramp = (incidence_deg - options.grazing_start_deg) / (90.0 - options.grazing_start_deg)
    grazing = options.grazing_dropout * np.clip(ramp, 0.0, 1.0)
    dark = np.zeros_like(grazing)
    if options.dark_signal > 0.0:
        dark = options.dark_dropout * np.clip(1.0 - signal / options.dark_signal, 0.0, 1.0)
    return 1.0 - (1.0 - grazing) * (1.0 - dark)


def scan_samples(
    scene: Scene,
    local_from_scan: NDArray[np.float64],
    options: ScannerOptions,
    rng: np.random.Generator,
) -> Samples:
    """Scan a scene from one station.

    Parameters
    ----------
    scene : the true surface.
    local_from_scan : 4×4 true pose in the scene's local frame.
    options : the scanner and its faults.
    rng : all randomness of this scan; as many numbers are drawn for a ray that misses as for
        one that hits, so a change of the surface does not change the noise elsewhere.
    """
    nominal = ray_directions(options)
    jitter = options.angular_jitter_rad * rng.standard_normal((len(nominal), 2))
    draws = rng.random((len(nominal), 3))
    noise = rng.standard_normal((len(nominal), 3))
    parts = [
        _measured(
            scene, local_from_scan, options, nominal[rows], jitter[rows], draws[rows], noise[rows]
        )
        for rows in (
            slice(first, first + _RAYS_PER_BATCH)
            for first in range(0, len(nominal), _RAYS_PER_BATCH)
        )
    ]
    starts = np.arange(0, len(nominal), _RAYS_PER_BATCH)
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Samples.__dataclass_fields__
        if name != "pixel"
    }
    pixel = np.concatenate([part.pixel + start for part, start in zip(parts, starts, strict=True)])
    return Samples(pixel=pixel, **columns)


def _measured(
    scene: Scene,
    local_from_scan: NDArray[np.float64],
    options: ScannerOptions,
    nominal: NDArray[np.float64],
    jitter: NDArray[np.float64],
    draws: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> Samples:
    """The samples of one batch of rays; pixels count from the start of the batch."""
    beams, weight = _footprints(nominal, jitter, options)
    n, k, _ = beams.shape
    hits = scene.caster.cast(
        local_from_scan[:3, 3], transforms.rotate(local_from_scan, beams.reshape(-1, 3))
    )
    signal = (scene.reflectance_at(hits) * hits.cosine).reshape(n, k)
    energy = signal * weight
    reported, near, far, chosen, mixed = footprint_echoes(
        hits.distance.reshape(n, k),
        energy,
        _slope_spread(hits, options).reshape(n, k),
        options.mixed_step_min_m,
        options.mixed_step_max_m,
    )
    pick = np.arange(n) * k + np.maximum(chosen, 0)
    one = Hits(hits.distance[pick], hits.triangle[pick], hits.barycentric[pick], hits.cosine[pick])
    share = (np.isfinite(hits.distance.reshape(n, k)) * weight).sum(axis=1) / weight.sum()
    incidence = np.degrees(np.arccos(np.clip(one.cosine, 0.0, 1.0)))
    picked_signal = scene.reflectance_at(one) * one.cosine
    kept = (
        (chosen >= 0)
        & (share >= options.min_return_share)
        & (reported >= options.min_range_m)
        & (reported <= options.max_range_m)
        & (draws[:, 0] >= dropout_probability(incidence, picked_signal, options))
    )
    sigma = options.depth_sigma_m * (reported / options.reference_distance_m) ** 2
    measured = reported + sigma * noise[:, 0]
    stray = draws[:, 1] < options.stray_probability
    before = options.min_range_m + draws[:, 2] * (near - options.min_range_m)
    measured = np.where(stray, before, measured)
    echo_signal = np.where(mixed, energy.sum(axis=1) / weight.sum(), picked_signal)
    reflectance = echo_signal * (1 + options.reflectance_sigma * noise[:, 1])
    reflectance += options.reflectance_floor_sigma * noise[:, 2]
    picked_beam = beams.reshape(-1, 3)[pick]
    return Samples(
        pixel=np.flatnonzero(kept),
        points_in_scan=(nominal * measured[:, None])[kept],
        reflectance=np.maximum(reflectance, 0.0)[kept].astype(np.float32),
        material=scene.material_of(one.triangle)[kept],
        true_points_in_scan=picked_beam[kept] * one.distance[kept, None],
        true_range_m=reported[kept],
        near_range_m=near[kept],
        far_range_m=far[kept],
        depth_sigma_m=sigma[kept],
        is_mixed=mixed[kept],
        is_stray=stray[kept],
    )


def _slope_spread(hits: Hits, options: ScannerOptions) -> NDArray[np.float64]:
    """How far (n,) the ranges of one footprint spread on a plane as steep as each hit's."""
    tangent = np.sqrt(np.maximum(1.0 - hits.cosine**2, 0.0)) / np.maximum(hits.cosine, 1e-3)
    distance = np.where(np.isfinite(hits.distance), hits.distance, 0.0)
    return options.beam_divergence_rad * tangent * distance


def _footprints(
    nominal: NDArray[np.float64], jitter: NDArray[np.float64], options: ScannerOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit sub-rays (n, k, 3), the beam's axis first, and their weights (k,).

    The sub-rays fill the footprint in a sunflower pattern, with the weights of a Gaussian
    beam whose 1/e² radius is the footprint's.
    """
    count = options.footprint_rays if options.beam_divergence_rad > 0 else 1
    place = np.arange(count)
    radius = np.sqrt(place / max(count - 1, 1))
    angle = place * np.pi * (3.0 - 5.0**0.5)
    spread = 0.5 * options.beam_divergence_rad * radius
    offsets = np.stack([spread * np.cos(angle), spread * np.sin(angle)], axis=1)
    across = np.cross(nominal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    upward = np.cross(across, nominal)
    tilt = jitter[:, None, :] + offsets[None]
    beams = nominal[:, None, :] + tilt[..., :1] * across[:, None] + tilt[..., 1:] * upward[:, None]
    beams /= np.linalg.norm(beams, axis=2, keepdims=True)
    return beams, np.exp(-2.0 * radius**2)
