"""Reduction to graphs: lossless, as small as can be, and whatever the parts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from tests.voxels.voxel_grids import codes_of, distinct_subtrees, grids, images_of
from workbench.errors import InputError
from workbench.kernels.cube_turns import COMPOSED, INVERSE, SLOT, TURNED, turned_mask
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_reduction import DistinctRows, reduced_dag, reduced_parts
from workbench.voxels.symmetric_dag import leaf_table, symmetric_dag
from workbench.voxels.voxel_dag import VoxelDag


def level_of(full):
    return len(full).bit_length() - 1


def same(a: VoxelDag, b: VoxelDag) -> bool:
    rows = zip(a.rows, b.rows, strict=True)
    return a.root == b.root and all(x.tobytes() == y.tobytes() for x, y in rows)


@given(grids())
@settings(max_examples=60, deadline=None)
def test_every_voxel_comes_back_and_no_subtree_is_kept_twice(full):
    codes = codes_of(full)
    dag = reduced_dag(codes, level_of(full))
    mirrored, turned = symmetric_dag(dag), symmetric_dag(dag, 48)
    for graph in (dag, mirrored, turned, symmetric_dag(mirrored, 48)):
        assert np.array_equal(DagWalk(graph).codes(), codes)
    assert dag.node_count == distinct_subtrees(full, 1)
    assert mirrored.node_count == distinct_subtrees(full, 8)
    assert turned.node_count == distinct_subtrees(full, 48)


@given(grids())
@settings(max_examples=30, deadline=None)
def test_images_have_graphs_of_the_same_size(full):
    for order in (8, 48):
        counts = set()
        for image in images_of(full, turned=order == 48):
            dag = reduced_dag(codes_of(image), level_of(full))
            counts.add(tuple(len(rows) for rows in symmetric_dag(dag, order).rows))
        assert len(counts) == 1


@given(grids(levels=(4,)))
@settings(max_examples=30, deadline=None)
def test_the_graph_does_not_depend_on_the_parts(full):
    codes = codes_of(full)
    whole = reduced_dag(codes, 4)
    for at_once in (1, 7, 100):
        assert same(whole, reduced_dag(codes, 4, at_once))


def test_turns_are_the_group_of_the_cube():
    centers = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)]) - 0.5
    assert len({tuple(row) for row in TURNED.tolist()}) == 48
    for g in range(48):
        moved = centers[TURNED[g]]
        # Where the octants' middles go is a linear map that keeps lengths.
        matrix = np.linalg.lstsq(centers, moved, rcond=None)[0]
        np.testing.assert_allclose(centers @ matrix, moved, atol=1e-12)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
        assert (TURNED[g][SLOT[g]] == np.arange(8)).all()
        assert (TURNED[INVERSE[g]] == SLOT[g]).all()
        for h in range(48):
            assert (TURNED[COMPOSED[g, h]] == TURNED[g][TURNED[h]]).all()
    assert (TURNED[:8] == np.arange(8) ^ np.arange(8)[:, None]).all()


@pytest.mark.parametrize(("order", "kinds"), [(8, 46), (48, 22)])
def test_the_leaf_table_is_the_largest_of_the_images(order, kinds):
    words, invariants = leaf_table(order)
    assert len(np.unique(words >> 6)) == kinds
    for mask in range(256):
        cube = np.array([mask >> k & 1 for k in range(8)]).reshape(2, 2, 2)
        images = [
            sum(int(bit) << k for k, bit in enumerate(image.ravel()))
            for image in images_of(cube, turned=order == 48)
        ]
        assert words[mask] >> 6 == max(images)
        assert turned_mask(int(words[mask] >> 6), int(words[mask] & 63)) == mask
        assert int(invariants[mask]).bit_count() == images.count(mask)


def test_a_node_that_is_its_own_image_under_two_mirrors_at_once_only():
    # Mirrored along x and y the pair is itself, along x alone it is what y alone makes of it.
    # Three bits, one for each axis, do not tell this, and would keep the mirrored node.
    pair = np.zeros((4, 4, 4), bool)
    pair[0, 0, 0] = pair[3, 3, 0] = True
    node = np.zeros((8, 8, 8), bool)
    node[:4, :4, :4], node[4:, :4, :4] = pair, pair[::-1]
    full = np.zeros((16, 16, 16), bool)
    full[:8, :8, :8], full[8:, :8, :8] = node, node[:, ::-1]
    dag = symmetric_dag(reduced_dag(codes_of(full), 4))
    assert [len(rows) for rows in dag.rows] == [1, 1, 1]
    assert dag.node_count == distinct_subtrees(full, 8)


def test_a_single_voxel_at_the_finest_level():
    code = np.array([(1 << 63) - 2], np.uint64)
    dag = symmetric_dag(reduced_dag(code, 21))
    assert [len(rows) for rows in dag.rows] == [1] * 20
    assert np.array_equal(DagWalk(dag).codes(), code)


def test_a_full_cube_has_one_node_for_each_depth_and_counts_what_it_stands_for():
    dag = reduced_dag(np.arange(8**6, dtype=np.uint64), 6)
    walk = DagWalk(symmetric_dag(dag))
    assert dag.node_count == 6
    assert walk.voxel_count == 8**6
    assert walk.octree_node_count == sum(8**depth for depth in range(6))


def test_parts_of_a_graph_follow_one_another():
    rng = np.random.default_rng(5)
    codes = np.unique(rng.integers(0, 8**5, 900)).astype(np.uint64)
    walk = DagWalk(symmetric_dag(reduced_dag(codes, 5)))
    for depth in range(4):
        parts = list(walk.code_parts(depth))
        assert len(parts) == len(np.unique(codes >> np.uint64(3 * (5 - depth))))
        assert np.array_equal(np.concatenate(parts), codes)


def test_cells_know_which_voxels_stand_below_them():
    rng = np.random.default_rng(6)
    codes = np.unique(rng.integers(0, 8**4, 300)).astype(np.uint64)
    walk = DagWalk(symmetric_dag(reduced_dag(codes, 4)))
    for depth in range(5):
        cells = np.arange(8**depth, dtype=np.uint64)
        first, count = walk.ranges(cells, np.full(len(cells), depth))
        above = codes >> np.uint64(3 * (4 - depth))
        assert np.array_equal(count, np.bincount(above.astype(np.int64), minlength=8**depth))
        starts = np.searchsorted(above, cells)
        assert np.array_equal(first, np.where(count > 0, starts, -1))


def test_rows_are_numbered_as_they_come_and_room_is_made():
    rng = np.random.default_rng(7)
    rows = rng.integers(0, 3, (30_000, 8)).astype(np.uint32)
    distinct = DistinctRows()
    places = np.concatenate([distinct.places_of(rows[:11_000]), distinct.places_of(rows[11_000:])])
    assert np.array_equal(distinct.rows[places], rows)
    assert len(distinct.rows) == len(np.unique(rows, axis=0))
    first = np.unique(places, return_index=True)[1]
    assert (np.diff(first) > 0).all()


@pytest.mark.parametrize("codes", [[3, 2], [2, 2], [1, 8**3]])
def test_codes_out_of_order_or_bounds_are_refused(codes):
    with pytest.raises(InputError, match="order"):
        reduced_dag(np.array(codes, np.uint64), 3)


def test_parts_that_share_a_subtree_are_refused():
    parts = [np.array([1], np.uint64), np.array([2], np.uint64)]
    with pytest.raises(InputError, match="order"):
        reduced_parts(parts, 3, 1)


@pytest.mark.parametrize("level", [0, 1, 22])
def test_levels_out_of_bounds_are_refused(level):
    with pytest.raises(InputError, match="resolution"):
        reduced_dag(np.zeros(0, np.uint64), level)
