"""The nodes of the additive kd-tree: one chunk each, with bounds, level and spacing."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from workbench.errors import InputError

# Nodes of a tree differ; nothing that is one packs better.
_MOST_BYTES_PER_BYTE = 4096

#: A node is its chunk. Children are −1 where there are none; a parent precedes its children.
#: ``axis``: −1 leaf, 0 to 2 the left child lies below ``split``, 3 children of equal place.
#: ``total``, ``low``, ``high``: samples and closed bounds of the whole subtree.
#: ``spacing_m``: median distance of the chunk's samples to their nearest ones in it.
NODE = np.dtype(
    [
        ("parent", "<i4"),
        ("left", "<i4"),
        ("right", "<i4"),
        ("level", "<i4"),
        ("axis", "<i4"),
        ("count", "<i4"),
        ("total", "<i8"),
        ("split", "<f8"),
        ("low", "<f8", 3),
        ("high", "<f8", 3),
        ("spacing_m", "<f8"),
    ]
)


@dataclass(frozen=True)
class Tree:
    """All nodes of a cloud; node i is chunk i.

    Attributes
    ----------
    nodes : (k,) of ``NODE``.
    """

    nodes: NDArray[Any]
    _reached: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Spacing that a cut reaches at a node: never coarser than at its ancestors.
        reached = self.nodes["spacing_m"].copy()
        for level in range(1, self.levels):
            here = np.flatnonzero(self.nodes["level"] == level)
            reached[here] = np.minimum(reached[here], reached[self.nodes["parent"][here]])
        object.__setattr__(self, "_reached", reached)

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def levels(self) -> int:
        """Number of levels; the root is level 0."""
        return int(self.nodes["level"].max()) + 1 if len(self.nodes) else 0

    @property
    def total(self) -> int:
        """Number of samples."""
        return int(self.nodes["total"][0]) if len(self.nodes) else 0

    def wanted(self, touched: NDArray[np.bool_], level: int | None, spacing_m: float | None,
               ) -> NDArray[np.int64]:  # fmt: skip
        """Chunks to load, coarse levels first, each level in tree order.

        Parameters
        ----------
        touched : (k,) which subtrees the region meets.
        level : the finest level, None for all.
        spacing_m : stop below nodes whose samples are at most this far apart.
        """
        keep = touched.copy()
        if level is not None:
            keep &= self.nodes["level"] <= level
        if spacing_m is not None:
            parent = self.nodes["parent"]
            keep &= (parent < 0) | (self._reached[parent] > spacing_m)
        chosen = np.flatnonzero(keep)
        return chosen[np.argsort(self.nodes["level"][chosen], kind="stable")]

    def depth_first(self) -> NDArray[np.int64]:
        """Chunks so that neighbours in the order are neighbours in space; parents first."""
        order, stack = [], [0] if len(self.nodes) else []
        while stack:
            node = stack.pop()
            order.append(node)
            stack.extend(int(c) for c in (self.nodes["right"][node], self.nodes["left"][node])
                         if c >= 0)  # fmt: skip
        return np.array(order, np.int64)

    def bottom_up(self) -> NDArray[np.int64]:
        """Chunks so that both children come before their parent."""
        return self.depth_first()[::-1]

    def cells(self, most_samples: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Closed boxes that share out space, each with few enough samples.

        Returns
        -------
        (low, high), each (3,) float64: every point lies in exactly one box; outer faces are
        infinite. A box holds more than ``most_samples`` only where they coincide or where
        it is a leaf chunk and those of the chunks above it.
        """
        boxes = []
        stack = [(0, np.full(3, -np.inf), np.full(3, np.inf))] if len(self.nodes) else []
        while stack:
            index, low, high = stack.pop()
            node = self.nodes[index]
            axis = int(node["axis"])
            if node["total"] + self._above(index) <= most_samples or axis not in (0, 1, 2):
                boxes.append((low, high))
                continue
            below, above = high.copy(), low.copy()
            below[axis], above[axis] = np.nextafter(node["split"], -np.inf), node["split"]
            for child, lo, hi in ((node["right"], above, high), (node["left"], low, below)):
                if child >= 0:
                    stack.append((int(child), lo, hi))
                else:
                    boxes.append((lo, hi))
        return boxes

    def _above(self, index: int) -> float:
        """Samples of the ancestors that fall into a node's cell, expected."""
        expected, node = 0.0, index
        while (parent := int(self.nodes["parent"][node])) >= 0:
            below = float(self.nodes["total"][parent] - self.nodes["count"][parent])
            expected += float(self.nodes["count"][parent] * self.nodes["total"][index] / below)
            node = parent
        return expected

    def as_bytes(self) -> bytes:
        """Compressed, with a checksum."""
        plain = np.ascontiguousarray(self.nodes).tobytes()
        return struct.pack("<I", zlib.crc32(plain)) + zstandard.ZstdCompressor(3).compress(plain)

    @classmethod
    def from_bytes(cls, data: bytes, file: Path) -> Tree:
        """Undo ``as_bytes``; raises InputError naming ``file`` where they are damaged."""
        try:
            if not 0 <= zstandard.frame_content_size(data[4:]) <= _MOST_BYTES_PER_BYTE * len(data):
                raise ValueError("it unpacks to more than a tree")
            plain = zstandard.ZstdDecompressor().decompress(data[4:])
            if struct.pack("<I", zlib.crc32(plain)) != data[:4]:
                raise ValueError("a checksum does not match")
            return cls(np.frombuffer(plain, NODE))
        except (ValueError, zstandard.ZstdError) as error:
            raise InputError(
                "a point cloud is damaged",
                file=file,
                where="its tree",
                found=str(error),
                fix="restore the file from a copy or build it again",
            ) from error
