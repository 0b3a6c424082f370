"""Points taken out of normal equations one by one, against the plain product of matrices."""

import numpy as np

from workbench.kernels.normal_equations import eliminate_points


def test_it_is_the_product_of_the_whole_matrices() -> None:
    rng = np.random.default_rng(4)
    points, cameras = 40, 17
    depends = rng.random((points, cameras)) < 0.4
    depends[7] = False
    coupling = np.where(depends[:, None], rng.normal(size=(points, 3, cameras)), 0.0)
    root = rng.normal(size=(points, 3, 3))
    inverse = root @ root.transpose(0, 2, 1)
    whole = rng.normal(size=(cameras, cameras))
    reduced = whole + whole.T
    expected = reduced - np.einsum("pia,pij,pjb->ab", coupling, inverse, coupling)
    gradient, before = rng.normal(size=(points, 3)), rng.normal(size=cameras)
    right = before.copy()
    who, unknowns = np.nonzero(depends)
    starts = np.concatenate([[0], np.cumsum(depends.sum(axis=1))])
    blocks = coupling[who, :, unknowns]
    eliminate_points(reduced, right, starts, unknowns, blocks, inverse, gradient)
    np.testing.assert_allclose(reduced, expected, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(reduced, reduced.T)
    added = np.einsum("pia,pij,pj->a", coupling, inverse, gradient)
    np.testing.assert_allclose(right, before + added, rtol=0, atol=1e-11)
