"""Light of a flash that surface points send back to the lens."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def surface_points(
    triangle: NDArray[np.int64],
    uv: NDArray[np.float32],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    corner_normals: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Points (n, 3) float64 and shading normals (n, 3) float32, unit, at hits.

    ``uv`` (n, 2) are the weights of the second and third corner.
    """
    n = len(triangle)
    points = np.empty((n, 3))
    normals = np.empty((n, 3), np.float32)
    for i in range(n):
        t = triangle[i]
        b, c = float(uv[i, 0]), float(uv[i, 1])
        a = 1.0 - b - c
        length = 0.0
        for k in range(3):
            points[i, k] = (
                a * vertices[triangles[t, 0], k]
                + b * vertices[triangles[t, 1], k]
                + c * vertices[triangles[t, 2], k]
            )
            normals[i, k] = (
                a * corner_normals[t, 0, k]
                + b * corner_normals[t, 1, k]
                + c * corner_normals[t, 2, k]
            )
            length += normals[i, k] * normals[i, k]
        length = math.sqrt(max(length, 1e-12))
        for k in range(3):
            normals[i, k] /= length
    return points, normals


@njit(cache=True, nogil=True)
def _oren_nayar(cos_l: float, cos_v: float, cos_between: float, a: float, b: float) -> float:
    """Factor on the Lambertian reflection (Oren and Nayar 1994, qualitative model)."""
    if b <= 0.0:
        return 1.0
    sin_l = math.sqrt(max(1.0 - cos_l * cos_l, 0.0))
    sin_v = math.sqrt(max(1.0 - cos_v * cos_v, 0.0))
    # cos(φ_l − φ_v) · sin θ_l · sin θ_v, without the azimuths themselves.
    product = max(cos_between - cos_l * cos_v, 0.0)
    widest = max(max(cos_l, cos_v), 1e-4)
    if sin_l * sin_v < 1e-9:
        return a
    return a + b * product / widest


@njit(cache=True, nogil=True)
def _ggx(cos_l: float, cos_v: float, cos_h: float, cos_lh: float, alpha: float) -> float:
    """π × BRDF of a GGX lobe with F0 = 0.04 (Walter et al. 2007; Schlick's Fresnel)."""
    a2 = alpha * alpha
    d = cos_h * cos_h * (a2 - 1.0) + 1.0
    shade_l = cos_l + math.sqrt(a2 + (1.0 - a2) * cos_l * cos_l)
    shade_v = cos_v + math.sqrt(a2 + (1.0 - a2) * cos_v * cos_v)
    fresnel = 0.04 + 0.96 * (1.0 - cos_lh) ** 5
    return a2 / (d * d) * fresnel / (shade_l * shade_v)


@njit(cache=True, nogil=True)
def reflected_light(
    normals: NDArray[np.float32],
    views: NDArray[np.float32],
    to_flash: NDArray[np.float32],
    gloss: NDArray[np.float32],
    roughness: NDArray[np.float32],
    axis: NDArray[np.float64],
    falloff: float,
    oren_nayar: NDArray[np.float64],
) -> NDArray[np.float32]:
    """What a flash of unit power gives at every point were nothing in the way: (n, 2).

    Parameters
    ----------
    normals : (n, 3) unit.
    views : (n, 3) unit, from the lens towards the point.
    to_flash : (n, 3) from the point to the flash, metres, not unit.
    gloss, roughness : (n,) of the specular lobe.
    axis : (3,) unit vector along which the flash shines strongest.
    falloff : loss of intensity per squared tangent of the angle to that axis.
    oren_nayar : A and B of the diffuse model; (1, 0) is Lambert.

    Returns
    -------
    Columns: diffuse factor — multiplied by the albedo it is the radiance relative to a white
    diffuser that faces the flash squarely at 1 m — and the specular radiance in that unit.
    """
    out = np.zeros((len(normals), 2), np.float32)
    for i in range(len(normals)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        vx, vy, vz = -views[i, 0], -views[i, 1], -views[i, 2]
        lx, ly, lz = to_flash[i, 0], to_flash[i, 1], to_flash[i, 2]
        distance = math.sqrt(lx * lx + ly * ly + lz * lz)
        lx, ly, lz = lx / distance, ly / distance, lz / distance
        cos_l = nx * lx + ny * ly + nz * lz
        if cos_l <= 0.0:
            continue
        along = -(lx * axis[0] + ly * axis[1] + lz * axis[2])
        if along <= 0.05:
            continue
        tangent2 = (1.0 - along * along) / (along * along)
        light = max(1.0 - falloff * tangent2, 0.05) / (distance * distance)
        cos_v = max(nx * vx + ny * vy + nz * vz, 0.02)
        between = lx * vx + ly * vy + lz * vz
        rough = _oren_nayar(cos_l, cos_v, between, oren_nayar[0], oren_nayar[1])
        out[i, 0] = light * cos_l * rough
        if gloss[i] > 0.0:
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            cos_h = max((nx * hx + ny * hy + nz * hz) / length, 0.0)
            cos_lh = min(max((lx * hx + ly * hy + lz * hz) / length, 0.0), 1.0)
            lobe = _ggx(cos_l, cos_v, cos_h, cos_lh, roughness[i])
            out[i, 1] = gloss[i] * lobe * light * cos_l
    return out


@njit(cache=True, nogil=True)
def add_to_pixels(
    places: NDArray[np.int64],
    kinds: NDArray[np.uint8],
    distance: NDArray[np.float64],
    albedo: NDArray[np.float32],
    direct: NDArray[np.float32],
    hidden: NDArray[np.bool_],
    other: NDArray[np.float32],
    exposure: float,
    totals: NDArray[np.float64],
) -> None:
    """Add samples to the pixels they belong to, in order.

    Parameters
    ----------
    places : (n,) row of ``totals``.
    kinds : (n,) material, counted in one of three columns; 2 stands for all above.
    distance : (n,) metres.
    albedo : (n, 3).
    direct : (n, 2) diffuse factor and specular radiance as `reflected_light` gives them.
    hidden : (n,) no light from the flash arrives.
    other : (n, 3) all other light, as the level of a white diffuser.
    exposure : level that ``direct`` is multiplied by.
    totals : (pixels, 15) radiance (3), albedo (3), diffuse light (3), specular radiance,
        objects, supports, others, lit samples, distance; changed in place.
    """
    for i in range(len(places)):
        row = places[i]
        diffuse, specular = 0.0, 0.0
        if not hidden[i]:
            diffuse, specular = exposure * direct[i, 0], exposure * direct[i, 1]
            if direct[i, 0] > 0.0:
                totals[row, 13] += 1.0
        for k in range(3):
            light = diffuse + other[i, k]
            totals[row, k] += albedo[i, k] * light + specular
            totals[row, 3 + k] += albedo[i, k]
            totals[row, 6 + k] += light
        totals[row, 9] += specular
        totals[row, 10 + min(kinds[i], 2)] += 1.0
        totals[row, 14] += distance[i]
