"""Fading of steps: against a dense solution, and what it must leave alone."""

from __future__ import annotations

import numpy as np

from workbench.kernels.patch_drawing import COVERED, EMPTY
from workbench.kernels.seam_strips import fade_steps, fill_empty


def faded(state, places, steps, reach, base=100, sweeps=400) -> np.ndarray:
    """How far each texel moved."""
    page = np.full((*state.shape, 3), base, np.uint8)
    height, width = state.shape
    fade_steps(
        page, state, (0, 0), (width, height), np.asarray(places, float),
        np.asarray(steps, np.float32), reach, sweeps,
    )  # fmt: skip
    return page.astype(int) - base


def test_a_straight_seam_fades_in_proportion_to_the_distance():
    state = np.full((12, 40), COVERED, np.uint8)
    places = np.column_stack([np.full(25, 0.5), np.linspace(0.5, 11.5, 25)])
    moved = faded(state, places, np.full((25, 3), [60, -60, 0]), 20, sweeps=40)
    expected = np.clip(60 * (1 - np.arange(40) / 21), 0, None)
    np.testing.assert_allclose(moved[..., 0], np.tile(expected, (12, 1)), atol=1.0)
    np.testing.assert_allclose(moved[..., 1], -moved[..., 0], atol=1)
    assert not moved[..., 2].any()
    assert not moved[:, 21:].any()


def test_any_shape_is_the_harmonic_one():
    rng = np.random.default_rng(0)
    state = np.where(rng.random((14, 17)) < 0.85, COVERED, EMPTY).astype(np.uint8)
    where = np.argwhere(state == COVERED)
    seam = where[rng.choice(len(where), 12, replace=False)]
    steps = rng.uniform(-80, 80, (12, 3))
    moved = faded(state, seam[:, ::-1] + 0.5, steps, 40)
    number = {tuple(rc): i for i, rc in enumerate(where.tolist())}
    held = {tuple(rc): i for i, rc in enumerate(seam.tolist())}
    matrix, right = np.zeros((len(where), len(where))), np.zeros((len(where), 3))
    for rc, i in number.items():
        if rc in held:
            matrix[i, i], right[i] = 1.0, steps[held[rc]]
            continue
        beside = [(rc[0] + a, rc[1] + b) for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        for there in beside:
            if there in number:
                matrix[i, i] += 1.0
                matrix[i, number[there]] -= 1.0
    expected = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
    found = np.array([moved[tuple(rc)] for rc in where])
    np.testing.assert_allclose(found, expected, atol=0.75)


def test_between_texels_all_four_are_held():
    state = np.full((5, 5), COVERED, np.uint8)
    moved = faded(state, [[2.0, 2.0], [2.3, 2.4]], [[8, 8, 8], [8, 8, 8]], 1)
    np.testing.assert_array_equal(moved[1:3, 1:3], 8)


def test_a_patch_leaves_its_neighbours_on_the_page_alone():
    page = np.full((10, 20, 3), 50, np.uint8)
    state = np.full((10, 20), COVERED, np.uint8)
    fade_steps(
        page, state, (4, 2), (6, 5), np.array([[5.5, 4.5]]), np.full((1, 3), 30, np.float32), 20, 40
    )
    assert page[4, 5, 0] == 80
    page[2:7, 4:10] = 50
    assert (page == 50).all()


def test_colours_do_not_wrap_round():
    state = np.full((3, 3), COVERED, np.uint8)
    assert faded(state, [[1.5, 1.5]], [[300, 300, 300]], 3).max() == 155
    assert faded(state, [[1.5, 1.5]], [[-300, -300, -300]], 3).min() == -100


def test_empty_texels_take_the_mean_of_their_square():
    page, state = np.zeros((16, 32, 3), np.uint8), np.zeros((16, 32), np.uint8)
    page[3:5, 3:5], state[3:5, 3:5] = (10, 20, 30), COVERED
    page[4, 4] = (20, 20, 30)
    fill_empty(page, state, 16)
    assert page[0, 0].tolist() == [13, 20, 30]
    assert page[15, 31].tolist() == [13, 20, 30]
    assert page[3, 3].tolist() == [10, 20, 30]
    nothing = np.zeros((8, 8, 3), np.uint8)
    fill_empty(nothing, np.zeros((8, 8), np.uint8), 4)
    assert not nothing.any()
