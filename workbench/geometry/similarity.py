"""Similarity transforms: a scale, a rotation and a shift between two frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry.transforms import Matrix4, rigid

# Points whose spread across a line is this far below that along it are in line.
_IN_LINE = 1e-6
# Coordinates carry about 1e-16 of their size; a spread near that is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Similarity:
    """``x_b = scale · rotation @ x_a + shift``.

    Attributes
    ----------
    scale : positive; units of b per unit of a.
    rotation : (3, 3) float64, proper.
    shift : (3,) float64, in units of b.
    """

    scale: float
    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]

    def apply(self, points_in_a: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of frame a in frame b."""
        return self.scale * (np.asarray(points_in_a, float) @ self.rotation.T) + self.shift

    def inverse(self) -> Similarity:
        """``a_from_b``."""
        back = self.rotation.T
        return Similarity(1.0 / self.scale, back, -(back @ self.shift) / self.scale)

    def camera_from_b(self, camera_from_a: Matrix4) -> Matrix4:
        """The rigid pose, in frame b, of a camera given in frame a.

        It sees ``apply(x)`` on the pixel where it saw x; depths grow by ``scale``.
        """
        rotation = camera_from_a[:3, :3] @ self.rotation.T
        return rigid(rotation, self.scale * camera_from_a[:3, 3] - rotation @ self.shift)

    def matrix(self) -> Matrix4:
        """The same as a 4×4 matrix; its rotation part carries the scale."""
        return rigid(self.scale * self.rotation, self.shift)


@dataclass(frozen=True)
class NoSimilarity:
    """Why points do not define a similarity; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


def best_similarity(
    points_in_a: NDArray[np.float64], points_in_b: NDArray[np.float64]
) -> Similarity | NoSimilarity:
    """``b_from_a`` that brings paired points (n, 3) closest in the least-squares sense.

    Source: Umeyama 1991, eqs. 40–42; never a reflection. `NoSimilarity`, which is falsy, where
    fewer than three pairs are given, a value is not finite, the points of a frame coincide
    or lie in line, or the pairs say nothing about the rotation.

    Raises
    ------
    ValueError
        The arrays are not (n, 3) of the same n.
    """
    a, b = np.asarray(points_in_a, float), np.asarray(points_in_b, float)
    if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
        raise ValueError(f"two arrays (n, 3) of the same n are expected, not {a.shape}, {b.shape}")
    if len(a) < 3:
        return NoSimilarity(f"three pairs of points are needed, there are {len(a)}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return NoSimilarity("a coordinate is not finite")
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    from_a, from_b = a - mean_a, b - mean_b
    for points, centred in ((a, from_a), (b, from_b)):
        along, across, _ = np.linalg.svd(centred, compute_uv=False)
        if along <= _ROUNDING * np.sqrt(len(points)) * np.abs(points).max():
            return NoSimilarity("the points coincide")
        if across <= _IN_LINE * along:
            return NoSimilarity("the points lie in line, which leaves the turn about it open")
    u, s, vt = np.linalg.svd(from_b.T @ from_a)
    if s[1] <= _IN_LINE * s[0]:
        return NoSimilarity("the pairs leave the rotation open")
    sign = np.array([1.0, 1.0, np.linalg.det(u @ vt)])
    rotation = (u * sign) @ vt
    scale = float((s * sign).sum() / (from_a**2).sum())
    return Similarity(scale, rotation, mean_b - scale * (rotation @ mean_a))
