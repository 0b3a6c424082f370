"""Orders of elimination: complete, and with little fill where orders by degree have much."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from workbench.texturing.dissection import dissected


def laplacian(mesh) -> csr_array:
    n, triangles = len(mesh.vertices), mesh.triangles
    pairs = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    ties = coo_array((-np.ones(len(pairs)), pairs.T), (n, n))
    ties = csr_array(0.5 * (ties + ties.T))
    return csr_array(ties + diags_array(0.01 - np.asarray(ties.sum(axis=1)).ravel()))


def test_a_regular_ball_fills_up_little(sphere):
    mesh = sphere(subdivisions=5)
    matrix = laplacian(mesh)
    order = dissected(matrix, mesh.vertices)
    assert sorted(order) == list(range(len(order)))
    turned = csc_array(matrix[order][:, order])
    how = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    factors = splu(turned, permc_spec="NATURAL", **how)
    n = len(order)
    # George: 31 / 4 · n log₂ n / 2 entries of L for square grids, and U once more.
    assert factors.nnz < 31 / 4 * n * np.log2(n)
    right = np.random.default_rng(0).normal(size=n)
    found = np.empty(n)
    found[order] = factors.solve(right[order])
    np.testing.assert_allclose(matrix @ found, right, atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 65, 300])
def test_any_points_even_all_in_one_place(count):
    matrix = csr_array(diags_array(np.ones(count)) if count else np.zeros((0, 0)))
    for points in (np.zeros((count, 3)), np.random.default_rng(1).normal(size=(count, 3))):
        assert sorted(dissected(matrix, points)) == list(range(count))
