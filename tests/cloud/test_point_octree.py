"""Octrees of streams: additive levels, one point per cell, whatever the memory."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

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


@pytest.mark.parametrize("memory", [1 << 30, 1])
def test_a_sheet(tmp_path: Path, memory: int) -> None:
    points = some_points(30_000, offset=(4.3e5, 5.4e6, 0))
    octree = octree_of(points, tmp_path, 300, memory_bytes=memory)
    nodes = check(octree, points, 300)
    assert max(node.key.level for node in nodes) >= 2
    assert not list(tmp_path.iterdir())


def test_a_crowd_far_from_the_rest(tmp_path: Path) -> None:
    """More points in one of the smallest cells of the first grid than memory holds, twice."""
    points = some_points(9000)
    points.points[3000:6000] = points.points[3000:6000] * 1e-3 + 1000
    points.points[6000:] = points.points[6000:] * 1e-5 + 1000
    octree = octree_of(points, tmp_path, 100, memory_bytes=1, precision=1e-6)
    nodes = check(octree, points, 100)
    assert max(node.key.level for node in nodes) > 15
    assert any(not len(node.points) for node in nodes)


@pytest.mark.parametrize("memory", [1 << 30, 1])
def test_points_that_coincide(tmp_path: Path, memory: int) -> None:
    points = PointSet(np.repeat([[1.0, 2.0, 3.0], [1.5, 2.5, 3.5]], [900, 1], axis=0))
    nodes = check(octree_of(points, tmp_path, 10, memory_bytes=memory), points, 10)
    assert max(len(node.points) for node in nodes) > 800
    check(octree_of(points.chosen(slice(0, 900)), tmp_path, 10), points.chosen(slice(0, 900)), 10)


def test_one_point(tmp_path: Path) -> None:
    point = PointSet(np.array([[5.4e6, -1.0, 0.0]]))
    (node,) = octree_of(point, tmp_path, 10).nodes()
    assert node.key == NodeKey(0, 0, 0, 0)
    np.testing.assert_allclose(node.points.points, point.points)


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


def test_coarse_levels_are_even(tmp_path: Path) -> None:
    """Neighbours of the coarse picture keep apart; as many random points do not."""
    points = some_points(200_000)
    points.points[:, 2] = 0
    octree = octree_of(points, tmp_path, 1000)
    root = next(node for node in octree.nodes() if node.key.level == 0)
    spacing = octree.cube.side * octree.rounding.step / CELLS
    even = cKDTree(root.points.points)
    near = even.query(root.points.points, k=2)[0][:, 1] / spacing
    random = points.points[: len(root.points)]
    near_random = cKDTree(random).query(random, k=2)[0][:, 1] / spacing
    assert np.quantile(near, 0.05) > 3 * np.quantile(near_random, 0.05)
    assert np.quantile(near, 0.05) > 0.45
    # A cell with a point has one in it: no point is farther than its diagonal.
    assert even.query(points.points)[0].max() <= np.sqrt(2) * spacing


@pytest.mark.parametrize("memory", [1 << 30, 1])
def test_points_that_change_meanwhile(tmp_path: Path, memory: int) -> None:
    points = some_points(5000)
    stream = surveyed(slices_of(points))
    grown = PointSet(points.points * 2, points.normals, points.color, points.radius)
    for other in (points.chosen(slice(0, 4000)), grown):
        changed = PointStream(slices_of(other), 5000, stream.low, stream.high, stream.attributes)
        with pytest.raises(InputError, match="changed"):
            list(StreamedOctree(changed, tmp_path, leaf_points=50, memory_bytes=memory).nodes())


_MANY = """
import resource, sys
from pathlib import Path
import numpy as np
from workbench.cloud.point_octree import StreamedOctree
from workbench.formats.copc import write_copc
from workbench.formats.point_stream import surveyed
from workbench.geometry.point_set import PointSet

def batches(number):
    for k in range(number):
        random = np.random.default_rng(k)
        points = random.uniform(-5, 5, (250_000, 3))
        points[:, 2] = np.sin(points[:, 0])
        color = random.integers(0, 256, points.shape, dtype=np.uint8)
        yield PointSet(points, None, color)

def export(number):
    folder = Path(sys.argv[1])
    octree = StreamedOctree(surveyed(lambda: batches(number)), folder, memory_bytes=200 << 20)
    write_copc(folder / "many.copc.laz", octree)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10

before = export(1)
print(before, export(80))
"""


@pytest.mark.slow
def test_memory_is_bounded(tmp_path: Path) -> None:
    """Twenty million points, 540 megabytes of rows, in 200 megabytes on top of one batch's."""
    done = subprocess.run(
        [sys.executable, "-c", _MANY, str(tmp_path)], capture_output=True, text=True, check=True
    )
    before, after = map(int, done.stdout.split())
    assert after - before < 200 << 20
    assert [path.name for path in tmp_path.iterdir()] == ["many.copc.laz"]
