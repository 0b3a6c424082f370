"""Chunk files hold every triangle once, however they are built, and say when they are damaged."""

from __future__ import annotations

import numpy as np
import pytest

from tests.raytracing.scenes import sheet, soup
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.raytracing.chunk_building import build_chunk_file
from workbench.raytracing.chunk_file import ChunkFile, joined_chunks
from workbench.raytracing.surface_source import MeshSource


def _built(mesh, path, **options):
    return build_chunk_file(MeshSource(mesh), path, **options)


@pytest.mark.parametrize("mesh", [sheet(40), soup(3000, 1)], ids=["sheet", "soup"])
def test_chunks_hold_every_triangle_once_at_its_place(mesh, tmp_path):
    file = _built(mesh, tmp_path / "a.raychunks", triangles_per_chunk=100, triangles_at_once=700)
    chunks = file.read(0, len(file.chunks))
    assert max(len(chunk.corners) for chunk in chunks) <= 100
    whole = joined_chunks(chunks)
    order = np.argsort(whole.numbers)
    assert (whole.numbers[order] == np.arange(len(mesh.triangles))).all()
    expected = file.frame.local(mesh.vertices)[mesh.triangles]
    assert (whole.positions[whole.corners][order] == expected).all()
    assert (whole.vertex_numbers[whole.corners][order] == mesh.triangles).all()


def test_a_file_does_not_depend_on_how_much_was_in_memory(tmp_path):
    mesh = soup(2000, 2)
    texts = []
    for at_once in (1, 150, 10_000):
        file = _built(mesh, tmp_path / f"{at_once}.raychunks", triangles_at_once=at_once)
        whole = joined_chunks(file.read(0, len(file.chunks)))
        texts.append(whole.numbers.tobytes())
    assert texts[0] == texts[1] == texts[2]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        f"{n}.raychunks" for n in (1, 150, 10_000)
    )


def test_triangles_in_one_place_are_cut_all_the_same(tmp_path):
    one = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = TriangleMesh(one, np.tile(np.arange(3, dtype=np.int32), (500, 1)))
    file = _built(mesh, tmp_path / "a.raychunks", triangles_per_chunk=64, triangles_at_once=100)
    assert len(file.chunks) >= 8
    assert file.tree.nodes["height"][0] <= 5
    assert int(file.tree.nodes["triangles"][0]) == 500


def test_subtrees_are_ranges_of_chunks_and_boxes_hold_what_is_below(tmp_path):
    file = _built(sheet(40), tmp_path / "a.raychunks", triangles_per_chunk=100)
    for node in file.tree.nodes:
        whole = joined_chunks(file.read(int(node["first"]), int(node["count"])))
        assert len(whole.corners) == node["triangles"]
        assert (whole.positions.min(axis=0) == node["low"]).all()
        assert (whole.positions.max(axis=0) == node["high"]).all()
        if node["left"] >= 0:
            below = file.tree.nodes[[node["left"], node["right"]]]
            assert below["count"].sum() == node["count"]
            assert below["first"][1] == below["first"][0] + below["count"][0]


def test_colours_of_triangles_are_the_mean_of_their_corners(tmp_path):
    mesh = sheet(4)
    colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3)).astype(np.uint8)
    mesh = TriangleMesh(mesh.vertices, mesh.triangles, {"color": colors})
    whole = joined_chunks(_built(mesh, tmp_path / "a.raychunks").read(0, 1))
    expected = colors[mesh.triangles[whole.numbers]].astype(float).mean(axis=1)
    assert np.abs(whole.colors - expected).max() <= 0.5 + 1e-4


def test_damage_is_told_where_it_is_read(tmp_path):
    path = tmp_path / "a.raychunks"
    file = _built(sheet(40), path, triangles_per_chunk=100)
    whole = path.read_bytes()
    middle = int(file.chunks["offset"][3]) + 5
    path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    damaged = ChunkFile(path)
    damaged.read(0, 3)
    with pytest.raises(InputError, match="damaged"):
        damaged.read(3, 1)
    for broken in (whole[:-1], whole[:20], b"PLY" + whole[3:], whole[:30] + b"?" + whole[31:]):
        path.write_bytes(broken)
        with pytest.raises(InputError):
            ChunkFile(path)


def test_surfaces_that_cannot_be_cut_are_refused(tmp_path):
    path = tmp_path / "a.raychunks"
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, np.nan, 0]])
    with pytest.raises(InputError, match="not finite"):
        _built(TriangleMesh(vertices, np.array([[0, 1, 2]], np.int32)), path)
    with pytest.raises(InputError, match="no triangles"):
        _built(TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32)), path)
    assert not list(tmp_path.iterdir())
