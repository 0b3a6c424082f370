from __future__ import annotations

import errno
import json
import struct
import time

import numpy as np
import open3d
import pytest
import trimesh

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.gltf import linear_from_srgb, srgb_from_linear
from workbench.formats.ply import read_ply
from workbench.formats.surface_files import (
    read_surface,
    write_surface_glb,
    write_surface_obj,
    write_surface_ply,
)
from workbench.geometry.mesh import TriangleMesh, edge_census, vertex_normals


@pytest.fixture(scope="module")
def ball() -> TriangleMesh:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    rng = np.random.default_rng(4)
    n = len(sphere.vertices)
    mesh = TriangleMesh(
        sphere.vertices * [1, 2, 0.3] + rng.random(3), sphere.faces.astype(np.int32)
    )
    return mesh.with_attributes(
        normal=vertex_normals(mesh),
        color=rng.integers(0, 256, (n, 3)).astype(np.uint8),
        provenance=(np.arange(n) % 3 == 0).astype(np.uint8),
        color_provenance=(np.arange(n) % 3).astype(np.uint8),
        distance_to_samples_m=rng.random(n).astype(np.float32),
    )


def moved(mesh: TriangleMesh, by) -> TriangleMesh:
    return TriangleMesh(mesh.vertices + by, mesh.triangles, mesh.vertex_attributes)


WRITERS = {"ply": write_surface_ply, "obj": write_surface_obj, "glb": write_surface_glb}


@pytest.mark.parametrize("suffix", WRITERS)
def test_same_mesh_same_bytes_and_nothing_left_beside(tmp_path, ball, suffix):
    path = tmp_path / f"a.{suffix}"
    WRITERS[suffix](path, ball)
    first = path.read_bytes()
    WRITERS[suffix](path, ball)
    assert path.read_bytes() == first
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_ply_layout_and_round_trip(tmp_path, ball):
    path = tmp_path / "a.ply"
    write_surface_ply(path, ball, world_from_local_origin=[5.4e6 + 0.1, 1, 2], unit="millimetre")
    file = read_ply(path)
    kinds = {name: column.dtype for name, column in file.elements["vertex"].columns.items()}
    assert list(kinds) == [
        "x", "y", "z", "nx", "ny", "nz", "red", "green", "blue",
        "provenance", "color_provenance", "distance_to_samples_m",
    ]  # fmt: skip
    assert kinds["x"] == np.float64
    assert kinds["nx"] == kinds["distance_to_samples_m"] == np.float32
    assert kinds["red"] == kinds["provenance"] == np.uint8
    assert "unit millimetre" in file.comments
    assert "world_from_local_origin 5400000.1 1.0 2.0" in file.comments
    back = read_surface(path)
    assert np.array_equal(back.vertices, ball.vertices)
    assert np.array_equal(back.triangles, ball.triangles)
    assert back.triangles.dtype == np.int32
    for name in ("color", "provenance", "color_provenance"):
        assert np.array_equal(back.vertex_attributes[name], ball.vertex_attributes[name])
        assert back.vertex_attributes[name].dtype == np.uint8
    assert back.vertex_attributes["distance_to_samples_m"].dtype == np.float64
    assert np.abs(back.vertex_attributes["normal"] - ball.vertex_attributes["normal"]).max() < 1e-7
    other = open3d.io.read_triangle_mesh(str(path))
    assert np.array_equal(np.asarray(other.vertices), ball.vertices)
    assert np.array_equal(np.asarray(other.triangles), ball.triangles)


def test_obj_keeps_every_bit_of_large_coordinates(tmp_path, ball):
    path = tmp_path / "a.obj"
    far = moved(ball, [5.4e6, 4e5, 100])
    write_surface_obj(path, far)
    back = read_surface(path)
    assert np.array_equal(back.vertices, far.vertices)
    assert np.array_equal(back.triangles, far.triangles)
    assert np.array_equal(back.vertex_attributes["color"], ball.vertex_attributes["color"])
    assert np.abs(back.vertex_attributes["normal"] - ball.vertex_attributes["normal"]).max() < 2e-6
    other = open3d.io.read_triangle_mesh(str(path))
    assert len(other.triangles) == len(ball.triangles)
    plain = TriangleMesh(ball.vertices, ball.triangles)
    write_surface_obj(path, plain)
    assert read_surface(path).vertex_attributes == {}


def test_obj_of_a_large_mesh_is_written_fast(tmp_path):
    n = 200_000
    rng = np.random.default_rng(0)
    mesh = TriangleMesh(
        rng.random((n, 3)), rng.integers(0, n, (2 * n, 3)).astype(np.int32)
    ).with_attributes(normal=rng.random((n, 3)), color=np.zeros((n, 3), np.uint8))
    start = time.process_time()
    write_surface_obj(tmp_path / "a.obj", mesh)
    assert time.process_time() - start < 3


def glb_parts(data: bytes) -> tuple[dict, bytes]:
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    json_length, json_kind = struct.unpack_from("<I4s", data, 12)
    binary_length, binary_kind = struct.unpack_from("<I4s", data, 20 + json_length)
    assert (json_kind, binary_kind) == (b"JSON", b"BIN\0")
    assert json_length % 4 == binary_length % 4 == 0
    assert 28 + json_length + binary_length == len(data)
    return json.loads(data[20 : 20 + json_length]), data[28 + json_length :]


def test_glb_is_as_the_specification_says(tmp_path, ball):
    path = tmp_path / "a.glb"
    far = np.linspace(0.0, 1.0, len(ball.vertices))
    far[3] = np.inf
    write_surface_glb(path, ball.with_attributes(distance_to_samples_m=far), [1, 2, 3])
    document, binary = glb_parts(path.read_bytes())
    assert document["buffers"] == [{"byteLength": len(binary)}]
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    told = {"_PROVENANCE", "_COLOR_PROVENANCE", "_DISTANCE_TO_SAMPLES_M"}
    assert set(attributes) == {"POSITION", "NORMAL", "COLOR_0"} | told
    end = 0
    for view in document["bufferViews"]:
        assert view["byteOffset"] == end
        assert end % 4 == 0
        end += view["byteLength"]
    assert end == len(binary)
    for accessor in document["accessors"]:
        assert accessor["count"] >= 1
        assert accessor["componentType"] in (5121, 5125, 5126)

    def array(index: int, kind: str, width: int) -> np.ndarray:
        view = document["bufferViews"][document["accessors"][index]["bufferView"]]
        data = binary[view["byteOffset"] :][: view["byteLength"]]
        stride = view.get("byteStride", np.dtype(kind).itemsize * width)
        assert stride % 4 == 0
        return np.frombuffer(data, kind).reshape(-1, stride // np.dtype(kind).itemsize)[:, :width]

    position = array(attributes["POSITION"], "<f4", 3)
    bounds = document["accessors"][attributes["POSITION"]]
    assert bounds["min"] == position.min(axis=0).astype(float).tolist()
    assert bounds["max"] == position.max(axis=0).astype(float).tolist()
    offset = np.array(document["asset"]["extras"]["world_from_positions"])
    assert document["nodes"][0]["translation"] == offset.tolist()
    assert np.abs(position + offset - (ball.vertices + np.array([1, 2, 3]))).max() < 2e-7
    normal = array(attributes["NORMAL"], "<f4", 3)
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-6
    provenance = array(attributes["_PROVENANCE"], "u1", 1)[:, 0]
    assert np.array_equal(provenance, ball.vertex_attributes["provenance"])
    distance = array(attributes["_DISTANCE_TO_SAMPLES_M"], "<f4", 1)[:, 0]
    assert distance[3] == -1.0
    np.testing.assert_array_equal(np.delete(distance, 3), np.delete(far, 3).astype(np.float32))
    # Mid grey in sRGB, 188, is half the light.
    linear = array(attributes["COLOR_0"], "<f4", 3)
    assert np.array_equal(srgb_from_linear(linear), ball.vertex_attributes["color"])
    assert linear_from_srgb(np.array([0, 188, 255], np.uint8)).tolist() == pytest.approx(
        [0, 0.5029, 1], abs=1e-4
    )


def test_glb_far_from_the_origin_keeps_its_detail(tmp_path, ball):
    path = tmp_path / "a.glb"
    origin = np.array([5_412_345.678, 512_345.123, 234.5])
    write_surface_glb(path, ball, origin)
    document, _ = glb_parts(path.read_bytes())
    assert "translation" not in document["nodes"][0]
    extras = document["nodes"][0]["extras"]
    assert extras["world_from_local_origin"] == origin.tolist()
    back = read_surface(path)
    world = back.vertices + extras["world_from_positions"]
    assert np.abs(world - (ball.vertices + origin)).max() < 1e-6


def test_glb_opens_elsewhere_and_comes_back(tmp_path, ball):
    path = tmp_path / "a.glb"
    write_surface_glb(path, ball)
    other = trimesh.load(path, force="mesh", process=False)
    assert len(other.faces) == len(ball.triangles)
    assert other.is_watertight
    back = read_surface(path)
    assert np.abs(back.vertices - ball.vertices).max() < 2e-7
    assert np.array_equal(back.triangles, ball.triangles)
    for name in ("color", "provenance", "color_provenance"):
        assert np.array_equal(back.vertex_attributes[name], ball.vertex_attributes[name])


def test_vertices_without_a_normal_get_a_valid_one(tmp_path):
    triangle = TriangleMesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    write_surface_glb(tmp_path / "a.glb", triangle.with_attributes(normal=np.zeros((3, 3))))
    back = read_surface(tmp_path / "a.glb")
    assert np.asarray(back.vertex_attributes["normal"]).tolist() == [[0, 0, 1]] * 3


def test_mirrored_nodes_keep_the_outside_outside(tmp_path, ball):
    scene = trimesh.Scene()
    part = trimesh.Trimesh(ball.vertices, ball.triangles, process=False)
    scene.add_geometry(part, transform=np.diag([-1.0, 1, 1, 1]), node_name="a")
    scene.add_geometry(part, transform=trimesh.transformations.translation_matrix([9, 0, 0]))
    scene.export(tmp_path / "a.glb")
    back = read_surface(tmp_path / "a.glb")
    assert len(back.triangles) == 2 * len(ball.triangles)
    a, b, c = (back.vertices[back.triangles[:, k]] for k in range(3))
    halves = np.split(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, 2)
    assert min(half.sum() for half in halves) > 0


def test_stl_is_welded(tmp_path, ball):
    trimesh.Trimesh(ball.vertices, ball.triangles, process=False).export(tmp_path / "a.stl")
    back = read_surface(tmp_path / "a.stl")
    assert len(back.vertices) == len(ball.vertices)
    assert edge_census(back.triangles).watertight


def test_polygons_become_fans(tmp_path):
    text = (
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement face 3\nproperty list uchar int vertex_index\nend_header\n"
        "0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 0.5 0\n5 0 1 2 3 4\n2 0 1\n3 0 2 1\n"
    )
    (tmp_path / "a.ply").write_text(text)
    back = read_surface(tmp_path / "a.ply")
    assert back.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 2, 1]]


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", OBJ, "no triangle"),
        ("a.obj", OBJ.replace("1 0 0", "nan 0 0") + "f 1 2 3\n", "not finite"),
        ("a.fbx", "x", "not read as a surface"),
        ("a.glb", "glTF", "cannot be read"),
    ],
)
def test_what_is_no_surface(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as caught:
        read_surface(tmp_path / name)
    assert message in str(caught.value)


def test_a_triangle_of_absent_vertices_is_named(tmp_path, ball):
    triangles = ball.triangles.copy()
    triangles[7, 1] = len(ball.vertices)
    write_surface_ply(tmp_path / "a.ply", TriangleMesh(ball.vertices, triangles))
    with pytest.raises(InputError, match="does not exist") as caught:
        read_surface(tmp_path / "a.ply")
    assert caught.value.where == "triangle 7"


def test_an_empty_surface_is_no_glb(tmp_path):
    empty = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    with pytest.raises(InputError, match="without triangles"):
        write_surface_glb(tmp_path / "a.glb", empty)
    write_surface_ply(tmp_path / "a.ply", empty)
    with pytest.raises(InputError, match="no triangles"):
        read_surface(tmp_path / "a.ply")


def test_real_meshes(shared_data):
    expected = {"igea.ply": 268_686, "nefertiti.obj": 99_938, "gargoyle.ply": 50_000}
    for name, triangles in expected.items():
        mesh = read_surface(shared_data("meshes", name))
        assert len(mesh.triangles) == triangles
        assert edge_census(mesh.triangles).watertight
    assert mesh.vertex_attributes["color"].dtype == np.uint8


def test_two_that_write_one_file_at_once_never_mix(tmp_path):
    path = tmp_path / "a.bin"
    with replacing(path) as one:
        one.write_bytes(b"one, the longer")
        with replacing(path) as other:
            other.write_bytes(b"other")
        assert path.read_bytes() == b"other"
    assert path.read_bytes() == b"one, the longer"


def test_an_error_of_the_disk_names_the_file(tmp_path):
    def full() -> None:
        with replacing(tmp_path / "a.bin"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space") as caught:
        full()
    assert caught.value.filename == str(tmp_path / "a.bin")


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def fail() -> None:
        with replacing(path) as partial:
            assert partial.parent == tmp_path
            assert partial.name.startswith(".a.bin.")
            assert partial.suffix == ".partial"
            partial.write_bytes(b"half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_bytes() == b"old"
    with replacing(path) as partial:
        partial.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]
