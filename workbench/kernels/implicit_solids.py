"""Signed distances to a carved solid: blended primitives, cuts, weathering and tool marks.

A solid is a table of primitives, one row each, in groups. Rows of one chain are joined
sharply, so that a chain of cones shows no beads; within a group chains are blended in table
order; groups are blended in order of their number; the last group cuts.

Columns of a row:
    0 kind, 1 group, 2 operation, 3 blend radius,
    kind ROUND_CONE: 4:7 and 7:10 the end points, 10 and 11 their radii;
    kinds ELLIPSOID and ROUNDED_BOX: 4:7 the centre, 7:10 the half sizes, 10 the edge radius
    (box), 12:21 the rotation into the primitive's axes, row by row,
    21 the chain; rows of one chain follow each other and share columns 1 to 3,
    22 the reach: how far from the surface the row can still shape it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.gradient_noise import gradient_noise, pit_depth

ROUND_CONE, ELLIPSOID, ROUNDED_BOX = 0, 1, 2
UNION, SUBTRACT = 0, 1
ROW_LENGTH = 23
CHAIN_COLUMN, REACH_COLUMN = 21, 22
GROUPS = 7
CUT_GROUP = GROUPS - 1
FAR = 1.0e3
# Roughness, pits, chisel marks and cracks together move the surface by less.
WEATHERING_M = 0.009

# Columns of a detail row, one row per group.
ROUGHNESS, PITTING, CHISEL = 0, 1, 2


@njit(cache=True, nogil=True)
def _round_cone(table: NDArray[np.float64], n: int, x: float, y: float, z: float) -> float:
    """Exact distance to the hull of two balls (Quilez, "Distance functions", round cone)."""
    ax: float = table[n, 4]
    ay: float = table[n, 5]
    az: float = table[n, 6]
    r1: float = table[n, 10]
    r2: float = table[n, 11]
    bx: float = table[n, 7] - ax
    by: float = table[n, 8] - ay
    bz: float = table[n, 9] - az
    px, py, pz = x - ax, y - ay, z - az
    l2 = bx * bx + by * by + bz * bz
    rr = r1 - r2
    a2 = l2 - rr * rr
    if a2 <= 1e-12:
        if r1 < r2:
            px, py, pz, r1 = px - bx, py - by, pz - bz, r2
        return math.sqrt(px * px + py * py + pz * pz) - r1
    il2 = 1.0 / l2
    v = px * bx + py * by + pz * bz
    w = v - l2
    qx, qy, qz = px * l2 - bx * v, py * l2 - by * v, pz * l2 - bz * v
    x2 = qx * qx + qy * qy + qz * qz
    y2, z2 = v * v * l2, w * w * l2
    k = math.copysign(1.0, rr) * rr * rr * x2
    if math.copysign(1.0, w) * a2 * z2 > k:
        return math.sqrt(x2 + z2) * il2 - r2
    if math.copysign(1.0, v) * a2 * y2 < k:
        return math.sqrt(x2 + y2) * il2 - r1
    return (math.sqrt(x2 * a2 * il2) + v * rr) * il2 - r1


@njit(cache=True, nogil=True)
def _primitive(table: NDArray[np.float64], n: int, x: float, y: float, z: float) -> float:
    """Distance to one primitive; for ellipsoids first-order exact at the surface."""
    if table[n, 0] == ROUND_CONE:
        distance: float = _round_cone(table, n, x, y, z)
        return distance
    dx, dy, dz = x - table[n, 4], y - table[n, 5], z - table[n, 6]
    u: float = table[n, 12] * dx + table[n, 13] * dy + table[n, 14] * dz
    v: float = table[n, 15] * dx + table[n, 16] * dy + table[n, 17] * dz
    w: float = table[n, 18] * dx + table[n, 19] * dy + table[n, 20] * dz
    a: float = table[n, 7]
    b: float = table[n, 8]
    c: float = table[n, 9]
    edge: float = table[n, 10]
    if table[n, 0] == ELLIPSOID:
        u, v, w = u / a, v / b, w / c
        k0 = math.sqrt(u * u + v * v + w * w)
        u, v, w = u / a, v / b, w / c
        k1 = math.sqrt(u * u + v * v + w * w)
        if k1 < 1e-9:
            return -min(a, min(b, c))
        return k0 * (k0 - 1.0) / k1
    u, v, w = abs(u) - a + edge, abs(v) - b + edge, abs(w) - c + edge
    outside = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2 + max(w, 0.0) ** 2)
    return outside + min(max(u, v, w), 0.0) - edge


@njit(cache=True, nogil=True)
def _smooth_min(a: float, b: float, k: float) -> float:
    """Quadratic smooth minimum: exactly ``min`` where the two differ by ``k`` or more."""
    if k <= 0.0:
        return min(a, b)
    h = max(k - abs(a - b), 0.0)
    return min(a, b) - h * h / (4.0 * k)


@njit(cache=True, nogil=True)
def _weathering(
    x: float,
    y: float,
    z: float,
    roughness: float,
    pitting: float,
    chisel: float,
    spacing: float,
    seed: int,
    cracks: NDArray[np.float64],
) -> float:
    """Metres to add to the distance (positive cuts in): grain, pits, chisel marks, cracks."""
    depth = 0.0
    wavelength = 0.12
    octave = 0
    while wavelength > 2.0 * spacing and octave < 8:
        fade = min(wavelength / spacing - 2.0, 1.0)
        noise = gradient_noise(x / wavelength, y / wavelength, z / wavelength, seed + octave)
        depth += roughness * fade * 0.012 * wavelength * noise
        wavelength *= 0.5
        octave += 1
    if pitting > 0.0:
        patch = gradient_noise(x / 0.15, y / 0.15, z / 0.15, seed + 20)
        density = max(0.0, 0.18 + 0.5 * patch) * pitting
        for cell in (0.032, 0.013):
            if cell > 4.0 * spacing:
                pit = pit_depth(x / cell, y / cell, z / cell, density, seed + 21)
                depth += 0.22 * cell * pit
    if chisel > 0.0 and spacing < 0.0035:
        patch = gradient_noise(x / 0.07, y / 0.07, z / 0.07, seed + 30)
        bend = gradient_noise(x / 0.05, y / 0.05, z / 0.05, seed + 31)
        turn = 1.6 * gradient_noise(x / 0.16, y / 0.16, z / 0.16, seed + 32)
        along = (x + 0.6 * y) * math.cos(turn) + z * math.sin(turn)
        groove = 0.5 - 0.5 * math.cos(2.0 * math.pi * (along + 0.004 * bend) / 0.0085)
        strength = min(max(3.0 * patch + 0.4, 0.0), 1.0)
        depth += chisel * 0.0011 * groove * groove * strength
    for n in range(len(cracks)):
        reach = math.sqrt(
            (x - cracks[n, 5]) ** 2 + (y - cracks[n, 6]) ** 2 + (z - cracks[n, 7]) ** 2
        )
        if reach >= cracks[n, 8]:
            continue
        wander = gradient_noise(x / 0.05, y / 0.05, z / 0.05, seed + 40 + n)
        wander += 0.4 * gradient_noise(x / 0.016, y / 0.016, z / 0.016, seed + 60 + n)
        s = cracks[n, 0] * x + cracks[n, 1] * y + cracks[n, 2] * z - cracks[n, 3] + 0.012 * wander
        half_width = max(cracks[n, 4], 0.9 * spacing)
        if abs(s) < half_width:
            taper = min(1.0, (cracks[n, 8] - reach) / (0.3 * cracks[n, 8]))
            depth += 3.0 * cracks[n, 4] * taper * (1.0 - abs(s) / half_width)
    return min(max(depth, -WEATHERING_M), WEATHERING_M)


@njit(cache=True, nogil=True)
def solid_distance(
    table: NDArray[np.float64],
    rows: NDArray[np.int64],
    group_blend: NDArray[np.float64],
    detail: NDArray[np.float64],
    cracks: NDArray[np.float64],
    x: float,
    y: float,
    z: float,
    spacing: float,
    margin: float,
    seed: int,
    nearest: NDArray[np.float64],
) -> float:
    """Signed distance at one point, negative inside, metres.

    Parameters
    ----------
    table, rows : the primitives and the (sorted) indices of those that matter here.
    group_blend : (7,) blend radius at which each group joins those before it.
    detail : (7, 3) how much roughness, pitting and chiselling each group has.
    cracks : (c, 9) plane normal, offset, half width, centre and reach of each crack.
    spacing : distance of the lattice nodes; finer detail is left out, not aliased.
    margin : beyond this distance weathering and cuts are left out: `WEATHERING_M` or more
        for a sign that is right, negative for the form before weathering and cuts.
    seed : which weathering.
    nearest : (7,) scratch space, so that no point allocates.
    """
    nearest[:] = FAR
    value = FAR
    for place in range(len(rows)):
        n = rows[place]
        value = min(value, _primitive(table, n, x, y, z))
        if place + 1 < len(rows) and table[rows[place + 1], CHAIN_COLUMN] == table[n, CHAIN_COLUMN]:
            continue
        group = int(table[n, 1])
        if table[n, 2] == UNION:
            nearest[group] = _smooth_min(nearest[group], value, table[n, 3])
        else:
            nearest[group] = -_smooth_min(-nearest[group], value, table[n, 3])
        value = FAR
    distance = FAR
    for group in range(CUT_GROUP):
        distance = _smooth_min(distance, nearest[group], group_blend[group])
    if abs(distance) < margin:
        roughness, pitting, chisel, total = 0.0, 0.0, 0.0, 1e-12
        for group in range(CUT_GROUP):
            weight = max(0.0, 1.0 - (nearest[group] - distance) / 0.008)
            total += weight
            roughness += weight * detail[group, ROUGHNESS]
            pitting += weight * detail[group, PITTING]
            chisel += weight * detail[group, CHISEL]
        distance += _weathering(
            x, y, z, roughness / total, pitting / total, chisel / total, spacing, seed, cracks
        )
    if nearest[CUT_GROUP] < margin:
        rough = 0.0055 * gradient_noise(x / 0.035, y / 0.035, z / 0.035, seed + 80)
        rough += 0.0022 * gradient_noise(x / 0.011, y / 0.011, z / 0.011, seed + 81)
        distance = max(distance, -(nearest[CUT_GROUP] + rough))
    return distance


@njit(cache=True, nogil=True)
def solid_distances(
    table: NDArray[np.float64],
    rows: NDArray[np.int64],
    group_blend: NDArray[np.float64],
    detail: NDArray[np.float64],
    cracks: NDArray[np.float64],
    points: NDArray[np.float64],
    spacing: float,
    margin: float,
    seed: int,
) -> NDArray[np.float64]:
    """``solid_distance`` at points (n, 3): (n,) float64."""
    out = np.empty(len(points))
    nearest = np.empty(GROUPS)
    for n in range(len(points)):
        out[n] = solid_distance(
            table,
            rows,
            group_blend,
            detail,
            cracks,
            points[n, 0],
            points[n, 1],
            points[n, 2],
            spacing,
            margin,
            seed,
            nearest,
        )
    return out


@njit(cache=True, nogil=True)
def relevant_rows(
    table: NDArray[np.float64], center: NDArray[np.float64], radius: float
) -> NDArray[np.int64]:
    """Indices (sorted) of the primitives that can shape the surface inside a ball.

    Distances to ellipsoids are only first-order exact, hence the factor on the radius.
    """
    kept = np.empty(len(table), np.int64)
    count = 0
    for n in range(len(table)):
        distance = _primitive(table, n, center[0], center[1], center[2])
        if distance < 1.1 * radius + table[n, REACH_COLUMN]:
            kept[count] = n
            count += 1
    return kept[:count].copy()
