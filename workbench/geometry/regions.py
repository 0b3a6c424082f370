"""Regions of space a cloud is asked for: which boxes they meet, which points they hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.errors import SettingsError
from workbench.geometry.transforms import Matrix4


class Region(Protocol):
    """A closed part of space."""

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(k,) bool for k boxes, corners (k, 3): False only where a box is surely outside."""
        ...

    def covers(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(k,) bool for k boxes: True only where a box is wholly inside."""
        ...

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) bool for points (n, 3); the boundary belongs to the region."""
        ...

    def shifted(self, offset: NDArray[np.float64]) -> Region:
        """The same region moved by ``offset`` (3,)."""
        ...

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) a point that moves along with the region."""
        ...


@dataclass(frozen=True)
class Box:
    """Axis-parallel box, faces included; faces may be infinite.

    Attributes
    ----------
    low, high : (3,) float64, metres.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            object.__setattr__(self, name, _vector(getattr(self, name), f"the box's {name}"))
        if not (self.low <= self.high).all():
            raise SettingsError(
                "the box is inside out",
                expected="low ≤ high on every axis",
                found=f"{self.low.tolist()} and {self.high.tolist()}",
            )

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(((low <= self.high) & (high >= self.low)).all(axis=1))

    def covers(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(((low >= self.low) & (high <= self.high)).all(axis=1))

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        # Axis by axis: a reduction over rows of three costs several times as much.
        inside = np.ones(len(points), bool)
        for axis in np.flatnonzero(np.isfinite(self.low) | np.isfinite(self.high)):
            inside &= (points[:, axis] >= self.low[axis]) & (points[:, axis] <= self.high[axis])
        return inside

    def shifted(self, offset: NDArray[np.float64]) -> Box:
        return Box(self.low + offset, self.high + offset)

    @property
    def center(self) -> NDArray[np.float64]:
        # A face at infinity has no middle; what moves is the finite part.
        ends = [np.where(np.isfinite(v), v, 0.0) for v in (self.low, self.high)]
        return np.asarray(0.5 * ends[0] + 0.5 * ends[1])


@dataclass(frozen=True)
class Sphere:
    """Ball of ``radius_m`` ≥ 0 round ``middle`` (3,), surface included."""

    middle: NDArray[np.float64]
    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "middle", _vector(self.middle, "the sphere's middle"))
        if not self.radius_m >= 0.0 or not np.isfinite(self.middle).all():
            raise SettingsError(
                "the sphere has no size or place",
                expected="a finite middle and a radius of 0 or more",
                found=f"{self.middle.tolist()} and {self.radius_m}",
            )

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        # The factor leaves room for rounding: a box is dropped only when surely outside.
        nearest = np.clip(self.middle, low, high) - self.middle
        return np.asarray((nearest**2).sum(axis=1) <= self.radius_m**2 * (1 + 1e-12))

    def covers(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        farthest = np.maximum(np.abs(low - self.middle), np.abs(high - self.middle))
        return np.asarray((farthest**2).sum(axis=1) < self.radius_m**2 * (1 - 1e-12))

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        x, y, z = (points - self.middle).T
        return np.asarray(x * x + y * y + z * z <= self.radius_m**2)

    def shifted(self, offset: NDArray[np.float64]) -> Sphere:
        return Sphere(self.middle + offset, self.radius_m)

    @property
    def center(self) -> NDArray[np.float64]:
        return self.middle


@dataclass(frozen=True)
class Frustum:
    """What a pinhole camera sees between two depths, boundary included.

    Attributes
    ----------
    world_from_camera : 4×4 rigid; the camera looks along +z, x to the right, y down.
    half_width, half_height : tangents of half the opening angles, > 0.
    near_m, far_m : depths along z, 0 ≤ near < far < ∞.
    """

    world_from_camera: Matrix4
    half_width: float
    half_height: float
    near_m: float
    far_m: float

    def __post_init__(self) -> None:
        if (
            not (self.half_width > 0 and self.half_height > 0 and 0 <= self.near_m < self.far_m)
            or not np.isfinite([self.half_width, self.half_height, self.far_m]).all()
            or np.shape(self.world_from_camera) != (4, 4)
            or not np.isfinite(self.world_from_camera).all()
        ):
            raise SettingsError(
                "the frustum holds no space",
                expected="a finite pose, openings above 0 and 0 ≤ near < far",
                found=f"openings {self.half_width}, {self.half_height}, depths "
                f"{self.near_m} to {self.far_m}",
            )

    @property
    def _planes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Outward normals (6, 3) in the camera and offsets (6,): inside is n · x ≤ d."""
        w, h = self.half_width, self.half_height
        normals = np.array([[1, 0, -w], [-1, 0, -w], [0, 1, -h], [0, -1, -h], [0, 0, -1],
                            [0, 0, 1]])  # fmt: skip
        return normals, np.array([0, 0, 0, 0, -self.near_m, self.far_m])

    def _heights(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 6) how far points lie outside each plane; offsets first, they may be large."""
        normals, offsets = self._planes
        seen = (points - self.center) @ self.world_from_camera[:3, :3]
        return np.asarray(seen @ normals.T - offsets)

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        least, _, room = self._height_range(low, high)
        return np.asarray((least <= room).all(axis=1))

    def covers(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        _, most, room = self._height_range(low, high)
        return np.asarray((most < -room).all(axis=1))

    def _height_range(
        self, low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(k, 6) least and most over each box, and the rounding (k, 1) to allow for."""
        normals = self._planes[0] @ self.world_from_camera[:3, :3].T
        middle = self._heights(0.5 * (low + high))
        reach = 0.5 * (high - low) @ np.abs(normals).T
        size = np.abs(low) + np.abs(high) + np.abs(self.center) + self.far_m
        room = 1e-13 * size.max(axis=1, keepdims=True) * (1 + self.half_width + self.half_height)
        return middle - reach, middle + reach, room

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        heights = self._heights(points)
        return np.asarray(np.logical_and.reduce([h <= 0.0 for h in heights.T]))

    def shifted(self, offset: NDArray[np.float64]) -> Frustum:
        moved = self.world_from_camera.copy()
        moved[:3, 3] += offset
        return Frustum(moved, self.half_width, self.half_height, self.near_m, self.far_m)

    @property
    def center(self) -> NDArray[np.float64]:
        return self.world_from_camera[:3, 3]


def _vector(value: ArrayLike, what: str) -> NDArray[np.float64]:
    try:
        vector = np.array(value, float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or np.isnan(vector).any():
        raise SettingsError(f"{what} is no place", expected="three numbers", found=str(value))
    return vector


#: All of space.
EVERYWHERE = Box(np.full(3, -np.inf), np.full(3, np.inf))
