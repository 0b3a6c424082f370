"""Similarities: known ones found again, undefined ones refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.similarity import NoSimilarity, Similarity, best_similarity
from workbench.geometry.transforms import is_rigid, rigid

TURN = Rotation.from_rotvec([0.3, -1.9, 0.8]).as_matrix()
KNOWN = Similarity(2.5, TURN, np.array([10.0, -20.0, 5.0]))


def cloud(n: int = 30, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 3)) * [1.0, 2.0, 0.5]


@pytest.mark.parametrize("shift", [0.0, 5.4e6])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 400.0])
def test_a_known_similarity_is_found_again(scale: float, shift: float) -> None:
    a = cloud()
    known = Similarity(scale, TURN, np.array([shift, -shift, 1.0]))
    found = best_similarity(a, known.apply(a))
    assert isinstance(found, Similarity)
    assert found.scale == pytest.approx(scale, rel=1e-12 + 2e-16 * shift / scale * 10)
    np.testing.assert_allclose(found.apply(a), known.apply(a), atol=1e-12 * scale + 1e-15 * shift)


def test_points_in_a_plane_are_enough_and_never_mirrored() -> None:
    a = cloud() * [1.0, 1.0, 0.0]
    found = best_similarity(a, KNOWN.apply(a))
    assert isinstance(found, Similarity)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(found.rotation, TURN, atol=1e-12)


def test_a_mirror_image_gets_the_best_proper_rotation() -> None:
    a = cloud()
    b = a * [1.0, 1.0, -1.0]
    found = best_similarity(a, b)
    assert isinstance(found, Similarity)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)

    def residuals(x: np.ndarray) -> np.ndarray:
        turned = Rotation.from_rotvec(x[:3]).apply(a)
        return (np.exp(x[6]) * turned + x[3:6] - b).ravel()

    best = min(
        least_squares(residuals, [*Rotation.random(random_state=k).as_rotvec(), *np.zeros(4)]).cost
        for k in range(12)
    )
    assert 0.5 * ((found.apply(a) - b) ** 2).sum() == pytest.approx(best, rel=1e-6)


def test_noise_is_averaged() -> None:
    a = cloud(2000)
    noise = np.random.default_rng(1).normal(scale=0.01, size=a.shape)
    found = best_similarity(a, KNOWN.apply(a) + noise)
    assert isinstance(found, Similarity)
    # 2000 points of spread ~2.5 · 1.3 tell the scale to 0.01 / (3.3 √6000) ≈ 4e-5.
    assert 1e-7 < abs(found.scale / KNOWN.scale - 1) < 2e-4
    assert np.linalg.norm(found.shift - KNOWN.shift) < 2e-3


def test_the_inverse_undoes_it_and_the_matrix_says_the_same() -> None:
    a = cloud()
    np.testing.assert_allclose(KNOWN.inverse().apply(KNOWN.apply(a)), a, atol=1e-12)
    by_matrix = np.c_[a, np.ones(len(a))] @ KNOWN.matrix().T
    np.testing.assert_allclose(by_matrix[:, :3], KNOWN.apply(a), atol=1e-12)


def test_a_moved_camera_sees_moved_points_on_the_same_pixels() -> None:
    camera_from_a = rigid(Rotation.from_rotvec([0.1, 0.2, -0.4]).as_matrix(), [0.3, -0.1, 6.0])
    camera_from_b = KNOWN.camera_from_b(camera_from_a)
    assert is_rigid(camera_from_b, 1e-12)
    params = (500.0, 320.0, 240.0, 0.05)
    before, depth = PhotoCamera("SIMPLE_RADIAL", 640, 480, params, camera_from_a).project(cloud())
    after, deeper = PhotoCamera("SIMPLE_RADIAL", 640, 480, params, camera_from_b).project(
        KNOWN.apply(cloud())
    )
    np.testing.assert_allclose(after, before, atol=1e-9)
    np.testing.assert_allclose(deeper, 2.5 * depth, rtol=1e-12)


LINE = np.array([1e3, 0.0, 0.0]) + np.outer(np.arange(5.0), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("a", "b", "reason"),
    [
        (cloud(2), cloud(2), "three pairs"),
        (cloud(5) * np.nan, cloud(5), "not finite"),
        (np.full((5, 3), 1e6 + 0.1), cloud(5), "coincide"),
        (cloud(5), np.full((5, 3), 7.0), "coincide"),
        (LINE, cloud(5), "in line"),
        (cloud(5), LINE, "in line"),
        (
            np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]),
            np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 1, 0]]) * [1, 1, 0]
            + np.array([[0.0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0]]),
            "rotation open",
        ),
    ],
)
def test_what_defines_none_is_refused_with_its_reason(
    a: np.ndarray, b: np.ndarray, reason: str
) -> None:
    found = best_similarity(a, b)
    assert isinstance(found, NoSimilarity)
    assert not found
    assert reason in found.reason


def test_arrays_that_do_not_pair_are_an_error() -> None:
    with pytest.raises(ValueError, match="same n"):
        best_similarity(cloud(4), cloud(5))
