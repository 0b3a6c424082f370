"""Normal equations against plain products of whole matrices of derivatives."""

from __future__ import annotations

import numpy as np

from workbench.orientation.normal_equations import Dependence, Linearised


def test_they_are_the_products_of_whole_matrices() -> None:
    """Two lenses of unlike size, a point that one image sees twice, and one that none sees."""
    rng = np.random.default_rng(3)
    camera_of_image, lens_sizes, points = np.array([0, 1, 0]), (2, 4), 6
    seen_image = np.array([0, 0, 0, 1, 1, 1, 2, 2, 0])
    seen_point = np.array([0, 1, 5, 0, 1, 2, 2, 5, 5])
    depends = Dependence.of(seen_image, seen_point, camera_of_image, lens_sizes, points)
    count = len(seen_image)
    assert depends.count == 6 * 3 + 2 + 4
    by_camera, by_point = rng.normal(size=(count, 2, 6 + 4)), rng.normal(size=(count, 2, 3))
    residuals, weights = rng.normal(size=(count, 2)), rng.uniform(0.2, 1, count)
    whole = np.zeros((count, 2, depends.count + 3 * points))
    for m, (image, point) in enumerate(zip(seen_image, seen_point, strict=True)):
        lens = camera_of_image[image]
        first, size = 18 + sum(lens_sizes[:lens]), lens_sizes[lens]
        whole[m, :, 6 * image : 6 * image + 6] = by_camera[m, :, :6]
        whole[m, :, first : first + size] = by_camera[m, :, 6 : 6 + size]
        begin = depends.count + 3 * point
        whole[m, :, begin : begin + 3] = by_point[m]
    system = Linearised.empty(depends)
    for part in (slice(0, 4), slice(4, count)):
        system.add(
            *(part, seen_point[part], by_camera[part], by_point[part]),
            *(residuals[part], weights[part], 0.5),
        )
    system.mirror()
    hessian = np.einsum("m,mka,mkb->ab", weights / 0.25, whole, whole)
    gradient = np.einsum("m,mka,mk->a", weights / 0.25, whole, residuals)
    cameras = slice(0, depends.count)
    np.testing.assert_allclose(system.camera_hessian, hessian[cameras, cameras], atol=1e-12)
    np.testing.assert_allclose(system.camera_gradient, gradient[cameras], atol=1e-12)
    np.testing.assert_allclose(system.point_gradient.ravel(), gradient[depends.count :], atol=1e-12)
    for point in range(points):
        own = slice(depends.count + 3 * point, depends.count + 3 * point + 3)
        np.testing.assert_allclose(system.point_hessian[point], hessian[own, own], atol=1e-12)
        coupling = system.coupling.toarray()[3 * point : 3 * point + 3]
        np.testing.assert_allclose(coupling, hessian[own, cameras], atol=1e-12)
    np.testing.assert_array_equal(system.weights, weights)
