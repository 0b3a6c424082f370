"""The kernels that compare keypoints against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.kernels.compatible_pairs import compatible_pairs
from workbench.kernels.feature_matching import closest_descriptors


@pytest.mark.parametrize("k", [1, 3, 40])
def test_closest_descriptors_are_those_of_a_full_table(k: int) -> None:
    rng = np.random.default_rng(k)
    asking, among = (rng.normal(size=(n, 33)).astype(np.float32) for n in (60, 40))
    table = np.linalg.norm(asking[:, None].astype(float) - among, axis=2)
    assert np.array_equal(closest_descriptors(asking, among, k), np.argsort(table, axis=1)[:, :k])


def test_of_equals_the_first_comes_first_and_bad_requests_are_refused() -> None:
    same = np.zeros((5, 4), np.float32)
    assert closest_descriptors(same[:1], same, 3).tolist() == [[0, 1, 2]]
    for k, among in ((0, same), (6, same), (1, same[:, :3])):
        with pytest.raises(ValueError, match="closest"):
            closest_descriptors(same, among, k)


def reference(p, n, q, m, tolerance, least, angle) -> np.ndarray:
    def features(points, normals):
        gap = points[None] - points[:, None]
        distance = np.linalg.norm(gap, axis=2)
        line = gap / np.where(distance > 0, distance, 1)[:, :, None]
        cosines = (
            normals @ normals.T,
            np.einsum("ik,ijk->ij", normals, line),
            np.einsum("jk,ijk->ij", normals, line),
        )
        return distance, *(np.arccos(np.clip(c, -1, 1)) for c in cosines)

    a, b = features(p, n), features(q, m)
    fits = (np.abs(a[0] - b[0]) < tolerance) & (np.minimum(a[0], b[0]) > least)
    for there, here in zip(a[1:], b[1:], strict=True):
        fits &= np.abs(there - here) < angle
    return fits


def test_compatible_pairs_are_those_of_the_formulas() -> None:
    rng = np.random.default_rng(0)
    p, q = rng.normal(size=(2, 80, 3))
    q[:40] = p[:40] + rng.normal(scale=0.02, size=(40, 3))
    n, m = rng.normal(size=(2, 80, 3))
    m[:50] = n[:50] + rng.normal(scale=0.2, size=(50, 3))
    n, m = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (n, m))
    limits = (0.1, 0.4, 0.5)
    found = compatible_pairs(p, n, q, m, *limits)
    assert np.array_equal(found > 0, reference(p, n, q, m, *limits))
    assert np.array_equal(found, found.T)
    assert not found.diagonal().any()
    assert 100 < found.sum() < 3000
