from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from workbench.geometry import transforms

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0, 5e6])
def test_the_inverse_brings_points_back(scale: float) -> None:
    pose = transforms.from_twist([0.4, -1.1, 0.7, *(scale * np.array([1.0, -2.0, 3.0]))])
    points = RNG.normal(size=(50, 3))
    back = transforms.apply(transforms.inverse(pose), transforms.apply(pose, points))
    assert np.abs(back - points).max() <= 4e-15 * max(1.0, scale)
    assert np.allclose(transforms.inverse(transforms.inverse(pose)), pose, rtol=1e-14, atol=1e-15)


def test_a_twist_is_the_matrix_exponential_of_its_rotation_then_the_shift() -> None:
    for _ in range(20):
        turn, shift = RNG.normal(size=3), RNG.normal(size=3)
        x, y, z = turn
        expected = expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
        pose = transforms.from_twist([*turn, *shift])
        assert np.allclose(pose[:3, :3], expected, atol=1e-13)
        assert np.array_equal(pose[:3, 3], shift)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-6, 1e-3, 1.0, np.pi - 1e-6])
def test_angles_are_told_even_near_zero(angle: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    pose = transforms.from_twist([*(angle * axis), 0, 0, 0])
    assert transforms.rotation_angle_deg(pose) == pytest.approx(np.degrees(angle), rel=1e-6)


def test_no_rotation_is_an_angle_of_zero() -> None:
    assert transforms.rotation_angle_deg(np.eye(4)) == 0.0


def test_directions_do_not_feel_the_translation() -> None:
    pose = transforms.rigid([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [10, 20, 30])
    assert np.array_equal(transforms.rotate(pose, [1.0, 0, 0]), [0, 1, 0])
    assert np.array_equal(transforms.apply(pose, [1.0, 0, 0]), [10, 21, 30])


def test_chaining_reads_from_right_to_left() -> None:
    b_from_a = transforms.from_twist([0.1, 0.2, 0.3, 1, 2, 3])
    c_from_b = transforms.from_twist([-0.5, 0.1, 0.9, -4, 5, 6])
    point = np.array([0.3, -0.7, 2.0])
    step_by_step = transforms.apply(c_from_b, transforms.apply(b_from_a, point))
    assert np.allclose(transforms.apply(c_from_b @ b_from_a, point), step_by_step, atol=1e-14)


def test_a_quaternion_of_any_length_has_its_scalar_last() -> None:
    half = np.sqrt(0.5)
    pose = transforms.from_quaternion_xyzw(7.0 * np.array([0, 0, half, half]), [1, 2, 3])
    assert np.allclose(transforms.apply(pose, [1.0, 0, 0]), [1, 3, 3])


def test_the_nearest_rigid_matrix_is_no_further_than_any_other() -> None:
    for _ in range(10):
        matrix = np.eye(4)
        matrix[:3] = RNG.normal(size=(3, 4))
        best = transforms.nearest_rigid(matrix)
        assert transforms.is_rigid(best, 1e-12)
        assert np.array_equal(best[:3, 3], matrix[:3, 3])
        distance = np.linalg.norm(best[:3, :3] - matrix[:3, :3])
        for _ in range(50):
            other = transforms.from_twist([*RNG.normal(size=3) * 0.2, 0, 0, 0]) @ best
            assert np.linalg.norm(other[:3, :3] - matrix[:3, :3]) >= distance


def test_a_reflection_becomes_a_proper_rotation() -> None:
    best = transforms.nearest_rigid(np.diag([1.0, 1.0, -1.0, 1.0]))
    assert np.linalg.det(best[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([1.001, 1.001, 1.001, 1.0]),
        np.full((4, 4), np.nan),
        np.eye(3),
        np.eye(4) + np.eye(4)[[1, 2, 3, 0]] * 0.01,
        np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.1, 0, 0, 1.0]]),
    ],
    ids=["reflection", "scaled", "nan", "3x3", "sheared", "projective"],
)
def test_what_is_not_rigid_is_told(matrix: np.ndarray) -> None:
    assert not transforms.is_rigid(matrix)
