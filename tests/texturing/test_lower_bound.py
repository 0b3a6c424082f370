"""The bound is below the best labelling, reaches it on trees, and the relaxation's elsewhere."""

import numpy as np
import pytest
from scipy.optimize import linprog

from tests.texturing.labelling_cases import least_energy, problem_of, random_problem
from workbench.kernels.pair_costs import difference
from workbench.texturing.expansion import expanded
from workbench.texturing.lower_bound import lower_bound


@pytest.mark.parametrize("sweeps", [0, 1, 3, 30])
@pytest.mark.parametrize("seed", range(8))
def test_no_labelling_is_below(seed, sweeps):
    problem = random_problem(seed, 7, 3, 5, 0.8)
    assert lower_bound(problem, sweeps) <= least_energy(problem) * (1.0 + 1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_more_sweeps_never_lower_it(seed):
    problem = random_problem(seed, 60, 5, 40, 0.5)
    bounds = [lower_bound(problem, sweeps) for sweeps in (0, 1, 2, 5, 20)]
    assert (np.diff(bounds) >= 0.0).all()
    assert bounds[-1] > bounds[0]


@pytest.mark.parametrize("seed", range(8))
def test_exact_on_trees(seed):
    problem = random_problem(seed, 8, 3, 0, 0.8, tree=True)
    assert lower_bound(problem, 100) == pytest.approx(least_energy(problem), rel=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_as_tight_as_linear_programming(seed):
    problem = random_problem(seed, 10, 3, 8, 0.8)
    relaxed = relaxation(problem)
    bound = lower_bound(problem, 300)
    assert bound <= relaxed * (1.0 + 1e-9)
    assert bound >= 0.99 * relaxed


def test_triangles_without_candidates():
    colors = [{1: np.zeros((1, 3)), 2: np.ones((1, 3))}] * 2
    problem = problem_of([[1, 2], [], [2]], [[1, 1.5], [], [2]], [(0, 1), (1, 2)], colors)
    assert lower_bound(problem, 3) == 3.0
    assert lower_bound(problem_of([], [], [], []), 3) == 0.0


def test_it_says_how_good_a_labelling_is():
    found = expanded(random_problem(0, 400, 6, 150, 0.3), 10, bound_sweeps=30)
    assert 0.0 <= found.gap < 0.02


def relaxation(problem):
    """The local polytope's optimum, by SciPy."""
    count = len(problem.labels)
    costs = problem.costs.tolist()
    equations, right = [], []
    for t in range(problem.triangles):
        equations.append(dict.fromkeys(range(problem.starts[t], problem.starts[t + 1]), 1.0))
        right.append(1.0)
    for e, (p, q) in enumerate(problem.edges):
        first = problem.edge_starts[e]
        own = problem.edge_labels[first : problem.edge_starts[e + 1]].tolist()
        ps = range(problem.starts[p], problem.starts[p + 1])
        qs = range(problem.starts[q], problem.starts[q + 1])
        at = {}
        for a in ps:
            for b in qs:
                at[a, b] = count + len(costs) - len(problem.costs)
                rows = [first + own.index(problem.labels[k]) for k in (a, b)]
                seam = difference(problem.edge_colors, *rows)
                costs.append(problem.smoothness * problem.edge_lengths[e] * seam)
        for a in ps:
            equations.append({a: -1.0} | {at[a, b]: 1.0 for b in qs})
            right.append(0.0)
        for b in qs:
            equations.append({b: -1.0} | {at[a, b]: 1.0 for a in ps})
            right.append(0.0)
    matrix = np.zeros((len(equations), len(costs)))
    for k, equation in enumerate(equations):
        matrix[k, list(equation)] = list(equation.values())
    return linprog(costs, A_eq=matrix, b_eq=right, bounds=(0, None)).fun
