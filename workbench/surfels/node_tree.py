"""A loose octree over the triangles or points of an object."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.morton import morton_codes

# 2**20 cells a side: points nearer to each other than that are copies.
_FINEST = 20


@dataclass(frozen=True)
class TreeNode:
    """One node: a range of the items along the Morton curve.

    Attributes
    ----------
    level : 0 is the root.
    first, last : of the range, the last excluded.
    children : rows of the children, one after another; empty for a leaf.
    """

    level: int
    first: int
    last: int
    children: range

    @property
    def items(self) -> int:
        return self.last - self.first


@dataclass(frozen=True)
class ItemTree:
    """The tree.

    Attributes
    ----------
    order : (n,) int64 rows of the items along the Morton curve.
    nodes : level by level from the root, each level along the curve.
    """

    order: NDArray[np.int64]
    nodes: list[TreeNode]

    def items(self, node: TreeNode) -> NDArray[np.int64]:
        """Rows of the items of a node, ascending."""
        return np.sort(self.order[node.first : node.last])


def item_tree(places: NDArray[np.float64], most: int) -> ItemTree:
    """Split items until no leaf has more than ``most``.

    An item belongs to the cell its place is in; a node's bounds are those of its items, which
    may reach out of the cell (Ulrich 2000). Nodes with a single child are left out.

    Parameters
    ----------
    places
        (n, 3) finite, at least one: middles of triangles, or points.
    most
        Items of a leaf; more only where they lie in one place.
    """
    lower = places.min(axis=0)
    extent = float((places.max(axis=0) - lower).max())
    scale = ((1 << _FINEST) - 1) / extent if extent > 0.0 else 0.0
    codes = morton_codes(((places - lower) * scale).astype(np.int64))
    order = np.argsort(codes, kind="stable")
    codes = codes[order]
    nodes: list[TreeNode] = []
    level, waiting = 0, [(0, len(codes), _FINEST)]
    while waiting:
        below: list[tuple[int, int, int]] = []
        after = len(nodes) + len(waiting)
        for first, last, bits in waiting:
            parts = _parts(codes, first, last, bits, most)
            start = after + len(below)
            nodes.append(TreeNode(level, first, last, range(start, start + len(parts))))
            below.extend(parts)
        level, waiting = level + 1, below
    return ItemTree(order, nodes)


def _parts(
    codes: NDArray[np.uint64], first: int, last: int, bits: int, most: int
) -> list[tuple[int, int, int]]:
    """Ranges of the two to eight children of a range of cells 2**bits a side; none of a leaf."""
    if last - first <= most:
        return []
    while bits > 0:
        bits -= 1
        octants = (codes[first:last] >> np.uint64(3 * bits)) & np.uint64(7)
        # The codes ascend, so within one parent the octants do.
        edges = first + np.searchsorted(octants, np.arange(9))
        ranges = [(int(a), int(b), bits) for a, b in pairwise(edges) if b > a]
        if len(ranges) > 1:
            return ranges
    return []
