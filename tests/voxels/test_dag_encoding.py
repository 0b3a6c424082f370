"""The encodings: what their words mean, that nothing is lost, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from tests.voxels.voxel_grids import codes_of, grids
from workbench.errors import InputError
from workbench.kernels.dag_near_words import near_rows, put_near
from workbench.kernels.dag_rows import NO_CHILD
from workbench.kernels.dag_words import compact_rows, put_compact
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_encoding import COMPACT, ENCODINGS, encoded
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.dag_reduction import reduced_dag
from workbench.voxels.graph_export import reduced_for
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import voxelise


def graph_of(codes, level, encoding):
    dag = reduced_dag(codes, level)
    return encoded(reduced_for(dag, encoding), encoding)


@given(grids(levels=(2, 3, 5)))
@settings(max_examples=40, deadline=None)
def test_every_encoding_gives_back_every_voxel(full):
    codes, level = codes_of(full), len(full).bit_length() - 1
    for encoding in ENCODINGS:
        graph = graph_of(codes, level, encoding)
        assert graph.voxels == len(codes)
        assert np.array_equal(DagWalk(dag_of(graph)).codes(), codes)


def noise(level=7, count=20_000):
    rng = np.random.default_rng(3)
    return np.unique(rng.integers(0, 8**level, count)).astype(np.uint64)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pointers_of_all_lengths_give_back_every_voxel(encoding):
    codes = noise(8, 60_000)
    assert np.array_equal(DagWalk(dag_of(graph_of(codes, 8, encoding))).codes(), codes)


def test_near_nodes_bit_by_bit():
    # Children 0 … 3 at these offsets, of which the first is popular, the others in a row.
    child_at = np.array([3, 5000, 5006, 1 << 20])
    rows = np.full((2, 8), NO_CHILD, np.uint32)
    rows[0, 1], rows[0, 4], rows[0, 7] = 0 << 6 | 47, 1 << 6 | 9, 2 << 6
    rows[1, 0], rows[1, 2] = 2 << 6 | 1, 3 << 6 | 2
    words, anchors = np.zeros(128, np.uint16), np.zeros(1, np.uint32)
    node_at, ranks = np.empty(2, np.int64), np.arange(4)
    order = np.arange(2)
    used = put_near(rows, order, child_at, ranks, child_at, 1, False, words, anchors, node_at)
    assert (used, list(node_at), list(anchors)) == (8, [0, 4], [5000])
    assert words[0] == 0b10_00_00_10_00_00_01_00
    assert list(words[1:4]) == [47 << 10 | 3, 9 << 10 | 0, 0 << 10 | 6]
    assert words[4] == 0b00_00_00_00_00_11_00_10
    assert list(words[5:8]) == [1 << 10 | 6, 2 << 10 | 16, 0]
    place_of = np.full((1 << 20) + 1, NO_CHILD, np.uint32)
    place_of[child_at] = ranks
    out, own = np.empty((128, 8), np.uint32), np.full(128, NO_CHILD, np.uint32)
    assert near_rows(words, anchors, place_of, out, own) == 2
    assert np.array_equal(out[:2], rows)
    assert list(np.flatnonzero(own != NO_CHILD)) == [0, 4]


def test_near_pointers_make_a_scanned_surface_smaller(sphere):
    mesh = sphere(subdivisions=5)
    bumps = 1 + 0.05 * np.sin(9 * mesh.vertices[:, :1]) * np.cos(7 * mesh.vertices[:, 1:2])
    mesh = replace(mesh, vertices=bumps * mesh.vertices)
    codes = voxelise(mesh, grid_of_mesh(mesh.vertices, 9)).codes
    sizes = {encoding: graph_of(codes, 9, encoding).nbytes for encoding in ENCODINGS}
    assert sizes["osvdag"] < 0.85 * sizes["ssvdag"]
    assert sizes["ssvdag"] < 0.4 * sizes["svdag"]


def test_bytes_are_those_of_the_papers_node_sizes():
    """8 to 36 bytes for a plain node, 4 to 34 for a compact one, 8 for a brick (5.6.3)."""
    codes = noise()
    dag = reduced_dag(codes, 7)
    pointers = sum(int((rows != NO_CHILD).sum()) for rows in dag.rows)
    plain, compact, octree = (graph_of(codes, 7, e) for e in ("svdag", "esvdag", "svo"))
    assert plain.nodes.nbytes == 4 * (dag.node_count + pointers)
    assert len(octree.nodes) == sum(
        len(np.unique(codes >> np.uint64(3 * up))) for up in range(1, 8)
    )
    assert len(compact.bricks) == len(dag.rows[-1])
    assert len(compact.nodes) == half_words(dag)


def half_words(dag):
    """Half-words of compact nodes, counted node by node as 5.4.3 describes the layout."""
    total, offsets = 0, {}
    for depth in range(dag.level - 2, -1, -1):
        rows = [[int(w) >> 6 for w in row if w != NO_CHILD] for row in dag.rows[depth]]
        named = [0] * len(rows)
        for word in dag.rows[depth - 1].ravel() if depth else ():
            if word != NO_CHILD:
                named[int(word) >> 6] += 1
        if depth == dag.level - 2:
            sizes = [1] * len(rows)
        else:
            sizes = [1 + sum(1 if offsets[c] < 2**13 else 2 for c in row) for row in rows]
            total += sum(sizes)
        offsets, at = {}, 0
        for node in sorted(range(len(rows)), key=lambda node: (-named[node], node)):
            offsets[node] = at
            at += sizes[node]
    return total


def test_compact_nodes_bit_by_bit():
    rows = np.full((1, 8), NO_CHILD, np.uint32)
    rows[0, 0], rows[0, 3], rows[0, 6], rows[0, 7] = 0 << 6 | 5, 1 << 6 | 1, 2 << 6 | 7, 3 << 6
    child_at = np.array([8191, 8192, (1 << 29) + 3, (1 << 30) - 1])
    words = np.zeros(8, np.uint16)
    put_compact(rows, np.zeros(1, np.int64), child_at, words)
    assert words[0] == 0b11_11_00_00_10_00_00_01
    assert words[1] == 0b101_1111111111111
    assert (int(words[2]) << 16 | int(words[3])) == 0b001 << 29 | 8192
    assert (int(words[4]) << 16 | int(words[5])) == 0b111 << 29 | 3
    assert (int(words[6]) << 16 | int(words[7])) == 0b000 << 29 | (1 << 29) - 1
    words[0] = 0b00_00_00_00_10_00_00_01
    place_of = np.full(8193, NO_CHILD, np.uint32)
    place_of[[8191, 8192]] = 0, 1
    out, own = np.empty((4, 8), np.uint32), np.full(4, NO_CHILD, np.uint32)
    assert compact_rows(words[:4], place_of, out, own) == 1
    assert out[0, 0] == rows[0, 0]
    assert out[0, 3] == rows[0, 3]
    assert (out[0, [1, 2, 4, 5, 6, 7]] == NO_CHILD).all()


def test_the_brick_most_referred_to_comes_first():
    full = np.zeros((16, 16, 16), bool)
    full[0, 0, 0] = full[4, 4, 4] = full[8, 8, 8] = True
    full[12:14, 12, 12] = True
    bricks = encoded(reduced_dag(codes_of(full), 4), "esvdag").bricks
    assert list(bricks) == [1, 3]
    full[:8] = full[8:].copy()
    full[:4, :4, 4:8] = full[:4, 4:8, :4] = full[12:, 12:, 12:]
    bricks = encoded(reduced_dag(codes_of(full), 4), "esvdag").bricks
    assert list(bricks) == [3, 1]


def test_equal_voxels_give_equal_bytes_whatever_the_parts():
    codes = noise()
    for encoding in ENCODINGS:
        dags = [reduced_dag(codes, 7, at_once) for at_once in (1 << 20, 500)]
        graphs = [encoded(reduced_for(d, encoding), encoding) for d in dags]
        assert graphs[0].nodes.tobytes() == graphs[1].nodes.tobytes()
        assert graphs[0].bricks.tobytes() == graphs[1].bricks.tobytes()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_broken_words_are_refused(encoding):
    graph = graph_of(noise(5, 400), 5, encoding)
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(60):
        nodes = graph.nodes.copy()
        place = rng.integers(len(nodes))
        nodes[place] = nodes[place] ^ nodes.dtype.type(1 << rng.integers(8 * nodes.itemsize))
        try:
            found = DagWalk(dag_of(replace(graph, nodes=nodes))).voxel_count
        except InputError:
            refused += 1
        else:
            assert found == graph.voxels
    # A flipped mirror bit, or a word that points to another node with as many voxels, makes
    # another graph that is whole.
    assert refused >= (30 if encoding not in COMPACT else 20)


def test_an_octree_that_ends_early_is_refused():
    graph = graph_of(noise(5, 400), 5, "svo")
    with pytest.raises(InputError, match="not whole"):
        dag_of(replace(graph, nodes=graph.nodes[:-1]))
