"""Octrees of points as COPC and Potree files hold them: every point in one node.

The points of a node and of all above it are a coarse picture of what the node covers; each
level adds to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.formats.point_rounding import Rounding
from workbench.geometry.point_set import PointSet

CELLS = 128
"""Along an axis of a node: it has a point, or one above it has, wherever a cell has one."""


@dataclass(frozen=True, order=True)
class NodeKey:
    """A node: one of 2^level cells of the root cube along each axis, and its place there."""

    level: int
    x: int
    y: int
    z: int

    @property
    def parent(self) -> NodeKey:
        """The node that holds this one, which is not the root."""
        return NodeKey(self.level - 1, self.x // 2, self.y // 2, self.z // 2)

    def inside(self, other: NodeKey) -> bool:
        """Whether this node is ``other`` or lies in it."""
        up = self.level - other.level
        return up >= 0 and (self.x >> up, self.y >> up, self.z >> up) == (other.x, other.y, other.z)


@dataclass(frozen=True)
class OctreeNode:
    """Some points of a node; a node may come without any.

    Attributes
    ----------
    key : which node.
    whole : (n, 3) int32 coordinates by the octree's rounding.
    points : the same points, coordinates rounded.
    """

    key: NodeKey
    whole: NDArray[np.int32]
    points: PointSet


@dataclass(frozen=True)
class Cube:
    """The root of an octree in whole numbers: ``low`` (3,) int64, and its side.

    Points lie at ``low`` or beyond and before ``low + side``.
    """

    low: NDArray[np.int64]
    side: int

    def placed(self, rounding: Rounding) -> tuple[NDArray[np.float64], float]:
        """Low corner (3,) and side in the unit of the points."""
        return rounding.origin + self.low * rounding.step, self.side * rounding.step


class PointOctree(Protocol):
    """What writers of octrees take.

    Attributes
    ----------
    rounding : of coordinates.
    cube : the root.
    count : points of all nodes.
    attributes : which of ``normals``, ``color`` and ``radius`` points have.
    """

    rounding: Rounding
    cube: Cube
    count: int
    attributes: frozenset[str]

    def nodes(self) -> Iterator[OctreeNode]:
        """Every node once, in whatever order, with all of its points; no parent is missing."""
        ...
