"""How well a patch of a picture fits what other pictures show, if it lies in some plane.

A plane is told by one over depth at a pixel, and its change for a pixel to the right and one
down: over the picture of a plane one over depth is linear. A pixel p of nearness w is seen by
another camera at the homogeneous A p + w e, where A (3, 3) and e (3,) are that pair's alone.

Source: Schönberger et al. 2016, "Pixelwise view selection for unstructured multi-view stereo",
sections 4.1 and 4.2 (bilaterally weighted NCC); Xu and Tao 2019, section 4.2 (what depth maps
have against each other).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.borrowing import borrowing

WORST = 2.0
"""The cost, 1 − NCC, of what cannot be compared."""

_SPATIAL_PX, _GREY_LEVELS = 5.0, 12.0
_FARTHEST_BACK_PX = 3.0

Floats = NDArray[np.float32]
Masks = NDArray[np.bool_]
Doubles = NDArray[np.float64]
# One over depth, its change for a pixel to the right, and for one down.
Plane = tuple[float, float, float]
# Column and row.
Pixel = tuple[int, int]
# A (v, 3, 3) and e (v, 3) to the other views, and the same from them.
Pairs = tuple[Doubles, Doubles, Doubles, Doubles]
# Pictures and masks (v, h, w) of the other views, and their widths and heights (v, 2).
Others = tuple[Floats, Masks, NDArray[np.int64]]
# One over depth (v, h, w) by the other views' own depth maps, 0 for none, and its weight.
Geometry = tuple[Floats, float]
# Grey picture and mask (h, w), lens fx, fy, cx, cy, and what is known of the other views.
Scene = tuple[Floats, Masks, Doubles, Pairs, Others, Geometry]
# Half width of a patch, least variance of its grey levels. Its samples are every second pixel,
# those of one colour on a chessboard: half the work, and nearly all that is to be seen.
Patches = tuple[int, float]
# Weights and parts of the samples, their mean and variance; see `reference_patch`.
Patch = tuple[Floats, Floats, np.float32, np.float32]


@borrowing
def reference_patch(
    picture: Floats, usable: Masks, at: Pixel, patches: Patches, weights: Floats, parts: Floats
) -> tuple[np.float32, np.float32]:
    """Mean and variance of the patch around a pixel; ``weights`` and ``parts`` are filled in.

    Weights sum to 1; a part is weight × (sample − mean), and parts sum to 0. Samples beside the
    picture or its mask weigh nothing.
    """
    (x, y), (half, _) = at, patches
    height, width = picture.shape
    middle = picture[y, x]
    total, mean = np.float32(0.0), np.float32(0.0)
    k = 0
    for dy in range(-half, half + 1):
        for dx in range(-half + ((dy + half) & 1), half + 1, 2):
            u, v = x + dx, y + dy
            weight, value = np.float32(0.0), np.float32(0.0)
            if 0 <= v < height and 0 <= u < width and usable[v, u]:
                value = picture[v, u]
                apart = (value - middle) * np.float32(1.0 / _GREY_LEVELS)
                near = np.float32(dx * dx + dy * dy) * np.float32(_SPATIAL_PX**-2)
                weight = np.float32(math.exp(np.float32(-0.5) * (near + apart * apart)))
            weights[k] = weight
            parts[k] = value
            total += weight
            mean += weight * value
            k += 1
    mean /= total
    variance = np.float32(0.0)
    for i in range(k):
        apart = parts[i] - mean
        weights[i] /= total
        parts[i] = weights[i] * apart
        variance += parts[i] * apart
    return mean, variance


@borrowing
def patch_cost(
    plane: Plane, at: Pixel, v: int, patch: Patch, patches: Patches, pairs: Pairs, others: Others
) -> float:
    """1 − NCC of the patch around a pixel with what view ``v`` shows of the plane there.

    Over a patch the picture in the other view is taken to be affine, which is true to some
    hundredths of a pixel.
    """
    (w, a, b), (x, y), (half, least_variance) = plane, at, patches
    weights, parts, mean, variance = patch
    A, e, _, _ = pairs
    pictures, masks, sizes = others
    qz = A[v, 2, 0] * x + A[v, 2, 1] * y + A[v, 2, 2] + w * e[v, 2]
    if qz <= 0.0:
        return WORST
    per = 1.0 / qz
    qu = (A[v, 0, 0] * x + A[v, 0, 1] * y + A[v, 0, 2] + w * e[v, 0]) * per
    qv = (A[v, 1, 0] * x + A[v, 1, 1] * y + A[v, 1, 2] + w * e[v, 1]) * per
    right, down = A[v, 2, 0] + a * e[v, 2], A[v, 2, 1] + b * e[v, 2]
    ux = (A[v, 0, 0] + a * e[v, 0] - qu * right) * per
    vx = (A[v, 1, 0] + a * e[v, 1] - qv * right) * per
    uy = (A[v, 0, 1] + b * e[v, 0] - qu * down) * per
    vy = (A[v, 1, 1] + b * e[v, 1] - qv * down) * per
    reach_u, reach_v = half * (abs(ux) + abs(uy)), half * (abs(vx) + abs(vy))
    inside = reach_u <= qu < sizes[v, 0] - 1.001 - reach_u
    inside &= reach_v <= qv < sizes[v, 1] - 1.001 - reach_v
    if not inside or not masks[v, np.uint32(qv + 0.5), np.uint32(qu + 0.5)]:
        return WORST
    step_u, step_v = np.float32(2.0 * ux), np.float32(2.0 * vx)
    first, square, cross = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    one = np.uint32(1)
    k = 0
    for j in range(-half, half + 1):
        first_column = ((j + half) & 1) - half
        su = np.float32(qu + j * uy + first_column * ux)
        sv = np.float32(qv + j * vy + first_column * vx)
        for _ in range(first_column, half + 1, 2):
            column, row = np.uint32(su), np.uint32(sv)
            fu, fv = su - np.float32(column), sv - np.float32(row)
            upper, lower = pictures[v, row, column], pictures[v, row + one, column]
            upper += fu * (pictures[v, row, column + one] - upper)
            lower += fu * (pictures[v, row + one, column + one] - lower)
            value = upper + fv * (lower - upper) - mean
            weighted = weights[k] * value
            first += weighted
            square += weighted * value
            cross += parts[k] * value
            k += 1
            su += step_u
            sv += step_v
    spread = square - first * first
    if spread < least_variance:
        return WORST
    return min(max(1.0 - float(cross) / math.sqrt(spread * variance), 0.0), WORST)


@borrowing
def view_cost(
    plane: Plane, at: Pixel, v: int, patch: Patch, patches: Patches, scene: Scene
) -> float:
    """What view ``v`` has against a plane: by its picture, and by its own depth map."""
    _, _, _, pairs, others, (nearness, weight) = scene
    cost: float = patch_cost(plane, at, v, patch, patches, pairs, others)
    if weight > 0.0 and cost < WORST:
        cost += weight * _disagreement(plane[0], at, v, pairs, nearness)
    return cost


@borrowing
def _disagreement(w: float, at: Pixel, v: int, pairs: Pairs, nearness: Floats) -> float:
    """How far from a pixel, in pixels, a view's own depth map leads back to; 3 at most.

    The place is inside that view's picture.
    """
    A, e, back_A, back_e = pairs
    x, y = at
    qz = A[v, 2, 0] * x + A[v, 2, 1] * y + A[v, 2, 2] + w * e[v, 2]
    u = (A[v, 0, 0] * x + A[v, 0, 1] * y + A[v, 0, 2] + w * e[v, 0]) / qz
    t = (A[v, 1, 0] * x + A[v, 1, 1] * y + A[v, 1, 2] + w * e[v, 1]) / qz
    near = nearness[v, np.uint32(t + 0.5), np.uint32(u + 0.5)]
    pz = back_A[v, 2, 0] * u + back_A[v, 2, 1] * t + back_A[v, 2, 2] + near * back_e[v, 2]
    if near <= 0.0 or pz <= 0.0:
        return _FARTHEST_BACK_PX
    px = (back_A[v, 0, 0] * u + back_A[v, 0, 1] * t + back_A[v, 0, 2] + near * back_e[v, 0]) / pz
    py = (back_A[v, 1, 0] * u + back_A[v, 1, 1] * t + back_A[v, 1, 2] + near * back_e[v, 1]) / pz
    return min(math.sqrt((px - x) ** 2 + (py - y) ** 2), _FARTHEST_BACK_PX)
