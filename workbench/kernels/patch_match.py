"""PatchMatch stereo: planes propagated in red and black, views chosen pixel by pixel.

Source: Xu and Tao 2019, "Multi-scale geometric consistency guided multi-view stereo", section
3.1 and 3.2: where candidates are taken from, and which views have a say.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.borrowing import borrowing
from workbench.kernels.patch_cost import (
    WORST,
    Doubles,
    Floats,
    Patch,
    Patches,
    Pixel,
    Plane,
    Scene,
    reference_patch,
    view_cost,
)
from workbench.kernels.slanted_planes import changed, faces_camera

# A view of such a cost has no say; nor one of less than this share of the greatest say.
_COST_OF_NO_SAY, _LEAST_SAY = 0.9, 0.1
# How many views a plane is sought by: each place is seen well by some, and not the same.
_HEARD = 3
# A candidate is given up that does not promise to win, though by chance it might.
_HOPE = 0.1
# A neighbour that fares worse than the pixel by more has no better plane for it.
_WORSE = 0.1


def _turned(area: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """An area above the pixel, and the same to the right, below and to the left."""
    turns = [area]
    for _ in range(3):
        turns.append([(-y, x) for x, y in turns[-1]])
    return turns


# Where propagation looks (Xu and Tao 2019, figure 2): four V-shaped areas near by, four strips
# further off. All their pixels are of the other colour.
_NEAR = _turned([(0, -1), (-1, -2), (1, -2), (-2, -3), (2, -3), (-3, -4), (3, -4)])
_FAR = _turned([(0, -reach) for reach in range(3, 25, 2)])
_NEAR_AREAS = len(_NEAR)
_FIRST = np.cumsum([0, *(len(area) for area in _NEAR + _FAR)]).astype(np.int64)
_PLACES = np.array([place for area in _NEAR + _FAR for place in area], np.int64)
# Whose views are asked: the pixel itself, and others of the other colour.
_AROUND = np.array(
    [(0, 0), (0, -1), (1, 0), (0, 1), (-1, 0), (0, -3), (3, 0), (0, 3), (-3, 0)], np.int64
)


@njit(cache=True, nogil=True, error_model="numpy")
def first_costs(scene: Scene, patches: Patches, planes: Floats, costs: Floats) -> None:
    """Fill ``costs`` (h, w, views) with what every view has against the planes (h, w, 3)."""
    picture, usable = scene[0], scene[1]
    weights, parts = _room(patches)
    height, width = picture.shape
    for y in range(height):
        for x in range(width):
            costs[y, x] = WORST
            if not usable[y, x]:
                continue
            mean, variance = reference_patch(picture, usable, (x, y), patches, weights, parts)
            if variance < patches[1]:
                continue
            patch, plane = (weights, parts, mean, variance), _at(planes, x, y)
            for v in range(costs.shape[2]):
                costs[y, x, v] = view_cost(plane, (x, y), v, patch, patches, scene)


@njit(cache=True, nogil=True, error_model="numpy")
def sweep(
    scene: Scene,
    patches: Patches,
    span: tuple[float, float],
    far: bool,
    trial: tuple[float, float, int],
    seed: int,
    turn: int,
    planes: Floats,
    costs: Floats,
    scores: Floats,
) -> None:
    """Better the planes of the pixels of one colour, from those of the other and by chance.

    Parameters
    ----------
    span : least and greatest one over depth.
    far : whether planes are taken from far off, too; near by alone where most are good already.
    trial : how far one over depth and (by length) normals are changed by chance, and how often.
    turn : number of the sweep; its parity is the colour.
    planes, costs, scores : (h, w, 3), (h, w, views), (h, w), bettered in place. A score is the
        mean cost of the views by their says.
    """
    picture, usable, lens = scene[0], scene[1], scene[2]
    change, tilt, trials = trial
    areas = len(_FIRST) - 1 if far else _NEAR_AREAS
    weights, parts = _room(patches)
    height, width = picture.shape
    views = costs.shape[2]
    says, order = np.empty(views), np.empty(views, np.int64)
    at_hand, tried = np.empty(views), np.empty(views)
    for y in range(height):
        for x in range((y + turn) % 2, width, 2):
            if not usable[y, x]:
                continue
            at = (x, y)
            mean, variance = reference_patch(picture, usable, at, patches, weights, parts)
            if variance < patches[1]:
                continue
            patch, plane = (weights, parts, mean, variance), _at(planes, x, y)
            says_of_views(costs, at, _HEARD, says, order)
            best = 0.0
            for v in range(views):
                at_hand[v] = costs[y, x, v]
                best += says[v] * at_hand[v]
            for k in range(areas + trials):
                if k < areas:
                    found, other = _candidate(scores, planes, at, k, best + _WORSE)
                    if not found or other == plane:
                        continue
                else:
                    draws = (seed, y * width + x, turn)
                    other = changed(plane, at, lens, change, tilt, k - areas, draws)
                if not span[0] <= other[0] <= span[1] or not faces_camera(other, at, lens):
                    continue
                cost = _tried(other, at, best, says, order, at_hand, tried, patch, patches, scene)
                if cost < best:
                    best, plane = cost, other
                    for v in range(views):
                        if says[v] == 0.0:
                            tried[v] = view_cost(other, at, v, patch, patches, scene)
                        at_hand[v] = tried[v]
            for v in range(views):
                costs[y, x, v] = at_hand[v]
            planes[y, x, 0], planes[y, x, 1], planes[y, x, 2] = plane
            scores[y, x] = best


@njit(cache=True, nogil=True, error_model="numpy")
def polished(
    scene: Scene,
    patches: Patches,
    step: float,
    planes: Floats,
    costs: Floats,
    scores: Floats,
    sigma: Floats,
) -> None:
    """One over depth to the bottom of the parabola through the costs beside, and how sure it is.

    Parameters
    ----------
    step : how far beside is, in one over depth.
    costs, scores : brought up to date.
    sigma : (h, w) filled with the standard deviation; infinite where the cost has no bottom.
        Of n samples with the cost c = 1 − NCC, the noise has the variance 2 c, so the negative
        logarithm of the likelihood is n c(w) / 2 c to a constant: its bend tells the deviation.
    """
    picture, usable = scene[0], scene[1]
    weights, parts = _room(patches)
    height, width = picture.shape
    views = costs.shape[2]
    says, order = np.empty(views), np.empty(views, np.int64)
    none, tried = np.zeros(views), np.empty(views)
    for y in range(height):
        for x in range(width):
            sigma[y, x] = np.inf
            if not usable[y, x] or scores[y, x] >= WORST:
                continue
            at = (x, y)
            mean, variance = reference_patch(picture, usable, at, patches, weights, parts)
            patch, plane = (weights, parts, mean, variance), _at(planes, x, y)
            says_of_views(costs, at, views, says, order)
            w, a, b = plane
            heard = 0.0
            for v in range(views):
                heard += says[v] ** 2
            nearer = _tried(
                (w + step, a, b), at, np.inf, says, order, none, tried, patch, patches, scene
            )
            farther = _tried(
                (w - step, a, b), at, np.inf, says, order, none, tried, patch, patches, scene
            )
            middle = _tried(plane, at, np.inf, says, order, none, tried, patch, patches, scene)
            for v in range(views):
                if says[v] > 0.0:
                    costs[y, x, v] = tried[v]
            scores[y, x] = middle
            bend = (nearer + farther - 2.0 * middle) / (step * step)
            if bend <= 0.0:
                continue
            shift = min(max((farther - nearer) / (2.0 * bend * step), -step), step)
            planes[y, x, 0] = w + shift
            sigma[y, x] = math.sqrt(2.0 * max(middle, 1e-3) * heard / (bend * len(weights)))


@borrowing
def says_of_views(
    costs: Floats, at: Pixel, heard: int, says: Doubles, order: NDArray[np.int64]
) -> None:
    """Fill in what each view's say is at a pixel, in sum 1, and the views in order of it.

    A view has a say where it fits the planes of the pixels around, so those that do not see
    the place have none; where no view fits, all have the same. Of more than ``heard`` those
    that fit best have one.
    """
    height, width, views = costs.shape
    most = 0.0
    for v in range(views):
        says[v] = 0.0
        order[v] = v
        for k in range(len(_AROUND)):
            i, j = at[0] + _AROUND[k, 0], at[1] + _AROUND[k, 1]
            if 0 <= i < width and 0 <= j < height:
                share = costs[j, i, v] / _COST_OF_NO_SAY
                if share < 1.0:
                    says[v] += (1.0 - share * share) ** 2
        most = max(most, says[v])
    for k in range(1, views):
        one, place = order[k], k
        while place > 0 and says[order[place - 1]] < says[one]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = one
    total = 0.0
    for k in range(views):
        v = order[k]
        if k >= heard or says[v] < _LEAST_SAY * most:
            says[v] = 0.0
        elif most <= 0.0:
            says[v] = 1.0
        total += says[v]
    for v in range(views):
        says[v] /= total


@borrowing
def _tried(
    plane: Plane,
    at: Pixel,
    limit: float,
    says: Doubles,
    order: NDArray[np.int64],
    at_hand: Doubles,
    costs: Doubles,
    patch: Patch,
    patches: Patches,
    scene: Scene,
) -> float:
    """The cost of a plane, views with most say first; `WORST` where it is given up.

    It is given up once it can stay below ``limit`` only if the views not asked yet have far
    less against it than against the plane at hand. ``costs`` is filled in,
    but for views that have no say.
    """
    total, rest = 0.0, 0.0
    for v in range(len(order)):
        rest += says[v] * at_hand[v]
    for k in range(len(order)):
        v = order[k]
        if says[v] == 0.0:
            break
        costs[v] = view_cost(plane, at, v, patch, patches, scene)
        total += says[v] * costs[v]
        rest -= says[v] * at_hand[v]
        if total + (1.0 - _HOPE) * rest >= limit:
            return WORST
    return total


@borrowing
def _candidate(
    scores: Floats, planes: Floats, at: Pixel, area: int, limit: float
) -> tuple[bool, Plane]:
    """The plane, as it is at a pixel, of the pixel of an area that fares best, below a limit."""
    x, y = at
    height, width = scores.shape
    least, bx, by = np.float32(limit), -1, -1
    for k in range(_FIRST[area], _FIRST[area + 1]):
        i, j = x + _PLACES[k, 0], y + _PLACES[k, 1]
        if 0 <= i < width and 0 <= j < height and scores[j, i] < least:
            least, bx, by = scores[j, i], i, j
    if bx < 0:
        return False, (0.0, 0.0, 0.0)
    w, a, b = _at(planes, bx, by)
    return True, (w + a * (x - bx) + b * (y - by), a, b)


@borrowing
def _at(planes: Floats, x: int, y: int) -> Plane:
    return float(planes[y, x, 0]), float(planes[y, x, 1]), float(planes[y, x, 2])


@njit(cache=True, nogil=True)
def _room(patches: Patches) -> tuple[Floats, Floats]:
    """Room for the weights and the parts of a patch."""
    samples = ((2 * patches[0] + 1) ** 2 + 1) // 2
    return np.empty(samples, np.float32), np.empty(samples, np.float32)
