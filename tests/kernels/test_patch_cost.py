"""Patch costs against the same told plainly in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from tests.stereo.scenes import plane, seen
from workbench.kernels.counted_random import uniform
from workbench.kernels.patch_cost import WORST, patch_cost, reference_patch
from workbench.stereo.matching import pair_geometry

PATCHES = (4, 1.0)


def both():
    one, depth = seen(plane, (0.0, 0.0, 4.0), size=(60, 50), focal=150.0)
    other, _ = seen(plane, (0.8, 0.1, 3.9), size=(60, 50), focal=150.0)
    return one, other, 1.0 / depth


def cost_by_kernel(one, other, told, at, usable=None):
    usable = one.usable if usable is None else usable
    weights, parts = np.empty(41, np.float32), np.empty(41, np.float32)
    patch = (weights, parts, *reference_patch(one.grey, usable, at, PATCHES, weights, parts))
    there, back = pair_geometry(one, [other])
    others = (other.grey[None], other.usable[None], np.array([other.grey.shape[::-1]]))
    return patch_cost(told, at, 0, patch, PATCHES, (*there, *back), others)


def cost_plainly(one, other, told, at, usable=None):
    """By rays, planes and projection, sample by sample; exact, where the kernel is affine."""
    usable = one.usable if usable is None else usable
    (w, a, b), (x, y) = told, at
    mine, theirs, weight = [], [], []
    for dy in range(-4, 5):
        for dx in range(-4, 5):
            u, v = x + dx, y + dy
            # Samples are of one colour on a chessboard.
            if (dx + dy) % 2 or not usable[v, u]:
                continue
            depth = 1.0 / (w + a * dx + b * dy)
            ray = np.append((np.array([u, v]) - one.lens[2:]) / one.lens[:2], 1.0)
            inside = one.camera_from_world[:3, :3].T @ (depth * ray - one.camera_from_world[:3, 3])
            pixel = other.project(inside[None])[0][0]
            i, j = np.floor(pixel).astype(int)
            fu, fv = pixel - [i, j]
            g = other.grey.astype(float)
            theirs.append(
                (1 - fv) * ((1 - fu) * g[j, i] + fu * g[j, i + 1])
                + fv * ((1 - fu) * g[j + 1, i] + fu * g[j + 1, i + 1])
            )
            mine.append(float(one.grey[v, u]))
            apart = (mine[-1] - float(one.grey[y, x])) / 12.0
            weight.append(np.exp(-0.5 * ((dx * dx + dy * dy) / 25.0 + apart**2)))
    mine, theirs, weight = (np.array(values) for values in (mine, theirs, weight))
    weight /= weight.sum()
    mine, theirs = mine - weight @ mine, theirs - weight @ theirs
    return 1.0 - (weight @ (mine * theirs)) / np.sqrt((weight @ mine**2) * (weight @ theirs**2))


@pytest.mark.parametrize("at", [(30, 25), (20, 15), (36, 30)])
@pytest.mark.parametrize("off", [0.0, 0.004, -0.01])
def test_costs_are_those_of_plain_projection(at, off):
    one, other, nearness = both()
    x, y = at
    told = (
        nearness[y, x] + off,
        0.5 * (nearness[y, x + 1] - nearness[y, x - 1]),
        0.5 * (nearness[y + 1, x] - nearness[y - 1, x]),
    )
    plain = cost_plainly(one, other, told, at)
    assert cost_by_kernel(one, other, told, at) == pytest.approx(plain, abs=0.02)
    if off == 0.0:
        assert plain < 0.1


def test_masked_samples_weigh_nothing():
    one, other, nearness = both()
    told = (nearness[25, 30], 0.0, 0.0)
    usable = one.usable.copy()
    usable[:, 31:] = False
    masked = cost_by_kernel(one, other, told, (30, 25), usable)
    assert masked == pytest.approx(cost_plainly(one, other, told, (30, 25), usable), abs=0.02)
    assert masked != pytest.approx(cost_by_kernel(one, other, told, (30, 25)), abs=1e-3)


def test_planes_seen_beside_the_picture_or_behind_it_are_the_worst():
    one, other, _ = both()
    assert cost_by_kernel(one, other, (0.8, 0.0, 0.0), (30, 25)) == WORST
    assert cost_by_kernel(one, other, (-5.0, 0.0, 0.0), (30, 25)) == WORST


def test_random_numbers_are_even_and_told_by_what_they_are_for():
    drawn = np.array([[uniform(3, place, draw) for draw in range(40)] for place in range(500)])
    assert drawn.min() >= 0.0
    assert drawn.max() < 1.0
    counts, _ = np.histogram(drawn, 20, (0.0, 1.0))
    assert np.abs(counts - 1000).max() < 200
    assert np.abs(np.corrcoef(drawn.T)[~np.eye(40, dtype=bool)]).max() < 0.25
    assert uniform(3, 7, 2) == drawn[7, 2]
