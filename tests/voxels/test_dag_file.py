"""Files of voxel graphs: what is written is read, and damage is told."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.voxels.dag_colors import packed_colors
from workbench.voxels.dag_encoding import ENCODINGS, encoded
from workbench.voxels.dag_file import VoxelGraph, read_voxel_graph, write_voxel_graph
from workbench.voxels.dag_reduction import reduced_dag
from workbench.voxels.graph_export import reduced_for
from workbench.voxels.voxel_set import VoxelGrid


def voxel_graph(encoding, colors=None):
    rng = np.random.default_rng(2)
    codes = np.unique(rng.integers(0, 8**5, 700)).astype(np.uint64)
    dag = reduced_dag(codes, 5)
    graph = encoded(reduced_for(dag, encoding), encoding)
    grid = VoxelGrid(np.array([1.5, -2.0, 5.4e6]), 0.75, 5)
    if colors:
        values = rng.integers(0, colors, (len(codes), 3)).astype(np.uint8)
        return VoxelGraph(graph, grid, packed_colors(values))
    return VoxelGraph(graph, grid)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("colors", [None, 2, 10, 256])
def test_what_is_written_is_read(tmp_path, encoding, colors):
    path = tmp_path / "a.voxgraph"
    written = voxel_graph(encoding, colors)
    assert write_voxel_graph(path, written) == path.stat().st_size
    found = read_voxel_graph(path)
    for name in ("encoding", "level", "voxels", "root_turn"):
        assert getattr(found.graph, name) == getattr(written.graph, name)
    for name in ("starts", "nodes", "bricks"):
        before, after = getattr(written.graph, name), getattr(found.graph, name)
        assert before.dtype == after.dtype
        assert np.array_equal(before, after)
    assert np.array_equal(found.grid.origin, written.grid.origin)
    assert (found.grid.size, found.grid.level) == (0.75, 5)
    if colors is None:
        assert found.colors is None
    else:
        assert np.array_equal(found.colors.all(), written.colors.all())


def test_the_same_voxels_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_voxel_graph(tmp_path / name, voxel_graph("ssvdag", 10))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_header_is_where_the_documentation_says(tmp_path):
    path = tmp_path / "a.voxgraph"
    written = voxel_graph("ssvdag")
    write_voxel_graph(path, written)
    data = path.read_bytes()
    assert data[:8] == b"VOXGRAPH"
    assert struct.unpack_from("<I", data, 8) == (1,)
    assert struct.unpack_from("<I", data, 12) == (zlib.crc32(data[16:]),)
    assert tuple(data[16:18]) == (4, 5)
    assert struct.unpack_from("<4d", data, 24) == (1.5, -2.0, 5.4e6, 0.75)
    counts = struct.unpack_from("<3Q", data, 56)
    assert counts == (written.graph.voxels, len(written.graph.nodes), len(written.graph.bricks))
    starts = np.frombuffer(data, "<u8", 6, 80)
    assert np.array_equal(starts, written.graph.starts)
    assert np.frombuffer(data, "<u8", 1, 128)[0] == written.graph.bricks[0]


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda data: data[:40], "cut off"),
        (lambda data: data[:-3], "damaged"),
        (lambda data: data + b"x", "damaged"),
        (lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:], "damaged"),
        (lambda data: b"ply\n" + data[4:], "not a sparse voxel graph"),
        (lambda data: data[:8] + b"\x02\0\0\0" + data[12:], "version"),
        (lambda data: rechecked(data[:17] + b"\x63" + data[18:]), "makes no sense"),
        (lambda data: rechecked(data[:72] + b"\xff\xff\xff\x7f" + data[76:]), "cut off"),
        (lambda data: rechecked(data + bytes(8)), "too long"),
    ],
)
def test_damage_is_told(tmp_path, harm, told):
    path = tmp_path / "a.voxgraph"
    write_voxel_graph(path, voxel_graph("ssvdag"))
    path.write_bytes(harm(path.read_bytes()))
    with pytest.raises(InputError, match=told):
        read_voxel_graph(path)


def rechecked(data: bytes) -> bytes:
    return data[:12] + struct.pack("<I", zlib.crc32(data[16:])) + data[16:]


def test_a_palette_is_used_where_it_is_smaller():
    rng = np.random.default_rng(4)
    few = rng.integers(0, 3, (5000, 3)).astype(np.uint8)
    some = rng.integers(0, 8, (5000, 3)).astype(np.uint8)
    many = rng.integers(0, 256, (5000, 3)).astype(np.uint8)
    for colors, size in ((few, 5000 + 3 * 27), (some, 2 * 5000 + 3 * 512), (many, 3 * 5000)):
        packed = packed_colors(colors)
        assert packed.nbytes == size
        assert np.array_equal(packed.all(), colors)


def test_colours_are_averaged_in_linear_light():
    colors = packed_colors(np.array([[0, 255, 10], [255, 255, 10], [7, 8, 9]], np.uint8))
    mean = colors.mean(np.array([0, 2, -1]), np.array([2, 1, 0]))
    # Half the light of white is 188 in sRGB, by the standard's own formula.
    assert mean.tolist() == [[188, 255, 10], [7, 8, 9], [0, 0, 0]]
