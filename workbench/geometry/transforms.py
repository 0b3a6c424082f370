"""Rigid transforms as 4×4 float64 matrices, named ``target_from_source``.

``b_from_a @ a_from_w`` chains; ``apply(b_from_a, points_in_a)`` moves points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Matrix4 = NDArray[np.float64]


def rigid(rotation: ArrayLike, translation: ArrayLike) -> Matrix4:
    """4×4 matrix of ``x_b = rotation @ x_a + translation``."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def from_quaternion_xyzw(quaternion: ArrayLike, translation: ArrayLike) -> Matrix4:
    """4×4 matrix from a quaternion (x, y, z, w; any non-zero length) and a translation."""
    return rigid(Rotation.from_quat(np.asarray(quaternion, float)).as_matrix(), translation)


def from_twist(twist: ArrayLike) -> Matrix4:
    """Rotation vector (rad, first three) and translation (last three) to a 4×4 matrix.

    The translation is applied after the rotation; it is not the se(3) exponential.
    """
    twist = np.asarray(twist, float)
    return rigid(Rotation.from_rotvec(twist[:3]).as_matrix(), twist[3:])


def looking_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Matrix4:
    """4×4 pose of a camera or scanner at ``position`` that looks at ``target``.

    Its frame has its origin in the optical centre, x to the right, y down, z forward.
    """
    origin = np.asarray(position, float)
    forward = np.asarray(target, float) - origin
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, float))
    right /= np.linalg.norm(right)
    return rigid(np.column_stack([right, np.cross(forward, right), forward]), origin)


def inverse(b_from_a: Matrix4) -> Matrix4:
    """``a_from_b`` of a rigid matrix, exact in form: Rᵀ and −Rᵀt."""
    rotation = b_from_a[:3, :3].T
    return rigid(rotation, -rotation @ b_from_a[:3, 3])


def apply(b_from_a: Matrix4, points_in_a: ArrayLike) -> NDArray[np.float64]:
    """Points (..., 3) of frame a in frame b."""
    points = np.asarray(points_in_a, float)
    return points @ b_from_a[:3, :3].T + b_from_a[:3, 3]


def rotate(b_from_a: Matrix4, directions_in_a: ArrayLike) -> NDArray[np.float64]:
    """Directions (..., 3) of frame a in frame b."""
    return np.asarray(directions_in_a, float) @ b_from_a[:3, :3].T


def rotation_angle_deg(b_from_a: Matrix4) -> float:
    """Angle of the rotation part in degrees, in [0, 180]; accurate near zero."""
    return float(np.degrees(Rotation.from_matrix(b_from_a[:3, :3]).magnitude()))


def is_rigid(matrix: ArrayLike, tolerance: float = 1e-4) -> bool:
    """Whether a 4×4 matrix is a finite proper rigid transform to within ``tolerance``."""
    m = np.asarray(matrix, float)
    if m.shape != (4, 4) or not np.isfinite(m).all():
        return False
    r = m[:3, :3]
    return bool(
        np.abs(r @ r.T - np.eye(3)).max() <= tolerance
        and np.linalg.det(r) > 0
        and np.abs(m[3] - [0, 0, 0, 1]).max() <= tolerance
    )


def nearest_rigid(matrix: ArrayLike) -> Matrix4:
    """The rigid matrix whose rotation is closest in the Frobenius norm (SVD projection)."""
    m = np.asarray(matrix, float)
    u, _, vt = np.linalg.svd(m[:3, :3])
    return rigid(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, m[:3, 3])


def best_rigid(points_in_a: NDArray[np.float64], points_in_b: NDArray[np.float64]) -> Matrix4:
    """``b_from_a`` that brings paired points (n, 3) closest in the least-squares sense.

    Kabsch 1976; never a reflection. At least three points that are not in line define it.
    """
    mean_a, mean_b = points_in_a.mean(axis=0), points_in_b.mean(axis=0)
    u, _, vt = np.linalg.svd((points_in_b - mean_b).T @ (points_in_a - mean_a))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rigid(rotation, mean_b - rotation @ mean_a)
