from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from workbench.errors import InputError
from workbench.formats.ply import ListColumn, PlyElement, read_ply, write_ply


def read_bytes(tmp_path: Path, data: bytes):
    path = tmp_path / "a.ply"
    path.write_bytes(data)
    return read_ply(path)


def test_text_keeps_comments_lists_and_the_digits_of_floats(tmp_path, valid_files):
    file = read_bytes(tmp_path, valid_files["text.ply"])
    assert file.comments == ("made by hand",)
    assert file.info("num_cols") == ["3"]
    vertex, grid = file.elements["vertex"], file.elements["range_grid"]
    assert vertex.columns["x"].tolist() == [0, 1, 2, 0]
    assert vertex.columns["red"].dtype == np.uint8
    assert vertex.columns["intensity"].tolist() == [0.5, 0.25, 1e-3, -4]
    lists = grid.columns["vertex_indices"]
    assert lists.values.tolist() == [0, 1, 3, 2]
    assert lists.lengths.tolist() == [1, 1, 0, 1, 0, 1]
    assert lists.offsets.tolist() == [0, 1, 2, 2, 3, 3, 4]


@pytest.mark.parametrize("name", ["little.ply", "big.ply"])
def test_binary_of_both_byte_orders_with_lists_of_different_length(tmp_path, valid_files, name):
    file = read_bytes(tmp_path, valid_files[name] + b"junk at the end")
    vertex, face = file.elements["vertex"], file.elements["face"]
    assert vertex.columns["x"].tolist() == [0.1, 1, 0]
    assert vertex.columns["z"].tolist() == [-1, 2, 3]
    assert face.columns["vertex_indices"].values.tolist() == [0, 1, 2, 2, 1, 0, 1, 1, 2, 0]
    assert face.columns["vertex_indices"].lengths.tolist() == [3, 4, 3]
    assert face.columns["flag"].tolist() == [7, 8, 9]


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b"\r"])
def test_line_ends_of_every_system(tmp_path, valid_files, ending):
    data = valid_files["text.ply"].replace(b"\n", ending)
    assert read_bytes(tmp_path, data).elements["vertex"].columns["y"].tolist() == [0, 0, 1, 1]


def test_a_body_that_starts_with_a_line_feed_byte(tmp_path):
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty uchar x\nend_header"
    for ending in ("\n", "\r", "\r\n"):
        data = (header + "\n").replace("\n", ending).encode() + b"\x0a\x0d"
        assert read_bytes(tmp_path, data).elements["vertex"].columns["x"].tolist() == [10, 13]


def test_georeferenced_text_keeps_its_centimetres(tmp_path):
    data = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n5412345.67\n"
    assert read_bytes(tmp_path, data).elements["vertex"].columns["x"][0] == 5412345.67


HEAD = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty uchar c\n"
LISTS = "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int i\nend_header\n"


@pytest.mark.parametrize(
    ("data", "message", "where"),
    [
        ("solid cube\n", "not a PLY", "byte 0"),
        ("ply\nformat ascii 1.0\nelement vertex 1\n", "does not end", "byte"),
        (HEAD + "property vec3 n\nend_header\n", "Unknown PLY type", "header line 6"),
        (HEAD + "property float x\nend_header\n", "declared twice", "header line 6"),
        ("ply\nformat ascii 1.0\nelement vertex -3\nend_header\n", "number of rows", "line 3"),
        ("ply\nformat ascii 1.0\nelement vertex 1e9\nend_header\n", "number of rows", "line 3"),
        ("ply\nformat ascii 1.0\nproperty float x\nend_header\n", "no element", "line 3"),
        ("ply\nelement vertex 0\nend_header\n", "no format", None),
        ("ply\nformat base64 1.0\nend_header\n", "Unknown PLY format", "line 2"),
        (HEAD + "end_header\n1 2\n3", "ends before", "row 1"),
        (HEAD + "end_header\n1 2\nthree 4\n", "not a number", "row 1, line 8"),
        (HEAD + "end_header\n1 2\n3 256\n", "does not fit", "element 'vertex', row 1"),
        (HEAD + "end_header\n1 2.5\n3 4\n", "does not fit", "element 'vertex', row 0"),
        (HEAD + "end_header\n1 nan\n3 4\n", "does not fit", "element 'vertex', row 0"),
        (LISTS + "2 1 2\n-1 3\n", "does not fit", "element 'face', row 1"),
        (LISTS + "2 1 2\n9999999 3\n", "ends before", "element 'face', row 1"),
        (LISTS + "2 1 2\n1 3000000000\n", "does not fit", "element 'face', row 1"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path, data, message, where):
    with pytest.raises(InputError, match=message) as caught:
        read_bytes(tmp_path, data.encode())
    assert caught.value.file is not None
    assert caught.value.fix is not None
    if where:
        assert where in (caught.value.where or "")


def test_a_short_binary_body_names_element_row_and_byte(tmp_path, valid_files):
    data = valid_files["little.ply"]
    body = data.index(b"end_header\n") + 11
    with pytest.raises(InputError, match="'vertex'") as caught:
        read_bytes(tmp_path, data[: body + 2 * 14 + 3])
    assert caught.value.where == f"element 'vertex', row 2, byte {body + 31}"
    with pytest.raises(InputError, match="'face'") as caught:
        read_bytes(tmp_path, data[:-3])
    assert "element 'face', row 2" in (caught.value.where or "")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("kind", ["float x", "list uchar int i"])
def test_an_absurd_count_costs_no_memory(tmp_path, form, kind):
    header = (
        f"ply\nformat {form} 1.0\nelement vertex 999999999999999999\nproperty {kind}\nend_header\n"
    )
    start = time.perf_counter()
    with pytest.raises(InputError, match="ends before"):
        read_bytes(tmp_path, header.encode() + b"1 2 3 4\n")
    assert time.perf_counter() - start < 2


SCALARS = st.sampled_from(["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"])


@st.composite
def elements(draw) -> PlyElement:
    rows = draw(st.integers(0, 5))
    columns = {}
    for k in range(draw(st.integers(1, 4))):
        kind = np.dtype(draw(SCALARS))
        if draw(st.booleans()):
            lengths = draw(hnp.arrays(np.int64, rows, elements=st.sampled_from([0, 1, 3, 300])))
            values = np.resize(draw(hnp.arrays(kind, 4)), int(lengths.sum()))
            columns[f"p{k}"] = ListColumn(values, lengths)
        else:
            columns[f"p{k}"] = draw(hnp.arrays(kind, rows))
    return PlyElement("e", rows, columns)


@given(elements(), elements())
@settings(max_examples=100, deadline=None)
def test_whatever_is_written_is_read_back(tmp_path_factory, first, second):
    path = tmp_path_factory.getbasetemp() / "round.ply"
    second = PlyElement("second", second.count, second.columns)
    write_ply(path, [first, second], comments=["a  b\nc"], obj_info=["k v"])
    file = read_ply(path)
    assert file.comments == ("a b c",)
    assert file.info("k") == ["v"]
    for element in (first, second):
        back = file.elements[element.name]
        assert back.count == element.count
        for name, column in element.columns.items():
            other = back.columns[name]
            if isinstance(column, ListColumn):
                assert np.array_equal(other.lengths, column.lengths)
                column, other = column.values, other.values
            assert other.dtype == column.dtype
            assert other.tobytes() == column.tobytes()


def test_other_programs_read_what_is_written(tmp_path):
    path = tmp_path / "a.ply"
    rng = np.random.default_rng(3)
    xyz, faces = rng.random((50, 3)), rng.integers(0, 50, (80, 3))
    columns = {axis: xyz[:, k] for k, axis in enumerate("xyz")}
    corners = ListColumn(faces.astype(np.int32).reshape(-1), np.full(80, 3))
    write_ply(
        path,
        [PlyElement("vertex", 50, columns), PlyElement("face", 80, {"vertex_indices": corners})],
    )
    assert np.array_equal(trimesh.load(path, process=False).faces, faces)
    assert np.array_equal(np.asarray(open3d.io.read_point_cloud(str(path)).points), xyz)


def test_a_bunny_scan_is_read_fast(shared_data):
    path = shared_data("stanford-bunny", "bun000.ply")
    read_ply(path)  # compiles or loads the kernels
    start = time.perf_counter()
    file = read_ply(path)
    assert time.perf_counter() - start < 0.4
    assert file.elements["vertex"].count == 40_256
    assert file.elements["range_grid"].columns["vertex_indices"].lengths.sum() == 40_256
