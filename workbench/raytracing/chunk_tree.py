"""A bounding-volume hierarchy over chunks that lie in the order of its leaves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

NODE = np.dtype(
    [
        ("low", "<f4", 3), ("high", "<f4", 3), ("left", "<i4"), ("right", "<i4"),
        ("first", "<u4"), ("count", "<u4"), ("triangles", "<u8"), ("height", "<u4"),
    ]
)  # fmt: skip
"""Box; children, −1 for a leaf; the chunks below, which follow one another; their triangles; and
the steps down to the deepest leaf."""


@dataclass(frozen=True)
class ChunkTree:
    """The hierarchy.

    Attributes
    ----------
    nodes : (n,) of dtype ``NODE``, the root first, children behind their parents.
    """

    nodes: NDArray[np.void]

    @cached_property
    def children(self) -> NDArray[np.int32]:
        """(n, 2), −1 for a leaf."""
        return np.stack([self.nodes["left"], self.nodes["right"]], axis=1).astype(np.int32)

    @cached_property
    def shares(self) -> NDArray[np.float32]:
        """(n,) area of each node's box, of the root's."""
        areas = box_area(self.nodes["low"].astype(np.float64), self.nodes["high"])
        return np.asarray(areas / areas[0] if areas[0] > 0.0 else np.ones_like(areas), np.float32)

    def boxes(self, padding: float) -> NDArray[np.float32]:
        """(n, 6) low and high corners, ``padding`` wider on every side."""
        low, high = self.nodes["low"] - padding, self.nodes["high"] + padding
        return np.concatenate([low, high], axis=1).astype(np.float32)

    def ends(self, most_triangles: int, most_height: int) -> NDArray[np.bool_]:
        """(n,) whether rays are cast against a node's triangles as they are.

        Those of no more triangles and no more steps below than given, and every leaf
        (Jaspe 2018, 4.5.2, termination criteria).
        """
        small = self.nodes["triangles"] <= most_triangles
        return np.asarray(
            (small & (self.nodes["height"] <= most_height)) | (self.nodes["left"] < 0)
        )


def box_area(low: NDArray[np.floating], high: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n,) surface of boxes with corners (n, 3)."""
    x, y, z = np.moveaxis(high - low, -1, 0)
    return np.asarray(2.0 * (x * y + y * z + z * x))


def tree_over(
    low: NDArray[np.float32], high: NDArray[np.float32], triangles: NDArray[np.int64]
) -> ChunkTree:
    """The hierarchy of chunks in a given order.

    Every range of chunks is divided where the areas of both parts, weighted with their
    triangles, are least (the surface area heuristic, for ranges), so that each subtree is a range.

    Parameters
    ----------
    low, high : (k, 3) corners of the chunks' boxes, k ≥ 1.
    triangles : (k,) in each of them.
    """
    nodes = np.zeros(2 * len(low) - 1, NODE)
    made = 1
    waiting = [(0, 0, len(low))]
    while waiting:
        node, first, last = waiting.pop()
        nodes["low"][node] = low[first:last].min(axis=0)
        nodes["high"][node] = high[first:last].max(axis=0)
        nodes["first"][node], nodes["count"][node] = first, last - first
        nodes["triangles"][node] = triangles[first:last].sum()
        nodes["left"][node] = nodes["right"][node] = -1
        if last - first > 1:
            cut = first + _best_cut(low[first:last], high[first:last], triangles[first:last])
            nodes["left"][node], nodes["right"][node] = made, made + 1
            waiting += [(made + 1, cut, last), (made, first, cut)]
            made += 2
    for node in range(len(nodes) - 1, -1, -1):
        if nodes["left"][node] >= 0:
            below = nodes["height"][[nodes["left"][node], nodes["right"][node]]]
            nodes["height"][node] = 1 + below.max()
    return ChunkTree(nodes)


def _best_cut(
    low: NDArray[np.float32], high: NDArray[np.float32], triangles: NDArray[np.int64]
) -> int:
    """How many of a range of chunks, at least two, come before the cut."""
    before = box_area(np.minimum.accumulate(low), np.maximum.accumulate(high))
    behind = box_area(np.minimum.accumulate(low[::-1]), np.maximum.accumulate(high[::-1]))[::-1]
    count = np.cumsum(triangles)
    cost = before[:-1] * count[:-1] + behind[1:] * (count[-1] - count[:-1])
    best = np.flatnonzero(cost == cost.min())
    # Where all cuts cost the same, as with boxes in one place, the middle keeps the tree low.
    return 1 + int(best[len(best) // 2])
