"""Octrees of awkward streams: crowds in one cell, batches of any size, changing sources.

What files of octrees show of ordinary clouds is in `test_octree_clouds`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.formats.point_fixtures import assert_same, some_points
from workbench.cloud.point_octree import StreamedOctree
from workbench.errors import InputError
from workbench.formats.octree_nodes import CELLS, NodeKey, OctreeNode
from workbench.formats.point_stream import PointStream, slices_of, surveyed
from workbench.geometry.point_set import PointSet, joined


def octree_of(points: PointSet, folder: Path, leaf: int, **options) -> StreamedOctree:
    return StreamedOctree(surveyed(slices_of(points)), folder, leaf_points=leaf, **options)


def check(octree: StreamedOctree, points: PointSet, leaf: int) -> list[OctreeNode]:
    """All that an octree promises, in whole numbers."""
    nodes = list(octree.nodes())
    found = joined([node.points for node in nodes])
    assert_same(found, points, octree.rounding.step / 2 + 2e-9)
    keys = {node.key for node in nodes}
    assert len(keys) == len(nodes)
    parents = {key.parent for key in keys if key.level}
    assert parents <= keys
    assert NodeKey(0, 0, 0, 0) in keys

    # Python's integers, as cells of deep levels go beyond 64 bits here.
    away = np.concatenate([node.whole for node in nodes]).astype(object) - octree.cube.low
    level = np.concatenate([np.full(len(node.points), node.key.level) for node in nodes])
    place = np.concatenate(
        [np.tile([[node.key.x, node.key.y, node.key.z]], (len(node.points), 1)) for node in nodes]
    )
    scale = np.array([[2 ** int(value)] for value in level], object)
    np.testing.assert_array_equal(away * scale // octree.cube.side, place)

    for node in nodes:
        # What is left of many points may only stay together where it coincides.
        together = len(node.points) > leaf and np.ptp(node.whole, axis=0).any()
        assert node.key in parents or not together
    for deep in range(int(level.max()) + 1):
        cells = (away * (CELLS << deep) // octree.cube.side).astype(np.int64)
        shown = cells[level <= deep]
        assert {*map(tuple, shown)} == {*map(tuple, cells)}
        if deep == level.max():
            break
        inner = {(k.x, k.y, k.z) for k in parents if k.level == deep}
        inside = [tuple(cell) in inner for cell in shown // CELLS]
        _, times = np.unique(shown[inside], axis=0, return_counts=True)
        assert times.max(initial=1) == 1
    return nodes


def test_a_crowd_far_from_the_rest(tmp_path: Path) -> None:
    """More points in one of the smallest cells of the first grid than memory holds, twice."""
    points = some_points(9000)
    points.points[3000:6000] = points.points[3000:6000] * 1e-3 + 1000
    points.points[6000:] = points.points[6000:] * 1e-5 + 1000
    octree = octree_of(points, tmp_path, 100, memory_bytes=1, precision=1e-6)
    nodes = check(octree, points, 100)
    assert max(node.key.level for node in nodes) > 15
    assert any(not len(node.points) for node in nodes)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("memory", [1 << 30, 1])
def test_points_that_coincide(tmp_path: Path, memory: int) -> None:
    points = PointSet(np.repeat([[1.0, 2.0, 3.0], [1.5, 2.5, 3.5]], [900, 1], axis=0))
    nodes = check(octree_of(points, tmp_path, 10, memory_bytes=memory), points, 10)
    assert max(len(node.points) for node in nodes) > 800
    check(octree_of(points.chosen(slice(0, 900)), tmp_path, 10), points.chosen(slice(0, 900)), 10)


def test_how_the_stream_is_cut_does_not_matter(tmp_path: Path) -> None:
    points = some_points(20_000)
    whole = surveyed(slices_of(points))

    def cut() -> Iterator[PointSet]:
        for start in range(0, len(points), 777):
            yield points.chosen(slice(start, start + 777))
        yield points.chosen(slice(0, 0))

    for memory in (1 << 30, 1):
        one, other = (
            list(StreamedOctree(stream, tmp_path, leaf_points=200, memory_bytes=memory).nodes())
            for stream in (whole, surveyed(cut))
        )
        assert [node.key for node in one] == [node.key for node in other]
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a.whole, b.whole)
            np.testing.assert_array_equal(a.points.color, b.points.color)


@pytest.mark.parametrize("memory", [1 << 30, 1])
def test_points_that_change_meanwhile(tmp_path: Path, memory: int) -> None:
    points = some_points(5000)
    stream = surveyed(slices_of(points))
    grown = PointSet(points.points * 2, points.normals, points.color, points.radius)
    for other in (points.chosen(slice(0, 4000)), grown):
        changed = PointStream(slices_of(other), 5000, stream.low, stream.high, stream.attributes)
        with pytest.raises(InputError, match="changed"):
            list(StreamedOctree(changed, tmp_path, leaf_points=50, memory_bytes=memory).nodes())
