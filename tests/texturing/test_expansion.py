"""Expansion moves are the best there are; labellings are close to the best, or are it."""

from dataclasses import replace

import maxflow.fastmin
import numpy as np
import pytest

from tests.texturing.labelling_cases import (
    choices,
    least_energy,
    plain_energy,
    problem_of,
    random_problem,
)
from workbench.errors import InputError
from workbench.texturing.expansion import expanded, without_dominated
from workbench.texturing.labelling import FULL_COLOR


def best_move(problem, labels, photo):
    """The least energy that triangles can reach by keeping their label or taking the photo."""
    best = np.inf
    for chosen in choices(problem):
        if all(new in (old, photo) for new, old in zip(chosen, labels, strict=True)):
            best = min(best, plain_energy(problem, chosen))
    return best


@pytest.mark.parametrize("seed", range(15))
def test_a_move_is_the_best_of_all(seed):
    problem = random_problem(seed, triangles=8, labels=3, extra_edges=5, smoothness=0.6)
    # Moves start after candidates that no best labelling has are left out.
    problem = without_dominated(problem)
    start = problem.cheapest()
    for photo in range(3):
        found = expanded(problem, 1, order=[photo])
        assert plain_energy(problem, found.labels) == pytest.approx(found.energy.total, rel=1e-12)
        assert found.energy.total == pytest.approx(best_move(problem, start, photo), rel=1e-9)


@pytest.mark.parametrize("seed", range(15))
@pytest.mark.parametrize("smoothness", [0.1, 0.5, 3.0])
def test_two_photographs_are_labelled_exactly(seed, smoothness):
    problem = random_problem(seed, 9, 2, 5, smoothness)
    found = expanded(problem, 10)
    assert found.converged
    # With two labels the expansion of one from the other's side reaches every labelling.
    assert found.energy.total == pytest.approx(least_energy(problem), rel=1e-9)


@pytest.mark.parametrize("seed", range(15))
def test_more_photographs_come_close(seed):
    problem = random_problem(seed, 6, 4, 4, 0.5)
    found = expanded(problem, 20)
    best = least_energy(problem)
    assert best * (1.0 - 1e-9) <= found.energy.total
    # Boykov et al.: data costs of the best count once, its seams twice, times the largest ratio of
    # seams; that is no bound to test against. What is found here is nearly always the best.
    assert found.energy.total <= 1.1 * best


def test_nearly_all_small_problems_are_solved():
    ratios = []
    for seed in range(25):
        problem = random_problem(1000 + seed, 6, 4, 4, 0.5)
        ratios.append(expanded(problem, 20).energy.total / least_energy(problem))
    assert np.mean(np.array(ratios) < 1.0 + 1e-9) > 0.85


def test_energy_never_rises():
    problem = random_problem(5, 200, 8, 150, 0.4, chance=0.5)
    found = expanded(problem, 20)
    totals = [found.before.total, *(cycle.total for cycle in found.cycles)]
    assert (np.diff(totals) <= 0.0).all()
    assert totals[-1] < totals[0]
    assert found.converged
    assert totals[-1] == totals[-2]
    assert found.lower_bound <= totals[-1]
    assert found.moves[0] >= found.moves[1] > 0


@pytest.mark.parametrize("smoothness", [0.3, 1.0])
def test_equal_seams_are_labelled_as_well_as_by_another_solver(smoothness):
    """With equal seams the costs are Potts', which PyMaxflow's own expansion solves on grids."""
    side, labels = 12, 4
    rng = np.random.default_rng(3)
    data = rng.random((side, side, labels))
    # Colours at equal distances from each other: corners of a tetrahedron.
    corners = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float)[:, None]
    number = np.arange(side * side).reshape(side, side)
    edges = np.concatenate(
        [
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1),
            np.stack([number[:-1].ravel(), number[1:].ravel()], 1),
        ]
    )
    problem = problem_of(
        [list(range(labels))] * side**2,
        data.reshape(-1, labels).tolist(),
        [tuple(edge) for edge in edges.tolist()],
        [dict(enumerate(corners))] * len(edges),
        smoothness=smoothness / np.sqrt(2.0),
    )
    potts = smoothness * (1.0 - np.eye(labels))
    other = maxflow.fastmin.aexpansion_grid(data, potts).ravel().astype(np.int32)
    found = expanded(problem, 50)
    theirs = plain_energy(problem, other.tolist())
    assert found.energy.total == pytest.approx(theirs, rel=0.01)
    assert found.energy.total < 0.99 * found.before.total


def test_a_seam_goes_where_both_photographs_look_alike():
    """A strip whose ends are bound to one photograph each changes over at the only free edge."""
    n, free = 30, 19
    rng = np.random.default_rng(0)
    colors = []
    for e in range(n - 1):
        one = rng.random((2, 3))
        colors.append({0: one, 1: one if e == free else one * 0.3})
    candidates = [[0]] + [[0, 1]] * (n - 2) + [[1]]
    costs = [[0.0] * len(c) for c in candidates]
    found = expanded(problem_of(candidates, costs, [(k, k + 1) for k in range(n - 1)], colors))
    assert found.labels.tolist() == [0] * (free + 1) + [1] * (n - 1 - free)
    assert found.energy.total == 0.0
    assert found.gap == 0.0


def test_what_is_left_out_is_in_no_best_labelling():
    for seed in range(8):
        problem = random_problem(seed, 6, 4, 3, 0.05)
        lean = without_dominated(problem)
        assert len(lean.labels) < len(problem.labels)
        assert least_energy(lean) == pytest.approx(least_energy(problem), rel=1e-12)


def test_identical_pictures_leave_the_data_alone():
    problem = random_problem(1, 50, 5, 30)
    same = replace(problem, edge_colors=np.full_like(problem.edge_colors, 12345))
    found = expanded(same)
    assert found.labels.tolist() == same.cheapest().tolist()
    assert found.gap == 0.0


def test_seams_that_cost_too_much_are_not_made():
    problem = random_problem(2, 40, 3, 30, smoothness=1e12, chance=1.0)
    found = expanded(problem, 10)
    assert len(set(found.labels.tolist())) == 1
    assert found.energy.smoothness == 0.0


def test_islands_and_triangles_without_candidates():
    black, white = np.zeros((1, 3)), np.ones((1, 3))
    problem = problem_of(
        [[], [4], [1, 2], []],
        [[], [9.0], [2.0, 1.0], []],
        [(0, 1), (0, 3)],
        [{4: white}, {1: black}],
    )
    assert expanded(problem).labels.tolist() == [-1, 4, 2, -1]
    nothing = expanded(problem_of([[], []], [[], []], [(0, 1)], [{}]))
    assert nothing.labels.tolist() == [-1, -1]
    assert nothing.converged
    assert expanded(problem_of([], [], [], [])).labels.shape == (0,)


def test_the_same_again():
    problem = random_problem(9, 300, 10, 200, 0.3, chance=0.4)
    one, other = expanded(problem), expanded(problem)
    assert (one.labels == other.labels).all()
    assert one.energy == other.energy


def test_colors_that_nearly_break_the_triangle_inequality():
    """Three colours in line: what one pair costs is the sum of the others, but for rounding."""
    colors = [{k: np.full((3, 3), v / FULL_COLOR) for k, v in enumerate((1000, 33333, 65521))}] * 59
    rng = np.random.default_rng(0)
    problem = problem_of(
        [[0, 1, 2]] * 60, rng.random((60, 3)).tolist(), [(k, k + 1) for k in range(59)], colors
    )
    assert expanded(problem, 10).converged


def test_negative_cycles_are_refused():
    with pytest.raises(InputError, match="cycles"):
        expanded(random_problem(0), -1)
