"""Energies as eq. 1 says, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.texturing.labelling_cases import choices, plain_energy, problem_of, random_problem
from workbench.errors import InputError
from workbench.texturing.labelling import Energy, Labelling


def test_energy_of_a_hand_made_seam():
    red, blue = np.array([[1.0, 0, 0]] * 2), np.array([[0, 0, 1.0]] * 2)
    problem = problem_of(
        [[3, 7], [3, 7]], [[1.0, 2.0], [4.0, 0.5]], [(0, 1)], [{3: red, 7: blue}], [0.25], 0.2
    )
    energy = problem.energy(np.array([3, 7], np.int32))
    assert energy.data == 1.5
    assert energy.smoothness == pytest.approx(0.2 * 0.25 * np.sqrt(2.0), rel=1e-12)
    assert problem.energy(np.array([3, 3], np.int32)).total == 5.0


@pytest.mark.parametrize("seed", range(5))
def test_energy_is_that_of_loops(seed):
    problem = random_problem(seed)
    for labels in list(choices(problem))[::7]:
        found = problem.energy(np.array(labels, np.int32)).total
        assert found == pytest.approx(plain_energy(problem, labels), rel=1e-12)


def test_triangles_without_candidates_cost_nothing():
    colors = [{1: np.zeros((1, 3)), 2: np.ones((1, 3))}] * 2
    problem = problem_of([[1, 2], [], [2]], [[1, 1.5], [], [2]], [(0, 1), (1, 2)], colors)
    assert problem.cheapest().tolist() == [1, -1, 2]
    assert problem.energy(problem.cheapest()) == Energy(3.0, 0.0)


def test_the_first_of_equally_cheap_candidates():
    problem = problem_of([[2, 5, 9]], [[1.0, 0.5, 0.5]], [], [])
    assert problem.cheapest().tolist() == [5]


def test_labels_that_are_no_candidates_are_refused():
    problem = problem_of([[1], [2]], [[1.0], [1.0]], [], [])
    for wrong in ([1, 1], [1, -1]):
        with pytest.raises(InputError, match="not among the candidates"):
            problem.energy(np.array(wrong, np.int32))


@pytest.mark.parametrize("cost", [np.nan, np.inf, -1.0])
def test_costs_that_are_no_costs_are_refused(cost):
    problem = random_problem(0)
    with pytest.raises(InputError, match="data costs"):
        replace(problem, costs=np.where(np.arange(len(problem.costs)) == 2, cost, problem.costs))
    with pytest.raises(InputError, match="smoothness"):
        replace(problem, smoothness=cost)
    with pytest.raises(InputError, match="edge lengths"):
        replace(problem, edge_lengths=problem.edge_lengths * cost)


def test_candidates_that_do_not_rise_are_refused():
    problem = problem_of([[1, 4], [1]], [[1.0, 2.0], [1.0]], [], [])
    with pytest.raises(InputError, match="must rise"):
        replace(problem, labels=np.array([4, 1, 1], np.int32))
    # Equal across a border of two triangles is fine, also where an empty one lies between.
    assert problem_of([[3], [], [3]], [[1.0], [], [1.0]], [], []).triangles == 3


def test_gap():
    found = Labelling(np.zeros(1, np.int32), Energy(4, 4), (Energy(3, 1),), True, 3.0, (1, 1), 0.0)
    assert found.gap == 0.25
    assert found.energy.total == 4.0
