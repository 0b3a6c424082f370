from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.stats import chisquare

from workbench.kernels import layered_kdtree as kernels

RNG = np.random.default_rng(3)
NUMBERS = st.one_of(
    st.floats(-1e150, 1e150),
    st.sampled_from([0.0, -0.0, 1.0, 1.0 + 2**-52, 1e-308, -5e-324, 1e150]),
    st.integers(-3, 3).map(float),
)


@given(st.lists(NUMBERS, min_size=1, max_size=400), st.data())
@settings(max_examples=150, deadline=None)
def test_order_statistics_are_those_of_sorting(numbers: list[float], data: st.DataObject):
    values = np.array(numbers)
    rank = data.draw(st.integers(0, len(values) - 1))
    found = kernels.order_statistic(values, rank, values.min(), values.max())
    assert found == np.sort(values)[rank]


@given(st.lists(NUMBERS, min_size=2, max_size=300))
@settings(max_examples=150, deadline=None)
def test_no_split_is_nearer_to_the_middle(numbers: list[float]):
    values = np.array(numbers)
    if values.min() == values.max():
        return
    split = kernels.balanced_split(values, values.min(), values.max())
    left = np.count_nonzero(values < split)
    assert 0 < left < len(values)
    options = [np.count_nonzero(values < v) for v in np.unique(values)[1:]]
    best = min(abs(o - len(values) / 2) for o in options)
    assert abs(left - len(values) / 2) == best


def check_subtree(points: np.ndarray, inner: int, capacity: int) -> None:
    order, nodes, splits = kernels.build_subtree(points, inner, capacity, 1)
    assert np.array_equal(np.sort(order), np.arange(len(points)))
    spans = np.zeros(len(points), int)
    below: dict[int, list[int]] = {}
    for k in range(len(nodes) - 1, -1, -1):
        start, count, _, left, right, axis = nodes[k]
        mine = order[start : start + count]
        spans[start : start + count] += 1
        children = [c for c in (left, right) if c >= 0]
        assert all(nodes[c, 2] == k for c in children)
        assert count <= capacity if axis == kernels.LEAF else count == inner
        assert (axis == kernels.LEAF) == (not children)
        below[k] = [*mine, *(i for c in children for i in below[c])]
        assert np.array_equal(splits[k, 1:4], points[below[k]].min(axis=0))
        assert np.array_equal(splits[k, 4:7], points[below[k]].max(axis=0))
        if axis in (0, 1, 2):
            assert (points[below[left]][:, axis] < splits[k, 0]).all()
            assert (points[below[right]][:, axis] >= splits[k, 0]).all()
    assert (spans == 1).all()
    assert len(below[0]) == len(points)


@pytest.mark.parametrize("n", [1, 2, 9, 10, 11, 40, 3000])
@pytest.mark.parametrize("kind", ["cube", "line", "equal", "twins", "contrast"])
def test_every_point_is_in_one_node_on_the_right_side(n: int, kind: str):
    points = RNG.random((n, 3))
    if kind == "line":
        points[:, 1:] = 0.5
    elif kind == "equal":
        points[:] = 0.25
    elif kind == "twins":
        points = points[RNG.integers(0, max(1, n // 3), n)]
    elif kind == "contrast":
        points[n // 10 :] *= 1e-6
    check_subtree(np.ascontiguousarray(points), 7, 10)


def test_a_balanced_tree_has_equal_halves():
    points = RNG.random((10_000, 3))
    _, nodes, splits = kernels.build_subtree(points, 100, 100, 1)
    axis = int(nodes[0, 5])
    left = np.count_nonzero(points[:, axis] < splits[0, 0])
    assert abs(left - 5000) <= 100


def plain_sift(points, numbers, seed, plan, splits, inner):
    """Node after node: the lowest hashes stay, the rest falls to its side."""
    with np.errstate(over="ignore"):
        keys = np.array([kernels.mixed(np.uint64(i), np.uint64(seed)) for i in numbers])
    kept, buckets = {}, {}
    arriving = {0: np.arange(len(points))}
    for node in range(len(plan)):
        here = arriving.get(node, np.empty(0, int))
        ranked = here[np.argsort(keys[here])]
        kept[node], rest = ranked[:inner], ranked[inner:]
        axis, left, right = plan[node]
        side = points[rest, axis] < splits[node]
        for child, part in ((left, rest[side]), (right, rest[~side])):
            (arriving if child >= 0 else buckets)[child if child >= 0 else -1 - child] = part
    return kept, buckets


@pytest.mark.parametrize("loose", [False, True])
@pytest.mark.parametrize("cut", [37, 1000])
def test_sifting_leaves_every_row_where_plain_selection_does(cut: int, loose: bool):
    n, inner = 1000, 60
    points = RNG.random((n, 3))
    rows = np.column_stack([points, np.arange(n)]).view(np.uint64)
    plan = np.array([[0, 1, 2], [1, -1, -2], [2, -3, -4]], np.int32)
    splits = np.array([0.5, 0.4, 0.6])
    limits = np.full(3, np.iinfo(np.uint64).max)
    if loose:
        limits[0] = int(0.12 * 2**64)  # 60 of 1000 are expected below 0.06
    kept = np.zeros((3, inner, 4), np.uint64)
    keys, slots = np.zeros((3, inner), np.uint64), np.zeros((3, inner), np.int32)
    counts = np.zeros(3, np.int64)
    fallen: list[list[float]] = [[], [], [], []]
    for start in range(0, n, cut):
        part = np.ascontiguousarray(rows[start : start + cut])
        out, starts = kernels.sift(part, start, 9, plan, splits, limits, kept, keys, slots, counts)
        for b in range(4):
            fallen[b] += out[starts[b] : starts[b + 1], 3].view(np.float64).tolist()
    expected_kept, expected_buckets = plain_sift(points, range(n), 9, plan, splits, inner)
    for node in range(3):
        found = kept[node, : counts[node], 3].view(np.float64)
        assert sorted(found) == sorted(expected_kept[node])
    for b in range(4):
        assert sorted(fallen[b]) == sorted(expected_buckets[b])


def test_a_sample_does_not_depend_on_the_slices():
    points = RNG.random((5000, 3))
    found = []
    for cut in (5000, 71):
        kept, keys = np.empty((100, 3)), np.empty(100, np.uint64)
        threshold, count = 1 << 32, 0
        for start in range(0, 5000, cut):
            threshold, count = kernels.sampled(
                points[start : start + cut], start, threshold, kept, keys, count
            )
        found.append(kept[:count].copy())
    assert np.array_equal(*found)
    assert 40 <= len(found[0]) <= 100


def test_shuffling_is_fair():
    places = np.array([np.argmin(kernels.shuffled(8, seed)) for seed in range(4000)])
    assert np.array_equal(np.sort(kernels.shuffled(1000, 4)), np.arange(1000))
    assert chisquare(np.bincount(places, minlength=8)).pvalue > 1e-3


def test_extents_name_the_first_bad_row():
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    points = RNG.normal(size=(20, 3))
    assert kernels.extents(points, low, high) == -1
    assert np.array_equal(low, points.min(axis=0))
    assert np.array_equal(high, points.max(axis=0))
    for bad in (np.nan, np.inf, -np.inf, 2e150):
        points[7, 1] = bad
        assert kernels.extents(points, low, high) == 7


def test_spacing_is_the_median_distance_to_the_nearest():
    grid = np.stack(np.meshgrid(*[np.arange(16.0)] * 3), axis=-1).reshape(-1, 3)
    assert kernels.neighbour_spacing(grid, 256, 64) == 1.0
    points = RNG.random((4000, 3))
    points[:, 2] = 0.0
    code = (points[:, :2] * 1024).astype(int)
    spread = sum((((code >> b) & 1) << np.array([2 * b, 2 * b + 1])).sum(axis=1) for b in range(10))
    points = points[np.argsort(spread)]
    expected = np.median(cKDTree(points).query(points, 2)[0][:, 1])
    assert kernels.neighbour_spacing(points, 256, 64) == pytest.approx(expected, rel=0.2)
    assert kernels.neighbour_spacing(points[:1], 256, 64) == 0.0
