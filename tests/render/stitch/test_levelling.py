from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from workbench.errors import InputError
from workbench.kernels.levelling_multigrid import (
    BORDER,
    EMPTY,
    FREE,
    STEP,
    along_borders,
    levelling_constraints,
)
from workbench.render.stitch.levelling import LevellingSettings, levelling
from workbench.verification.image_quality import color_steps

EPSILON = 0.1
RAW = LevellingSettings(200, 1e-7, 0)


def patchwork(shape=(90, 130), seed=1):
    """Wavy patches of other brightness, grain, a disc in front, nothing at the left."""
    rng = np.random.default_rng(seed)
    height, width = shape
    y, x = np.mgrid[:height, :width]
    label = ((x + 9 * np.sin(y / 11)) // (width / 5)).astype(np.int32) + 10 * (y // (height // 2))
    offset = rng.normal(0, 0.08, (100, 3))
    color = 0.5 + offset[label] + rng.normal(0, 0.01, (*shape, 3))
    depth = np.full(shape, 2.0, np.float32)
    depth[(y - height / 2) ** 2 + (x - width / 2) ** 2 < (height / 5) ** 2] = 1.5
    depth[:, :8] = np.inf
    return color.astype(np.float32), label.astype(np.int32), depth


def direct(kind, given):
    """The harmonic texture by sparse elimination."""
    free = kind == FREE
    number = np.full(kind.shape, -1)
    number[free] = np.arange(free.sum())
    rows, columns, values = [], [], []
    diagonal, right = np.zeros(free.sum()), np.zeros((free.sum(), 3))
    for r, c in np.argwhere(free):
        for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            i, j = r + dr, c + dc
            if not (0 <= i < kind.shape[0] and 0 <= j < kind.shape[1]) or kind[i, j] == EMPTY:
                continue
            me = number[r, c]
            diagonal[me] += 1
            if kind[i, j] == FREE:
                rows.append(me)
                columns.append(number[i, j])
                values.append(-1.0)
            else:
                right[me] += given[i, j]
    every = np.arange(len(diagonal))
    matrix = coo_array(
        (
            np.concatenate([values, diagonal]),
            (np.concatenate([rows, every]), np.concatenate([columns, every])),
        )
    ).tocsc()
    out = given.astype(np.float64)
    out[free] = splu(matrix).solve(right)
    return out


def test_multigrid_comes_to_the_direct_solution():
    color, label, depth = patchwork()
    exact = direct(*levelling_constraints(color, label, depth, EPSILON))
    errors = []
    for iterations in (1, 2, 4, 8, 16):
        level = levelling(color, label, depth, EPSILON, LevellingSettings(iterations, 0.0, 0))
        assert level.iterations == iterations
        errors.append(np.abs(level.change - exact).max())
    assert all(after < before for before, after in pairwise(errors))
    # The paper's eight iterations: a thousandth of the steps of 0.1 that are to be levelled.
    assert errors[3] < 1e-4
    assert errors[4] < 1e-5


def test_it_ends_at_the_tolerance():
    color, label, depth = patchwork()
    level = levelling(color, label, depth, EPSILON, LevellingSettings(50, 1e-3, 0))
    assert level.residual <= 1e-3
    assert 2 <= level.iterations <= 6


def test_two_photographs_of_other_brightness_become_one():
    """The solution is a constant on either side: half of the difference."""
    label = np.zeros((40, 60), np.int32)
    label[:, 23:] = 4
    color = np.where(label[..., None] == 4, [0.4, 0.5, 0.6], [0.5, 0.5, 0.5]).astype(np.float32)
    level = levelling(color, label, np.ones((40, 60), np.float32), EPSILON, RAW)
    out = level.applied(color)
    assert np.abs(out - [0.45, 0.5, 0.55]).max() < 1e-5


def test_a_border_pixel_has_the_mean_of_itself_and_its_neighbours_across():
    label = np.array([[0, 1, 1], [0, 0, 2], [0, 0, 2]], np.int32)
    color = np.arange(27, dtype=np.float32).reshape(3, 3, 3) / 27
    depth = np.ones((3, 3), np.float32)
    kind, change = levelling_constraints(color, label, depth, EPSILON)
    assert kind.tolist() == [
        [BORDER, BORDER, BORDER],
        [FREE, BORDER, BORDER],
        [FREE, BORDER, BORDER],
    ]
    fixed = color + change
    assert np.allclose(fixed[0, 0], (color[0, 0] + color[0, 1]) / 2)
    assert np.allclose(fixed[1, 1], (color[1, 1] + color[0, 1] + color[1, 2]) / 3)
    assert np.allclose(fixed[0, 1], (color[0, 1] + color[0, 0] + color[1, 1]) / 3)


def test_steps_of_depth_keep_their_colours_and_stop_the_levelling():
    """The front half has no other label: nothing of the seam behind it reaches it."""
    label = np.zeros((60, 80), np.int32)
    label[30:, 40:] = 1
    depth = np.full((60, 80), 2.0, np.float32)
    depth[:, :40] = 1.0
    color = (0.5 + 0.1 * label[..., None] * np.ones(3)).astype(np.float32)
    level = levelling(color, label, depth, EPSILON, RAW)
    assert (level.kind[:, 39] == STEP).all()
    assert np.abs(level.change[:, :40]).max() < 1e-6
    assert np.abs(level.change[[29, 30], 50:] - [[[0.05]], [[-0.05]]]).max() < 1e-6
    assert (level.kind[[29, 30], 40] == BORDER).all()
    assert np.abs(level.change[:29, 40]).max() < 1e-6


def test_islands_without_a_border_and_pictures_without_anything_are_left():
    label = np.zeros((50, 50), np.int32)
    label[:20, 10:] = 1
    depth = np.ones((50, 50), np.float32)
    depth[22:26] = np.inf
    label[10:20, :] = 2
    color = np.random.default_rng(0).random((50, 50, 3)).astype(np.float32)
    level = levelling(color, label, depth, EPSILON, RAW)
    assert (level.change[22:] == 0).all()
    assert (level.kind[22:26] == EMPTY).all()
    assert np.abs(level.change[:22]).max() > 0.05
    nothing = levelling(color, label, np.full((50, 50), np.inf, np.float32), EPSILON)
    assert (nothing.change == 0).all()
    one = levelling(color, np.zeros((50, 50), np.int32), np.ones((50, 50), np.float32), EPSILON)
    assert (one.change == 0).all()


def test_steps_between_labels_are_at_most_half_of_before():
    color, label, depth = patchwork()
    before = color_steps(color, label, depth, EPSILON)
    level = levelling(color, label, depth, EPSILON)
    after = color_steps(level.applied(color), label, depth, EPSILON)
    assert before.across > 10
    assert after.across <= 0.5 * before.across
    # Nowhere else has a step come up.
    assert after.within < 1.1 * before.within


def test_seams_spread_what_photographs_differ_in_and_not_what_the_surface_does():
    """A surface that grows brighter to the right, in two photographs, one of them brighter."""
    label = np.zeros((30, 61), np.int32)
    label[:, 30:] = 1
    surface = np.linspace(0.2, 0.5, 61)[None, :, None] * np.ones((30, 1, 3))
    color = (surface + 0.1 * label[..., None]).astype(np.float32)
    depth = np.ones((30, 61), np.float32)
    seam = np.full(color.shape, np.nan, np.float32)
    seam[:, 29], seam[:, 30] = 0.05, -0.05
    out = levelling(color, label, depth, EPSILON, RAW, seam).applied(color)
    inner = np.s_[:, [*range(29), *range(31, 61)]]
    assert np.abs(out[inner] - surface[inner] - 0.05).max() < 1e-5
    # The border pixels themselves are joined.
    assert np.abs(out[:, 29] - out[:, 30]).max() < 1e-6
    biased = levelling(color, label, depth, EPSILON, RAW).applied(color)
    assert np.abs(biased[:, 0] - surface[:, 0] - 0.05).min() > 0.002


def test_colours_of_no_photograph_give_way():
    """A grey patch amid a photograph takes its colour; the photograph keeps all of its own."""
    label = np.zeros((40, 40), np.int32)
    label[10:25, 12:30] = -1
    color = np.full((40, 40, 3), [0.8, 0.3, 0.2], np.float32)
    color[label == -1] = 0.5
    depth = np.ones((40, 40), np.float32)
    nowhere = np.full(color.shape, np.nan, np.float32)
    for seam in (None, nowhere):
        out = levelling(color, label, depth, EPSILON, RAW, seam).applied(color)
        assert (out[label == 0] == color[label == 0]).all()
        assert np.abs(out - [0.8, 0.3, 0.2]).max() < 1e-5


def test_seams_are_averaged_along_borders_of_one_label():
    kind = np.full((1, 7), BORDER, np.uint8)
    kind[0, 2] = FREE
    label = np.array([[0, 0, 0, 0, 1, 1, 2]], np.int32)
    change = np.full((1, 7, 3), 100.0, np.float32)
    seam = np.repeat(
        np.array([[1.0, 2, 9, 6, 4, np.nan, np.nan]], np.float32)[..., None], 3, axis=2
    )
    out = along_borders(kind, label, change, seam, 2)
    assert np.allclose(out[0, :, 0], [1.5, 3.0, 100, 4.0, 4.0, 4.0, 0])
    alone = along_borders(kind, label, change, seam, 0)
    assert np.allclose(alone[0, :, 0], [1, 2, 100, 6, 4, 0, 0])


def test_settings_have_bounds():
    for bad in ((-1, 1e-3, 4), (8, -1.0, 4), (8, float("nan"), 4), (8, 1e-3, -1)):
        with pytest.raises(InputError, match="bounds"):
            LevellingSettings(*bad)
