"""Answers to rays, and who gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.raytracing.embree_scene import NO_TRIANGLE
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.visibility_front import VisibilityFront


@dataclass(frozen=True)
class RayHits:
    """What rays met first.

    Attributes
    ----------
    distances : (n,) float32 in lengths of the direction, infinite for nothing.
    triangles : (n,) int64 in the surface, ``NO_TRIANGLE`` for nothing.
    normals : (n, 3) float32 unit, as the triangle's winding says; 0 for nothing.
    colors : (n, 3) uint8 sRGB of the triangle; None for a surface without.
    """

    distances: NDArray[np.float32]
    triangles: NDArray[np.int64]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8] | None

    @classmethod
    def none_yet(cls, count: int, reach: float, *, colored: bool) -> RayHits:
        """Of rays that have met nothing as far as ``reach``, their distance until `ended`."""
        return cls(
            np.full(count, reach, np.float32),
            np.full(count, NO_TRIANGLE, np.int64),
            np.zeros((count, 3), np.float32),
            np.zeros((count, 3), np.uint8) if colored else None,
        )

    def ended(self) -> RayHits:
        """Distances of rays that met nothing are infinite."""
        self.distances[self.triangles == NO_TRIANGLE] = np.inf
        return self


@dataclass
class RayCounts:
    """What a caster has done.

    Attributes
    ----------
    rays : asked for.
    casts : times that rays were given to Embree, and ``rays_cast``, how many in all.
    queries : of pairs of a tile and a box.
    bytes_read : of geometry from the disk.
    """

    rays: int = 0
    casts: int = 0
    rays_cast: int = 0
    queries: int = 0
    bytes_read: int = 0


class RayCaster(Protocol):
    """A surface that answers rays, in its local frame.

    Attributes
    ----------
    frame : local frame of all rays and hits.
    in_core : whether the whole surface is in memory, and plain Embree answers.
    counts : of work done.
    """

    frame: LocalFrame
    in_core: bool
    counts: RayCounts

    def nearest(
        self,
        rays: NDArray[np.float32],
        reach: float = np.inf,
        front: VisibilityFront | None = None,
    ) -> RayHits:
        """What rays (n, 6), origin and direction, meet first within ``reach`` directions.

        Rays that are near in the list should be near in space. ``front`` remembers what this
        cast learned for the next like it.
        """
        ...

    def blocked(
        self,
        rays: NDArray[np.float32],
        reach: float = np.inf,
        front: VisibilityFront | None = None,
    ) -> NDArray[np.bool_]:
        """(n,) whether rays meet anything within ``reach``."""
        ...
