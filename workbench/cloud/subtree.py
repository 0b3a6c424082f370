"""Compressed chunks of samples that fit in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.chunk_codec import encode_attribute, encode_positions
from workbench.cloud.row_sources import Rows, places
from workbench.cloud.schema import POINTS, Schema
from workbench.cloud.tree import NODE
from workbench.kernels.layered_kdtree import build_subtree, neighbour_spacing

_PROBES, _WINDOW = 256, 64


@dataclass(frozen=True)
class TreeShape:
    """How a tree is made.

    Attributes
    ----------
    inner : samples of an inner node.
    capacity : most samples of a leaf, ≥ ``inner``.
    compression_level : of zstd.
    """

    inner: int
    capacity: int
    compression_level: int


@dataclass(frozen=True)
class EncodedChunk:
    """A node ready to be stored.

    Attributes
    ----------
    node : scalar of ``NODE``; parent and children number the chunks of the same subtree.
    values : bytes per attribute of the schema, positions first.
    """

    node: np.void
    values: list[bytes]


class Mapping(Protocol):
    """``map`` or the like of a pool: results in the order of the items."""

    def __call__(
        self, function: Callable[[int], EncodedChunk], items: Iterable[int], /
    ) -> Iterable[EncodedChunk]: ...


def encoded_subtree(
    rows: Rows, schema: Schema, shape: TreeShape, seed: int, mapping: Mapping = map
) -> list[EncodedChunk]:
    """The tree of some rows (n, words), n > 0; levels count from its root at 0.

    ``seed`` is of the random choice of what inner nodes keep; ``mapping`` runs over chunks.
    """
    order, nodes, splits = build_subtree(places(rows), shape.inner, shape.capacity, seed)
    table = np.zeros(len(nodes), NODE)
    for name, column in (("count", 1), ("parent", 2), ("left", 3), ("right", 4), ("axis", 5)):
        table[name] = nodes[:, column]
    table["split"], table["low"], table["high"] = splits[:, 0], splits[:, 1:4], splits[:, 4:7]
    for i in range(1, len(table)):
        table["level"][i] = table["level"][table["parent"][i]] + 1

    def encoded(i: int) -> EncodedChunk:
        piece = rows[order[nodes[i, 0] : nodes[i, 0] + nodes[i, 1]]]
        return _encoded(table[i : i + 1], piece, schema, shape.compression_level)

    return list(mapping(encoded, range(len(nodes))))


def encoded_chunk(rows: Rows, schema: Schema, level: int) -> EncodedChunk:
    """One node without relatives, of rows (n, words), n > 0."""
    node = np.zeros(1, NODE)
    points = places(rows)
    node["count"], node["low"], node["high"] = len(rows), points.min(axis=0), points.max(axis=0)
    node["parent"] = node["left"] = node["right"] = node["axis"] = -1
    return _encoded(node, rows, schema, level)


def _encoded(node: NDArray[np.void], rows: Rows, schema: Schema, level: int) -> EncodedChunk:
    positions = encode_positions(places(rows), level)
    arrays = schema.arrays(rows, positions.order)
    values = [positions.value]
    values += [encode_attribute(arrays[a.name], level) for a in schema.attributes]
    node["spacing_m"] = neighbour_spacing(arrays[POINTS], _PROBES, _WINDOW)
    return EncodedChunk(node[0].copy(), values)
